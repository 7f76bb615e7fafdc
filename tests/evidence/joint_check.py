"""Long study: does the joint test of check points reject as often as it says?

Writes `docs/evidence/joint_check.md`. Small flights with GNSS positions and control; ten other points are
check points with errors of their survey. The joint test uses the covariance of all of them together; the
classical one takes them as independent.

Run: `make evidence`, or `python -m tests.evidence.joint_check`, in portions as
`tests.evidence.portions` says.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.adjustment.factored import factored
from photocal.adjustment.joint import joint_covariance
from photocal.analysis.georeferencing.comparison import joint_test
from tests.evidence.portions import outcomes
from tests.photocal.analysis.aerial import Flight, fly

FLIGHTS, CHECKS, SURVEY_M = 1000, 10, 0.01
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "joint_check.md"
SMALL = Flight(10, 500, estimate=("c", "x0", "y0", "K1"), sigma_px=0.7)


def rejected(seed: int) -> list[bool]:
    """Which tests reject a flight: jointly, the mean, the sum of point by point, the mean of an axis."""
    flown = fly(SMALL, 20_000 + seed)
    network, solution = flown.network, adjust(flown.network)
    free = np.flatnonzero(np.diagonal(network.points.weight, axis1=1, axis2=2)[:, 0] == 0)
    rays = np.bincount(network.rays.point, minlength=len(solution.points))
    chosen = free[np.argsort(-rays[free], kind="stable")][:CHECKS]
    names = [network.point_names[j] for j in chosen]
    at = factored(network, solution.state)
    covariance = joint_covariance(at, [("point", name) for name in names])[1]
    survey = np.random.default_rng(seed).normal(0.0, SURVEY_M, (CHECKS, 3))
    d = flown.points[chosen] + survey - solution.points[chosen]
    whole = covariance + SURVEY_M**2 * np.eye(3 * CHECKS)
    t = d.mean(axis=0) / d.std(axis=0, ddof=1) * np.sqrt(CHECKS)
    biased = bool(np.any(np.abs(t) > stats.t.ppf(1.0 - 0.05 / 6.0, CHECKS - 1)))
    own = np.array([whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(CHECKS)])
    alone = float(np.einsum("na,nab,nb->", d, np.linalg.inv(own), d))
    low, high = (float(stats.chi2.ppf(p, 3 * CHECKS)) for p in (0.025, 0.975))
    joint = joint_test(d, whole)
    return [joint.p_value < 0.05, joint.mean_p_value < 0.05, not low < alone < high, biased]


def main() -> None:
    """Fly, check, count, and write the page."""
    found = outcomes(((seed,) for seed in count()), FLIGHTS, rejected)
    share = np.mean(list(found.values()), axis=0)
    names = (
        "jointly: d' C^-1 d",
        "jointly: the mean",
        "point by point: sum of d' C^-1 d",
        "Student's t of the means, three axes",
    )
    lines = [
        "# Check points judged jointly",
        "",
        f"{len(found)} flights of 10 images with GNSS and control, {CHECKS} check points surveyed to 1 cm.",
        "Rejected at 5 % although every error is as stated; required: 3.5 to 6.5 % for the joint tests.",
        "The classical tests treat the points as independent.",
        "",
        "| test | rejected |",
        "|---|---|",
        *(f"| {name} | {100 * part:.1f} % |" for name, part in zip(names, share, strict=True)),
    ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Long study: are `brown-observed` cameras free of bias, and their intervals honest, at 1 px of noise?

Writes `docs/evidence/observed_distortion.md`: the errors of the image coordinates stand inside the polynomial
of this model, which is solved for the computed coordinates, or at the measured ones as older programs do.

Run: `make evidence`, or `python -m tests.evidence.observed_distortion`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.geometry.camera import DistortionAt
from tests.photocal import flights

FLIGHTS, IMAGES, POINTS = 60, 40, 900
CASES: tuple[tuple[DistortionAt, float], ...] = (
    ("adjusted", 0.02), ("adjusted", 0.05), ("adjusted", 0.10), ("measured", 0.05),
)  # fmt: skip
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "observed_distortion.md"


def calibrated(at: DistortionAt, distortion: float, seed: int) -> tuple[dict[str, float], float, int, int]:
    """Standardised errors of a flight with GNSS and control; v'Pv, its degrees of freedom, and the rays."""
    rng = np.random.default_rng(seed)
    own = replace(flights.wide("brown-observed", distortion=distortion), distortion_at=at)
    truth = flights.flight(own, rng, images=IMAGES, points=POINTS)
    network = flights.navigated(flights.measured(truth, rng, control=6), truth, rng, attitudes=False)
    solution = adjust(network)
    errors = flights.standardised(truth, network, solution)
    return errors, solution.chi_squared, solution.degrees_of_freedom, len(network.rays.image)


def row(at: DistortionAt, distortion: float) -> str:
    """One line of the table."""
    found = []
    for seed in range(FLIGHTS):
        found.append(calibrated(at, distortion, seed))
        sys.stderr.write(f"\r{at}, {distortion}: flight {seed + 1} of {FLIGHTS} ")
    errors = np.array([list(one[0].values()) for one in found])
    chi_squared, freedom = np.array([one[1:3] for one in found]).sum(axis=0)
    inside = np.abs(errors) < stats.norm.isf(0.025)
    cells = [
        f"{name} {100 * s:.0f} ({m:+.2f})"
        for name, s, m in zip(found[0][0], inside.mean(axis=0), errors.mean(axis=0), strict=True)
    ]
    ratio, spread = chi_squared / freedom, np.sqrt(2 / freedom)
    return (
        f"| {at} | {100 * distortion:.0f} % | {np.mean([one[3] for one in found]):.0f} | {ratio:.4f} |"
        f" {(ratio - 1) / spread:+.1f} | {100 * inside.mean():.1f} % | {', '.join(cells)} |"
    )


def main() -> None:
    """Run the study and write its page."""
    lines = [
        "# Image errors inside the distortion polynomial",
        "",
        f"{FLIGHTS} flights of {IMAGES} images for each line, 1 px noise, `brown-observed`; distortion in",
        "the corner as a share of the radius. Coverage of the 95 % intervals for all parameters together,",
        "and for each with its mean error in standard deviations. v'Pv over its degrees of freedom, and",
        "its distance from 1 in standard errors.",
        "",
        "| polynomial at | distortion | rays | v'Pv/dof | from 1 | coverage | by parameter, % (mean error) |",
        "|---|---|---|---|---|---|---|",
        *(row(*case) for case in CASES),
    ]
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\nwritten to {OUTPUT}\n")


if __name__ == "__main__":
    main()

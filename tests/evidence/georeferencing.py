"""Long study: are the predicted errors of direct, integrated and indirect georeferencing true?

Writes `docs/evidence/georeferencing.md`. Flights are projected by OpenCV, not by photocal; 100 seeds of
one flight without systematic errors, then systematic errors injected one at a time.

Run: `make evidence`, or `python -m tests.evidence.georeferencing`.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from photocal.analysis.georeferencing.causes import causes_of
from photocal.analysis.georeferencing.comparison import differences
from photocal.analysis.georeferencing.methods import METHODS, of_method
from photocal.analysis.georeferencing.prepared import with_attitude_angles
from photocal.block.folder import read_block
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

SEEDS = 100
INJECTED_SEEDS = 25
PLAN = Plan(tie=50)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "georeferencing.md"
CASES: tuple[tuple[str, Errors, dict[str, float]], ...] = (
    ("none", Errors(), {}),
    (
        "lever-arm",
        Errors(lever_arm_m=(0.16, 0.12, 0.0)),
        {"lever_arm_x": 0.16, "lever_arm_y": 0.12, "lever_arm_z": 0.0},
    ),
    ("boresight", Errors(boresight_deg=(0.3, -0.4, 0.0)), {"boresight_x": 0.3, "boresight_y": -0.4}),
    ("time-offset", Errors(time_offset_s=0.017), {"time_offset": 0.017}),
    ("datum-shift", Errors(datum_m=(0.2, 0.1, 0.2)), {"shift_x": 0.2, "shift_y": 0.1, "shift_z": 0.2}),
)


def coverage(folder: Path) -> list[str]:
    """Table of predicted against actual errors."""
    distance: dict[str, list[NDArray[np.float64]]] = {method: [] for method in METHODS}
    w: dict[str, list[NDArray[np.float64]]] = {method: [] for method in METHODS}
    for seed in range(SEEDS):
        block = read_block(fly(folder / f"s{seed}", np.random.default_rng(1000 + seed), plan=PLAN))
        for method in METHODS:
            check = differences(block, of_method(block, method), "check")
            distance[method].append(check.distance)
            w[method].append(check.w)
        sys.stderr.write(f"\rflight {seed + 1} of {SEEDS}")
    lines = [
        "| method | mean of d' C^-1 d / 3 | expected | points rejected (1 %) | abs(w) over 1.96 | expected |",
        "|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        table = np.array(distance[method])
        p = stats.chi2(3 * SEEDS).sf(table.sum(axis=0))
        rejected = int(np.sum((p < 0.005) | (p > 0.995)))
        # Points of one flight are correlated, flights are not: the error of the mean comes from flights.
        error = table.mean(axis=1).std(ddof=1) / 3 / np.sqrt(SEEDS)
        share = np.mean(np.abs(np.array(w[method])) > stats.norm.ppf(0.975))
        lines.append(
            f"| {method} | {table.mean() / 3:.3f} +- {error:.3f} | 1 | {rejected} of {table.shape[1]} "
            f"| {share:.1%} | 5 % |"
        )
    return lines


def injected(folder: Path) -> list[str]:
    """Table of injected errors: how often found, named, and within three sigma."""
    lines = [
        "| injected | flights | named alone | named | values within 3 sigma | named instead |",
        "|---|---|---|---|---|---|",
    ]
    for name, errors, truth in CASES:
        alone = among = within = values = 0
        others: Counter[str] = Counter()
        for seed in range(INJECTED_SEEDS):
            place = folder / f"{name.replace(' ', '-')}{seed}"
            block = with_attitude_angles(
                read_block(fly(place, np.random.default_rng(5000 + seed), errors, PLAN))
            )
            found, _ = causes_of(block)
            assert found is not None
            names = [error.hypothesis.name for error in found.errors]
            alone += names == [name] or (name == "none" and not names)
            among += name in names
            others.update(other for other in names if other != name)
            estimates = {e.name: e for e in found.estimates}
            for key, true in truth.items():
                values += 1
                within += key in estimates and abs(estimates[key].value - true) < 3 * estimates[key].sigma
            sys.stderr.write(f"\r{name}: flight {seed + 1} of {INJECTED_SEEDS}   ")
        instead = ", ".join(f"{other} {n}" for other, n in others.items()) or "-"
        shown = f"{within} of {values}" if values else "-"
        lines.append(f"| {name} | {INJECTED_SEEDS} | {alone} | {among} | {shown} | {instead} |")
    return lines


def main() -> None:
    """Run both studies and write their tables."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [
            "# Georeferencing: predicted and actual errors",
            "",
            f"{SEEDS} synthetic flights, projected by OpenCV: two heights, crossing strips, 9 control and",
            "20 check points. Sigmas: image 0.4 px, positions 3 cm, attitudes 0.03 deg, control 15 mm,",
            "check points 10 mm. d is product minus reference at a check point, C its predicted",
            "covariance. A point is rejected when its d' C^-1 d, summed over all flights, is too large or",
            "too small for chi-squared.",
            "",
            *coverage(Path(folder)),
            "",
            "Injected errors: 20 cm lever arm, 0.5 deg boresight, 17 ms, 30 cm datum; tests at 0.1 %.",
            "",
            *injected(Path(folder)),
        ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\n{OUTPUT.name} written\n")


if __name__ == "__main__":
    main()

"""Long study: is the readout of a rolling shutter found, and what does it leave of the camera?

Writes `docs/evidence/rolling_shutter.md`. Flights at 8 m/s in gusts, 1 px noise, three kinds of knowledge of
the motion; each line of an image is simulated at its own pose.

Run: `make evidence`, or `python -m tests.evidence.rolling_shutter`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.adjustment.readout import with_moving_images
from tests.photocal import flights

Errors = dict[str, float]
IMAGES, POINTS = 16, 220

CASES: dict[flights.Case, str] = {
    "attitudes": "GNSS and attitudes: velocity to 0.05 m/s, rate to 0.3 deg/s; mounting found",
    "positions": "positions and times only: velocity from neighbours, rate unknown",
    "pictures": "pictures, their times and four control points",
}
# Flights for each readout, ms.
FLIGHTS = {0: 100, 10: 7, 30: 100, 60: 7}
CHECKED_MS, CHECKED_FLIGHTS = (10, 30, 60), 60
# Flights whose camera vibrates by this much at 20 to 60 Hz while it reads for 30 ms, marks of so many pixels.
VIBRATING, VIBRATION_DEG, MARK_PX = 8, 0.01, 0.1
CHECKED = f"Errors of points that carry no datum over their prediction, {CHECKED_FLIGHTS} flights each."
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "rolling_shutter.md"


def flown(case: flights.Case, readout_ms: float, seed: int) -> tuple[Errors, float, float, float, bool]:
    """Standardised errors, sigma of the readout (s), v'Pv over its dof, p, and whether it rolls."""
    truth, network = flights.case(case, seed, readout_s=readout_ms / 1000, images=IMAGES, points=POINTS)
    network, solution, (readout,) = with_moving_images(network, adjust(network))
    errors = flights.standardised(truth, network, solution)
    return errors, readout.sigma, solution.variance_factor, readout.p_value, readout.estimated


def row(case: flights.Case, readout_ms: int) -> str:
    """One line of the table."""
    found = []
    for seed in range(FLIGHTS[readout_ms]):
        found.append(flown(case, readout_ms, seed))
        sys.stderr.write(f"\r{case}, {readout_ms} ms: flight {seed + 1} of {FLIGHTS[readout_ms]} ")
    names = list(found[0][0])
    errors = np.array([[one[0].get(name, np.nan) for name in names] for one in found])
    limit = stats.norm.isf(0.025)
    inside = np.where(np.isnan(errors), np.nan, np.abs(errors) < limit)
    share = ", ".join(f"{n} {100 * s:.0f}" for n, s in zip(names, np.nanmean(inside, axis=0), strict=True))
    silent = np.mean([one[3] >= 0.05 for one in found])
    sigma = 1000 * np.mean([one[1] for one in found])
    return (
        f"| {readout_ms} ms | {len(found)} | {sigma:.3f} | {100 * silent:.0f} % |"
        f" {100 * np.mean([one[4] for one in found]):.0f} % | {np.nanmax(np.abs(errors[:7])):.1f} |"
        f" {100 * np.nanmean(inside):.1f} % | {np.mean([one[2] for one in found]):.3f} | {share} |"
    )


def check_points() -> list[str]:
    """Errors of points over their prediction, root of the mean of d' C^-1 d / 3, by case and readout."""
    lines = [
        "",
        "## Check points",
        "",
        CHECKED,
        "",
        "| motion | 10 ms | 30 ms | 60 ms |",
        "|---|---|---|---|",
    ]
    for case in CASES:
        cells = []
        for readout_ms in CHECKED_MS:
            squares = []
            for seed in range(CHECKED_FLIGHTS):
                truth, network = flights.case(
                    case, 500 + seed, readout_s=readout_ms / 1000, images=IMAGES, points=POINTS
                )
                network, solution, _ = with_moving_images(network, adjust(network))
                true = truth.points[[int(name[1:]) for name in network.point_names]]
                free = ~(network.points.weight.any(axis=(1, 2)))
                error, covariance = (solution.points - true)[free], solution.point_covariance[free]
                whitened = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
                squares.append(float(np.mean((error * whitened).sum(axis=1)) / 3))
                sys.stderr.write(f"\r{case}, {readout_ms} ms: check points of flight {seed + 1} ")
            cells.append(f"{np.sqrt(np.mean(squares)):.3f}")
        lines.append(f"| {case} | " + " | ".join(cells) + " |")
    return lines


def vibrating() -> list[str]:
    """Errors in standard deviations, root mean square, with images that may shake and without."""
    lines = [
        "",
        "## Vibration within the readout",
        "",
        f"{VIBRATING} flights of 40 images each, 30 ms, {VIBRATION_DEG} deg at 20 to 60 Hz, {MARK_PX} px:",
        "root mean square of errors over their standard deviations, of images that may shake and of",
        "steady ones.",
        "",
        "| motion | images | v'Pv/dof | all | each |",
        "|---|---|---|---|---|",
    ]
    for case in ("attitudes", "positions"):
        errors: dict[str, list[Errors]] = {"shake": [], "steady": []}
        factors: dict[str, list[float]] = {"shake": [], "steady": []}
        for seed in range(VIBRATING):
            truth, network = flights.case(
                case,
                seed,
                readout_s=0.03,
                images=40,
                points=600,
                sigma_px=MARK_PX,
                vibration_deg=VIBRATION_DEG,
            )
            network, solution, _ = with_moving_images(network, adjust(network))
            steady = replace(network, cameras=(replace(network.cameras[0], shake=()),))
            for name, own, found in (("shake", network, solution), ("steady", steady, adjust(steady))):
                errors[name].append(flights.standardised(truth, own, found))
                factors[name].append(found.variance_factor)
            sys.stderr.write(f"\r{case}, vibration: flight {seed + 1} of {VIBRATING} ")
        for name, ones in errors.items():
            square = {key: np.mean([one[key] ** 2 for one in ones]) for key in ones[0]}
            each = ", ".join(f"{key} {np.sqrt(value):.1f}" for key, value in square.items())
            whole = np.sqrt(np.mean(list(square.values())))
            lines.append(f"| {case} | {name} | {np.mean(factors[name]):.3f} | {whole:.2f} | {each} |")
    return lines


def main() -> None:
    """Run the study and write its page."""
    lines = [
        "# Rolling shutter",
        "",
        f"Flights of {IMAGES} images, 1 px noise, 8 m/s, gusts 0.4 m/s and 3 deg/s.",
        "Silent: a global shutter is not rejected at 5 %. Rolling: it is rejected at 0.1 % and the readout",
        "estimated. Largest error of the first seven flights in standard deviations; coverage of 95 %.",
    ]
    for case, what in CASES.items():
        lines += [
            "",
            f"## {what[0].upper() + what[1:]}",
            "",
            "| readout | flights | sigma, ms | silent | rolling | largest | coverage | v'Pv/dof | each |",
            "|---|---|---|---|---|---|---|---|---|",
            *(row(case, readout_ms) for readout_ms in FLIGHTS),
        ]
    lines += [*vibrating(), *check_points()]
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\nwritten to {OUTPUT}\n")


if __name__ == "__main__":
    main()

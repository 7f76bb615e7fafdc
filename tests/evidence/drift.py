"""Long study: is a drift of c through a flight found and named, and is none found in flights without?

Writes `docs/evidence/drift.md`. Drifts of 0.2 % of c from the first exposure to the last, as a camera that
warms, in flights with GNSS, with nine control points, and with both.

Run: `make evidence`, or `python -m tests.evidence.drift [FLIGHTS]`.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numba
import numpy as np

from photocal.analysis.systematic_errors.drift import within_flight
from photocal.analysis.systematic_errors.findings import findings
from photocal.analysis.systematic_errors.refit import fit, with_measurements
from photocal.analysis.systematic_errors.search import search
from tests.photocal.analysis.aerial import LENS, Flight, fly

FLIGHTS, IMAGES, RAYS, DRIFT = 100, 36, 5000, 0.002
CARRIED = {"GNSS": (True, False), "control": (False, True), "both": (True, True)}
SHAPES = ("clean", "drift", "step")
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "drift.md"


def flown(shape: str, gnss: bool, control: bool, seed: int) -> tuple[tuple[str, ...], float, float]:
    """Codes of the findings, deviation of the drift in sigmas, and p of c by thirds."""
    network = fly(Flight(IMAGES, RAYS, sigma_px=0.7, gnss=gnss, control=control), 9_000 + seed).network
    at = np.linspace(-0.5, 0.5, len(network.image_names))
    changed = {"clean": 0.0 * at, "drift": DRIFT * at, "step": DRIFT * np.sign(at) / 2}[shape]
    # The lens with it: only the distance of the image plane changes, by less than a pixel of distortion.
    plane = network.rays.plane * (1.0 + changed[network.rays.image, None])
    first = fit(with_measurements(network, plane))
    found = findings(search(first))
    c = within_flight(first, 0)[0]
    amount, sigma, _ = c.drifts["order"]
    true = LENS["c"] * DRIFT * (shape == "drift")
    return tuple(one.code for one in found), (amount - true) / sigma, c.p_value


def main(flights: int = FLIGHTS) -> None:
    """Fly, analyse, count, and write the page."""
    numba.set_num_threads(1)
    rows = []
    for shape in SHAPES:
        count = flights if shape != "step" else flights // 4
        codes, errors, thirds, first = Counter[str](), [], 0, 0
        for seed in range(count):
            gnss, control = list(CARRIED.values())[seed % len(CARRIED)]
            found, error, p_value = flown(shape, gnss, control, seed)
            codes.update(set(found))
            first += found[:1] == ("c-drift",)
            errors.append(error)
            thirds += p_value < 0.05
            sys.stderr.write(f"\r{shape}: {seed + 1} of {count}, {dict(codes)}   ")
        inside = np.mean(np.abs(errors) < 1.96)
        within = "-" if shape == "step" else f"{100 * inside:.0f} %"
        rows.append(
            f"| {shape} | {count} | {codes['c-drift']} | {first} | {codes['c-step']} | {within} |"
            f" {thirds} | {', '.join(f'{k} {n}' for k, n in codes.most_common())} |"
        )
        sys.stderr.write(f"\n{rows[-1]}\n")
    lines = [
        "# Drift of the principal distance within a flight",
        "",
        f"Flights of {IMAGES} images with GNSS, control points or both in turn, 0.7 px; a third each. Drift:",
        f"{DRIFT:.1%} of c from the first image to the last; step: as much in the middle of the flight.",
        "Coverage: of 95 % by the drift's standard deviation, with the other unknowns (first order).",
        "",
        "| flight | flights | drift named | the gravest | step named | coverage | thirds at 5 % | findings |",
        "|---|---|---|---|---|---|---|---|",
        *rows,
    ]
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

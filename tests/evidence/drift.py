"""Long study: is a drift of c through a flight found and named, and is none found in flights without?

Writes `docs/evidence/drift.md`. Drifts of 0.2 % of c from the first exposure to the last, as a camera that
warms.

Run: `make evidence`, or `python -m tests.evidence.drift`, in portions as `tests.evidence.portions` says.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.adjusted import fit, with_measurements
from photocal.analysis.left_out import within_flight
from photocal.analysis.systematic_errors.findings import findings
from photocal.analysis.systematic_errors.search import causes_in, search
from tests.evidence.portions import outcomes
from tests.photocal.analysis.aerial import LENS, Flight, fly

IMAGES, RAYS, DRIFT = 24, 3000, 0.002
CARRIED = {"GNSS": (True, False), "GNSS and control": (True, True), "nine control points": (False, True)}
# Control alone hardly tells a change of c from one of height: what the sigma of the drift says.
FLIGHTS = {
    ("clean", "GNSS"): 50,
    ("clean", "GNSS and control"): 50,
    ("clean", "nine control points"): 20,
    ("drift", "GNSS"): 50,
    ("drift", "GNSS and control"): 50,
    ("drift", "nine control points"): 10,
    ("step", "GNSS"): 20,
}
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "drift.md"


def flown(shape: str, carried: str, seed: int) -> tuple[list[str], float, float, float]:
    """Codes of the findings, deviation of the drift in sigmas, its sigma as a share, p of c by thirds."""
    gnss, control = CARRIED[carried]
    network = fly(Flight(IMAGES, RAYS, sigma_px=0.7, gnss=gnss, control=control), 9_000 + seed).network
    at = np.linspace(-0.5, 0.5, len(network.image_names))
    changed = {"clean": 0.0 * at, "drift": DRIFT * at, "step": DRIFT * np.sign(at) / 2}[shape]
    # The lens with it: only the distance of the image plane changes, by less than a pixel of distortion.
    plane = network.rays.plane * (1.0 + changed[network.rays.image, None])
    first = fit(with_measurements(network, plane))
    found = findings(search(causes_in(first)))
    c = within_flight(first, 0)[0]
    amount, sigma, _ = c.drifts["order"]
    true = LENS["c"] * DRIFT * (shape == "drift")
    return [one.code for one in found], (amount - true) / sigma, sigma / LENS["c"], c.p_value


def row(shape: str, carried: str, seen: list[Any]) -> str:
    """One line of the table."""
    codes = Counter(code for one in seen for code in set(one[0]))
    first = sum(one[0][:1] == ["c-drift"] for one in seen)
    inside = "-" if shape == "step" else f"{100 * np.mean([abs(one[1]) < 1.96 for one in seen]):.0f} %"
    listed = ", ".join(f"{code} {count}" for code, count in codes.most_common()) or "none"
    thirds = sum(one[3] < 0.05 for one in seen)
    return (
        f"| {shape} | {carried} | {len(seen)} | {codes['c-drift']} | {first} | {codes['c-step']} |"
        f" {100 * np.mean([one[2] for one in seen]):.3f} % | {inside} | {thirds} | {listed} |"
    )


def main() -> None:
    """Fly, analyse, count, and write the page."""
    cases = [
        (*which, seed)
        for seed in range(max(FLIGHTS.values()))
        for which, flights in FLIGHTS.items()
        if seed < flights
    ]
    found = outcomes(iter(cases), len(cases), flown)
    rows = []
    for which in FLIGHTS:
        seen = [outcome for case, outcome in found.items() if case[:2] == which]
        rows += [row(*which, seen)] if seen else []
    OUTPUT.write_text(page(rows), encoding="utf-8")


def page(rows: list[str]) -> str:
    """The page with its rows."""
    heads = (
        *("flight", "datum by", "flights", "drift named", "as the gravest", "step named"),
        *("sigma of the drift", "coverage", "thirds at 5 %", "findings"),
    )
    lines = [
        "# Drift of the principal distance within a flight",
        "",
        f"Flights of {IMAGES} images, 0.7 px of noise. Drift: c changes by {DRIFT:.1%} from the first",
        "image to the last; step: by the same amount in the middle of the flight. Coverage: share of the",
        "95 % intervals of the drift that contain its true value, all other unknowns being free. Thirds:",
        "flights in which c differs between thirds of the flight at 5 %. Control points alone hardly",
        "separate a change of c from a change of height.",
        "",
        f"| {' | '.join(heads)} |",
        "|" + "---|" * len(heads),
        *rows,
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()

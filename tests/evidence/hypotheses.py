"""Long study: what both commands name in flights with one fault, with none, and with what nobody looks for.

Writes `docs/evidence/hypotheses.md`. The flights are those of `tests.independent`, which shares no code with
the product. `hypotheses_before.csv` has what the version of dce6bc09 said of the same flights.

Run: `make evidence`, or `python -m tests.evidence.hypotheses`, in portions as `tests.evidence.portions` says;
`HYPOTHESES_SEEDS` in the environment is the number of clean flights of each design, 25 without.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np

import photocal
from tests.evidence.hypotheses_tables import page
from tests.evidence.judging import chance, errors_in_sigmas, fly, judged
from tests.evidence.portions import Case, outcomes
from tests.independent.detectable import detectable, scaled
from tests.independent.faults import BASE, CLEAN, ESTIMATED, FOUR, NO_CONTROL, UNUSUAL, Fault, table
from tests.independent.flights import Design, Errors, world
from tests.independent.folder import Placement
from tests.independent.rows import Row, read_rows, write_rows

HERE = Path(__file__)
OUTPUT = HERE.parents[2] / "docs" / "evidence" / "hypotheses.md"
BEFORE = HERE.with_name("hypotheses_before.csv")
SEEDS = int(os.environ.get("HYPOTHESES_SEEDS", "25"))
# Flights of a kind for the 25 clean ones of a design.
SHARE = {"clean": 1.0, "unusual": 0.4, "fault": 0.2, "power": 0.4, "placed": 0.12, "cost": 0.04}
LARGE = 300
PLACES = {
    "turned": Placement(turn_deg=37.0),
    "moved": Placement(shift_m=(512_000.0, 7_100_000.0, 310.0)),
    "renamed": Placement(prefix="a-"),
    "by two cameras": Placement(cameras=2),
}
PLACED = ("none", "time 50 ms", "one of 6 control points, 30 cm in plane", "y scale 1e-3", "antenna 0.5 m")
COST = tuple(replace(BASE, name=f"{n} images", images=n, control=10) for n in (30, 300, 1000))
COVERED = (BASE, FOUR, NO_CONTROL, ESTIMATED)
DESIGNS = {design.name: design for design in (*CLEAN, *UNUSUAL, *COST, *COVERED)}
NONE = Fault("none", Errors(), ())
FAULTS = {fault.name: fault for fault in (*table(), NONE)}
# Faults of one amount, flown at twice what a test of it finds in 80 % of cases.
POWER = (
    "time 20 ms",
    "lever arm 20 cm right",
    "base 30 cm in plane",
    "antenna 0.5 m",
    "c step 0.1%",
    "c held 0.10% wrong, six control points",
    "one of 4 control points, 30 cm Z",
    "one of 6 control points, 30 cm Z",
    "one of 6 control points, 30 cm in plane",
    "one of 10 control points, 30 cm in plane",
    "two control points, 30 cm Z",
    "rolling 15 ms",
    "K3, 4 px at the corner",
    "K4, 4 px at the corner",
    "P1, P2 left out",
    "y scale 1e-4",
    "shear 1e-4",
    "one position 0.3 m",
    "positions' scale 400 ppm",
    "refraction 0.17, 10 km high",
)
TWICE = 2.0


def cases(seeds: int) -> Iterator[Case]:
    """List the flights, seed by seed: any number of them is of all kinds."""
    for seed in range(seeds):
        # Large flights are the last of their seed, and fewer.
        for kind, names in (
            ("cost", [design.name for design in COST]),
            ("fault", [fault.name for fault in table()]),
            ("power", list(POWER)),
            ("clean", [design.name for design in CLEAN]),
            ("unusual", [design.name for design in UNUSUAL]),
            ("placed", [f"{place}: {name}" for place in ("as flown", *PLACES) for name in PLACED]),
        ):
            for name in names:
                share = SHARE[kind] * (0.2 if kind == "clean" and DESIGNS[name].images > LARGE else 1.0)
                # Errors that are alike from exposure to exposure differ from flight to flight.
                share = 1.0 if kind == "unusual" and DESIGNS[name].memory else share
                if seed < max(1, round(share * seeds)):
                    yield kind, name, seed
    for seed in range(8 * seeds):
        yield from (("coverage", design.name, seed) for design in COVERED)


def run(kind: str, name: str, seed: int) -> Any:
    """Fly one case: the cells of its row; of coverage the errors in sigmas."""
    if kind == "coverage":
        return covered(DESIGNS[name], seed)
    if kind == "cost":
        # What is compiled at first use is no cost of a flight.
        judged(kind, "warm", replace(BASE, images=30), Errors(), seed)
    if kind in ("clean", "unusual", "cost"):
        return astuple(judged(kind, name, DESIGNS[name], Errors(), seed))
    if kind == "placed":
        place, wrong = name.split(": ", 1)
        at = PLACES.get(place, Placement())
        return astuple(judged(kind, name, FAULTS[wrong].design, FAULTS[wrong].errors, seed, at))
    fault = FAULTS[name]
    errors = fault.errors
    if kind == "power":
        truth = world(fault.design, chance(fault.design, seed))
        errors = scaled(errors, TWICE * detectable(truth, fault.design, errors))
    return astuple(judged(kind, name, fault.design, errors, seed))


def covered(design: Design, seed: int) -> dict[str, list[float]]:
    """Adjust a flight: of each parameter its errors in sigmas, of poses and points mean square and inside."""
    with tempfile.TemporaryDirectory() as scratch:
        flown = fly(Path(scratch) / "block", design, Errors(), 10_000 + seed)
        z = errors_in_sigmas(photocal.adjust(photocal.read_block(flown.folder)), flown)
    return {
        name: [float(np.mean(np.square(values))), float(np.mean(np.abs(values) < 1.96))]
        for name, values in z.items()
    }


def main() -> None:
    """Fly, judge, and write the page; with HYPOTHESES_ROWS its rows, too."""
    every = list(cases(SEEDS))
    found = outcomes(iter(every), len(every), run)
    rows = [Row(*cells) for case, cells in found.items() if case[0] != "coverage"]
    coverage = {(case[1], case[2]): cells for case, cells in found.items() if case[0] == "coverage"}
    if "HYPOTHESES_ROWS" in os.environ:
        write_rows(Path(os.environ["HYPOTHESES_ROWS"]), rows)
    before = read_rows(BEFORE) if BEFORE.is_file() else []
    OUTPUT.write_text(page(FAULTS, before, rows, coverage), encoding="utf-8")


if __name__ == "__main__":
    main()

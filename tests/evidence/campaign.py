"""Long study: seven flights of one camera, and an eighth after its lens was touched.

Writes `docs/evidence/campaign.md`. The design of the study of seven calibrations of one camera
(configs/studies/canon-elph/calibrations.toml), each used in the others, with simulated flights whose truth is
known: one vehicle over one field, other days; processed from raw GNSS, telemetry and image observations, then
`photocal compare --exchange`.

Run: `make evidence`, or `python -m tests.evidence.campaign`.
"""

from __future__ import annotations

import datetime as dt
import json
import os
import sys
import tempfile
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from photocal.commands.cli import app
from photocal.run.calibrations import read_calibrated
from photocal.run.campaign import run_one
from tests.simulated import FLIGHT, fly

DAY = dt.date(2025, 6, 16)
FLIGHTS = 7
# The lens is touched before the eighth: its focal length grows by this share.
TOUCHED = 0.001
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "campaign.md"


def flown(task: tuple[Path, int]) -> Path:
    """Fly and process one day of the campaign; its project."""
    folder, day = task
    camera = tomllib.loads(FLIGHT.read_text(encoding="utf-8"))["camera"]
    if day > FLIGHTS:
        camera |= {key: camera[key] * (1 + TOUCHED) for key in ("fx", "fy")}
    project = fly(folder, field_seed=1, seed=day, camera=camera, name=f"day {day}")
    run_one(project, DAY, until="calibration")
    return project


def calibrated(projects: list[Path]) -> list[str]:
    """Table of c, x0, y0 with their standard deviations."""
    lines = ["| flight | c, mm | x0, mm | y0, mm |", "|---|---|---|---|"]
    for flight in read_calibrated(projects):
        (camera,) = flight.cameras.values()
        cells = [f"{camera.value(name):.4f} ± {camera.sigma_of(name):.4f}" for name in ("c", "x0", "y0")]
        lines.append(f"| {flight.name} | {' | '.join(cells)} |")
    truth = json.loads((projects[0].parents[1] / "truth" / "truth.json").read_text(encoding="utf-8"))
    cells = [f"{truth['camera']['mm'][name]:.4f}" for name in ("c", "x0", "y0")]
    return [*lines, f"| truth of the first {FLIGHTS} | {' | '.join(cells)} |"]


def stability(figures: dict[str, Any]) -> list[str]:
    """Table of the pairs by method: how many differ beyond the noise of both."""
    last = figures["cameras"][-1]
    within, beyond = f"pairs of the {FLIGHTS}: largest, px", "pairs with the eighth: least, px"
    lines = [f"| method | {within} | differ (95 %) | {beyond} | differ |", "|---|---|---|---|---|"]
    kinds = [(one["method"], one["definition"]) for one in figures["pairs"][0]["figures"]]
    for k, kind in enumerate(kinds):
        groups: dict[bool, list[dict[str, Any]]] = {False: [], True: []}
        for pair in figures["pairs"]:
            groups[last in (pair["first"], pair["second"])].append(pair["figures"][k])
        cells = []
        for touched, pick in ((False, max), (True, min)):
            values = [one["value_px"] for one in groups[touched]]
            differ = sum(bool(one["different"]) for one in groups[touched])
            cells += [f"{pick(values):.2f}", f"{differ} of {len(values)}"]
        lines.append(f"| {kind[0]}, {kind[1]} | {' | '.join(cells)} |")
    return lines


def uses(figures: dict[str, Any]) -> list[str]:
    """Table of the check points: a flight with its own calibration, with another's, with the eighth's."""
    last = figures["cameras"][-1]
    groups: dict[str, list[dict[str, Any]]] = {}
    for one in figures["exchange"]:
        if one["used_in"] != last:
            others = "the eighth's" if one["of"] == last else f"another of the {FLIGHTS}"
            groups.setdefault("its own" if one["of"] == one["used_in"] else others, []).append(one)
    lines = [
        "| calibration used | uses | RMSE X, Y, Z, mm | predicted, mm | errors / prediction |",
        "|---|---|---|---|---|",
    ]
    for name, group in groups.items():
        cells = []
        for key in ("rmse_m", "predicted_m"):
            values = 1e3 * np.sqrt(np.mean([np.square(one[key]) for one in group], axis=0))
            cells.append(" / ".join(f"{value:.0f}" for value in values))
        ratio = float(np.sqrt(np.mean([one["ratio"] ** 2 for one in group])))
        lines.append(f"| {name} | {len(group)} | {' | '.join(cells)} | {ratio:.2f} |")
    return lines


def main() -> None:
    """Fly the campaign and write the tables."""
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["NUMBA_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory() as scratch:
        days = [(Path(scratch) / f"day{day}", day) for day in range(1, FLIGHTS + 2)]
        with ProcessPoolExecutor(2) as pool:
            projects = list(pool.map(flown, days))
        said = CliRunner().invoke(app, ["compare", *map(str, projects), "--exchange", "--json"])
        if said.exception is not None:
            raise said.exception
        figures = json.loads(said.stdout)
        lines = [
            "# A campaign: seven flights of one camera, and an eighth after its lens was touched",
            "",
            "Eight simulated flights of the plan `survey` over one field with one rig, without pictures,",
            "from raw GNSS and telemetry. Before the eighth the principal distance grows by a thousandth.",
            "The eight projects are compared by `photocal compare --exchange`.",
            "",
            *calibrated(projects),
            "",
            "## Stability of the interior orientation",
            "",
            *stability(figures),
            "",
            "## Camera and mounting of one flight used in another",
            "",
            f"Direct georeferencing at the check points of the first {FLIGHTS} flights.",
            "",
            *uses(figures),
        ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"{OUTPUT.name} written\n")


if __name__ == "__main__":
    main()

"""Long study: each fault of a flight switched on alone must be named by the processing.

Writes `docs/evidence/faults.md`. Flights of the demonstration with streams (raw GNSS, telemetry, time marks)
and image observations instead of pictures, imported, and processed to the certificate.

Run: `make evidence`, or `python -m tests.evidence.faults [SEEDS]`.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import html
import io
import json
import os
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numba

from acquire.simulate.world.faults import Fault
from drivers.errors import PhotocalError
from photocal.run.campaign import run_one
from photocal.run.summary import summary_text
from tests.simulated import fly

SEEDS = 3
# A quarter of those of the flight: faults show at the targets and in the positions.
TIES = 200
DAY = dt.date(2025, 6, 16)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "faults.md"
NAMES = {
    Fault.ANTENNA_HEIGHT: "antenna-height",
    Fault.BASE_OFF: "base-position",
    Fault.EVENT_TIME_BASE: "event-time-base",
    Fault.LEVER_ARM_AXIS: "lever-arm-axes",
    Fault.ZOOM: "camera-change",
    Fault.CONTROL_DIGITS: "control-mistyped",
    Fault.MISSING_IMAGES: "events-without-image",
    Fault.TELEMETRY_GAP: "telemetry-gap",
    Fault.CYCLE_SLIPS: "ppk-not-fixed",
}


@dataclass(frozen=True)
class Processed:
    """What the processing said of one flight.

    Attributes
    ----------
    shown : str
        What a person saw: the summary, or what stood before the refusal.
    warnings : tuple of str
        Their codes, each once.
    certificate : str or None
        All that the certificate says in its two forms; None when there is none.
    refusal : str
        Empty for none.
    """

    shown: str
    warnings: tuple[str, ...]
    certificate: tuple[str, str] | None
    refusal: str


def processed(task: tuple[Fault | None, int]) -> Processed:
    """Fly with a fault or without one, and process to the certificate."""
    fault, seed = task
    numba.set_num_threads(1)
    with tempfile.TemporaryDirectory() as scratch:
        project = fly(
            Path(scratch) / "flight", seed=seed, faults=frozenset({fault} - {None}), observing={"ties": TIES}
        )
        said = io.StringIO()
        try:
            with contextlib.redirect_stderr(said):
                figures = run_one(project, DAY)
        except PhotocalError as refusal:
            lines = [line.split(": ", 3) for line in said.getvalue().splitlines()]
            codes = tuple(dict.fromkeys(line[2] for line in lines if line[1:2] == ["warning"]))
            if (project.parent / "work" / "certificate").exists():
                raise AssertionError("a certificate of a run that failed") from refusal
            return Processed(said.getvalue(), codes, None, str(refusal))
        codes = tuple(dict.fromkeys(one["code"] for one in figures["warnings"] if one["kind"] == "warning"))
        folder = project.parent / "work" / "certificate"
        record = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
        page = html.unescape((folder / "certificate.html").read_text(encoding="utf-8"))
        return Processed(summary_text(figures), codes, ("\n".join(record["warnings"]), page), "")


def row(fault: Fault | None, flights: list[Processed]) -> str:
    """Line of the table."""
    name = "" if fault is None else NAMES[fault]
    others = Counter(code for one in flights for code in one.warnings if code != name)
    count = len(flights)
    certified = [one.certificate for one in flights if one.certificate is not None]
    if fault is None:
        cells = ["none", "", f"silent in {sum(not one.warnings for one in flights)} of {count}"]
        cells.append(f"silent in {sum(not json_form for json_form, _ in certified)} of {len(certified)}")
    else:
        named = sum(f"{name}: " in one.shown for one in flights)
        written = sum(all(f"{name}: " in form for form in forms) for forms in certified)
        cells = [fault.value, f"`{name}`", f"{named} of {count}"]
        cells.append(f"{written} of {len(certified)}" if certified else "-")
    cells.append(str(count - len(certified)))
    cells.append(", ".join(f"{code} {times}" for code, times in sorted(others.items())) or "-")
    return "| " + " | ".join(cells) + " |"


def page(found: dict[Fault | None, list[Processed]]) -> list[str]:
    """All that is written."""
    refusals = sorted({one.refusal for flights in found.values() for one in flights if one.refusal})
    return [
        "# Each fault alone",
        "",
        "Flights of `configs/demo/simulated/flight.toml` with one fault each, from raw GNSS and",
        f"telemetry to the certificate; observations instead of pictures, {TIES} tie points. Named: the",
        "code stands in the summary of `photocal run`, or before the error that ends it. Certified: of the",
        "certificates that were written, those that have the code in their JSON and on their page. Without",
        "certificate: runs that ended with an error. Last: in how many flights.",
        "",
        "| fault | name | named | certified | without certificate | what else was said |",
        "|---|---|---|---|---|---|",
        *(row(fault, flights) for fault, flights in found.items()),
        "",
        "Errors that ended runs:",
        "",
        *(f"- {refusal}" for refusal in refusals or ["none"]),
    ]


def main(seeds: int = SEEDS) -> None:
    """Switch on each fault alone and write the table."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    tasks = [(fault, seed) for fault in (None, *NAMES) for seed in range(1, seeds + 1)]
    found: dict[Fault | None, list[Processed]] = {}
    with ProcessPoolExecutor(2) as pool:
        for (fault, _), one in zip(tasks, pool.map(processed, tasks), strict=True):
            found.setdefault(fault, []).append(one)
            if len(found[fault]) == seeds:
                sys.stderr.write(row(fault, found[fault]) + "\n")
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(page(found)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))

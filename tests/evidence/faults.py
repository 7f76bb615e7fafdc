"""Long study: each fault of a flight switched on alone must be named by the processing.

Writes `docs/evidence/faults.md`. Flights of the demonstration with streams (raw GNSS, telemetry, time marks)
and image observations instead of pictures, imported, and processed up to the georeferencing.

Run: `make evidence`, or `python -m tests.evidence.faults`.
"""

from __future__ import annotations

import datetime as dt
import sys
import tempfile
from pathlib import Path

from acquire.importing.importer import import_recordings
from acquire.simulate.world.configuration import read_configuration
from acquire.simulate.world.site import simulate_flight
from drivers.errors import PhotocalError
from photocal.run.campaign import run_one
from photocal.run.warnings import gather

ROOT = Path(__file__).parents[2]
FLIGHT = ROOT / "configs" / "demo" / "simulated" / "flight.toml"
OUTPUT = ROOT / "docs" / "evidence" / "faults.md"
NAMED = {
    "": "",
    "wrong_antenna_height": "antenna-height",
    "base_off": "base-position",
    "event_time_base": "event-time-base",
    "lever_arm_axis": "lever-arm-axes",
    "zoom": "camera-change",
    "control_digits": "control-mistyped",
    "missing_images": "events-without-image",
    "telemetry_gap": "telemetry-gap",
    "cycle_slips": "ppk-not-fixed",
}


def warnings_of(fault: str, folder: Path) -> list[dict[str, str]]:
    """Fly with a fault, process, and return the warnings."""
    faults = {"faults": frozenset({fault})} if fault else {}
    simulate_flight(read_configuration(FLIGHT, {"level": "observations", **faults}), folder, lambda _: None)
    site = folder / "site"
    streams = [
        (link, site / name)
        for link, name in (("vehicle", "vehicle.tlog"), ("rover", "rover.ubx"), ("base", "base.ubx"))
    ]
    import_recordings(streams, [], site / "flight.mcap", lambda _: None)
    try:
        run_one(site / "project.toml", dt.date(2025, 6, 16), "georeferencing", None)
    except PhotocalError as refusal:
        sys.stderr.write(f"{refusal}\n")
    return [one.as_json() for one in gather(site / "work") if not one.note]


def main() -> None:
    """Switch on each fault alone and write the table."""
    rows = ["| fault | named as | what else was said |", "|---|---|---|"]
    for fault, name in NAMED.items():
        with tempfile.TemporaryDirectory() as scratch:
            (Path(scratch) / "flight").mkdir()
            found = warnings_of(fault, Path(scratch) / "flight")
        codes = list(dict.fromkeys(one["code"] for one in found))
        others = ", ".join(code for code in codes if code != name) or "-"
        verdict = (name if name in codes else f"NOT NAMED ({name})") if name else "nothing to name"
        rows.append(f"| {fault or 'none'} | {verdict} | {others} |")
        sys.stderr.write(rows[-1] + "\n")
    lines = [
        "# Each fault alone",
        "",
        "Flights of `configs/demo/simulated/flight.toml` with one fault each, from raw GNSS and telemetry to",
        "the check points. Named: the code stands among the warnings of `photocal run`, and so in the",
        "certificate.",
        "",
        *rows,
    ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Study of whole flights with pictures: other cameras, places, terrain, picture quality; against the truth.

Writes `docs/evidence/pictures.md`. Each flight goes from its pictures and raw streams through `photocal run`
to the certificate; nothing is given but what a project file holds. Deviations are estimate less truth over
the estimate's own standard deviation.

Run: `make evidence`, or `python -m tests.evidence.pictures [NUMBER ...]`.
"""

from __future__ import annotations

import copy
import datetime as dt
import json
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from photocal.demo.simulated import ComparedQuantity, against_truth
from photocal.run.campaign import run_one
from tests.simulated import FLIGHT, fly

DAY = dt.date(2025, 6, 16)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "pictures.md"

NORTH = {
    "latitude_deg": 61.2,
    "longitude_deg": 24.3,
    "height_m": 130.0,
    "crs": "EPSG:3067",
    "start_utc": dt.datetime(2025, 6, 15, 14, tzinfo=dt.UTC),
    "geoid_m": 19.2,
}
LONG_LENS = {
    "size_px": [1800, 1350],
    "nominal_mm": 12.6,
    "fx": 1745.2,
    "fy": 1745.9,
    "cx": 890.3,
    "cy": 679.4,
    "k1": 0.085,
    "k2": -0.21,
    "k3": 0.1,
}
POOR = {"noise_grey": 4.0, "blur_px": 0.9, "quality": 75}
ROLLING = {"seed": 8, "camera": {"readout_s": 0.03}, "speed_m_s": 8.0}
# Name of the flight, and what differs from the plan, table by table.
FLIGHTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("the demonstration", {}),
    ("another seed", {"seed": 2}),
    ("a third seed", {"seed": 3}),
    (
        "longer lens, pincushion, higher, 61 degrees north",
        {"seed": 4, "place": NORTH, "camera": LONG_LENS, "heights_m": (60.0, 78.0)},
    ),
    (
        "strong barrel distortion, relief of 12 m, another lever arm",
        {
            "seed": 5,
            "terrain": {"relief_m": 12.0, "longest_m": 60.0},
            "camera": {"k1": -0.12, "k2": 0.05},
            "rig": {"camera_to_antenna_m": [-0.15, 0.10, -0.40]},
        },
    ),
    ("noisy, blurred, strongly compressed pictures", {"seed": 6, "pictures": POOR}),
    ("such pictures, another seed", {"seed": 7, "pictures": POOR}),
    ("rolling shutter, 30 ms, at 8 m/s", ROLLING),
    # Vibration moves lines against each other by 0.2 px within the readout.
    ("the same without vibration", {**ROLLING, "vehicle": {"vibration_deg": 0.0}}),
)


def plan_of(changes: dict[str, Any]) -> dict[str, Any]:
    """Give the tables of the demonstration's plan with the changes of a flight."""
    plan = tomllib.loads(FLIGHT.read_text(encoding="utf-8"))
    made = copy.deepcopy(plan)
    for name, value in changes.items():
        if name == "heights_m":
            for one, height in zip(made["plan"]["pass"], value, strict=True):
                one["height_m"] = height
        elif name == "speed_m_s":
            for one in made["plan"]["pass"]:
                one["speed_m_s"] = value
        else:
            made[name] = {**made.get(name, {}), **value} if isinstance(value, dict) else value
    return made


def flown(number: int, changes: dict[str, Any]) -> list[str]:
    """Fly, process and compare one flight: its line of each table."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "flight"
        made = plan_of(changes)
        project = fly(folder, **{**made, "level": "pictures"})
        figures = run_one(project, DAY, progress=_quiet, say=_say)
        rows = against_truth(folder / "truth", project.parent / "work")
        together = _together(folder / "truth", project.parent / "work")
        return _line(number, figures, rows, together)


def _together(truth: Path, work: Path) -> str:
    """d' C^-1 d of the whole interior orientation, and its degrees of freedom."""
    whole = json.loads((truth / "truth.json").read_text(encoding="utf-8"))
    true = whole["camera"]
    result = json.loads((work / "calibration" / "result.json").read_text(encoding="utf-8"))
    camera = result["cameras"][true["id"]]
    found = [camera["parameters"][name] for name in camera["correlation"]["names"]]
    given = {**true[camera["unit"]], "readout": whole["rig"]["readout_s"]}
    values = [given.get(name, 0.0) for name in camera["correlation"]["names"]]
    z = np.array([(one["value"] - value) / one["sigma"] for one, value in zip(found, values, strict=True)])
    return f"{z @ np.linalg.solve(np.array(camera['correlation']['matrix']), z):.1f} of {len(z)}"


def _line(
    number: int, figures: dict[str, Any], rows: tuple[ComparedQuantity, ...], together: str
) -> list[str]:
    by_name = {row.name: row for row in rows}
    own = [row for row in rows if not row.name.startswith(("antenna", "direct", "integrated", "indirect"))]
    lens = [row for row in own if row.name[0] in "KPB"]
    rig = [row for row in own if row.name.startswith(("lever", "boresight", "time"))]
    rms = 1e3 * np.array([by_name[f"antenna positions, rms {axis}"].estimate for axis in _AXES])
    check = [by_name[f"{method}, check errors/prediction"].estimate for method in _METHODS]
    told = json.dumps(sorted({one["code"] for one in figures["warnings"] if one["kind"] == "warning"}))
    return [
        str(number),
        *(f"{by_name[name].deviation:+.2f}" for name in ("c", "x0", "y0")),
        _worst(lens),
        _worst(rig),
        together,
        " / ".join(f"{value:.1f}" for value in rms),
        " / ".join(f"{value:.2f}" for value in check),
        told.strip("[]").replace('"', "") or "none",
    ]


_AXES = ("east", "north", "height")
_METHODS = ("direct", "integrated", "indirect")


def _worst(rows: list[ComparedQuantity]) -> str:
    worst = max(rows, key=lambda row: abs(row.deviation))
    return f"{worst.name} {worst.deviation:+.2f}"


def main(chosen: list[int]) -> None:
    """Fly all and write the table."""
    lines = [
        "# Whole flights with pictures",
        "",
        "Made by `python -m tests.evidence.pictures`.",
        "",
        "The flight of `acquire/simulate/flights/survey.toml` (some forty pictures of 2 megapixels, eight",
        "control and twelve check points), and others that differ from it as listed. Deviations are in",
        "standard deviations of the estimate: those of c, x0, y0, then the largest of the distortion and",
        "of the mounting. Together: d' C^-1 d of the interior orientation, whose expected value is its",
        "degrees of freedom. Antenna positions: rms of the PPK errors in mm, east / north / height. Check",
        "points: errors over their prediction, direct / integrated / indirect.",
        "",
        *(f"{number}. {name}" for number, (name, _) in enumerate(FLIGHTS, start=1)),
        "",
        "Flight 8: the vehicle vibrates by 0.01 degrees at 20 to 60 Hz. This moves the lines of a picture",
        "against each other by 0.2 px within 30 ms.",
        "",
        "| flight | c | x0 | y0 | distortion | mounting | together | antenna, mm | check points | warnings |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for number, (name, changes) in enumerate(FLIGHTS, start=1):
        if chosen and number not in chosen:
            continue
        _say(f"{number}: {name}")
        cells = flown(number, changes)
        _say(" | ".join(cells))
        lines.append(f"| {' | '.join(cells)} |")
    if not chosen:
        OUTPUT.parent.mkdir(parents=True, exist_ok=True)
        OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
        _say(f"{OUTPUT.name} written")


@contextmanager
def _quiet(_: str, __: float | None) -> Iterator[Any]:
    yield lambda _: None


def _say(text: object) -> None:
    # Figures with a verdict come at the end, too.
    if isinstance(text, str):
        sys.stderr.write(f"{text}\n")


if __name__ == "__main__":
    main([int(one) for one in sys.argv[1:]])

"""What the processing found against the truth of a simulated flight."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.results.folder import read_result
from photocal.results.result import Result

_LEVER = ("lever_arm_x", "lever_arm_y", "lever_arm_z")
_BORESIGHT = ("boresight_x", "boresight_y", "boresight_z")
_WITHIN = 3.0


@dataclass(frozen=True)
class Row:
    """One quantity.

    true, found, sigma: truth, estimate and its standard deviation.
    limit: largest deviation in standard deviations at which they agree.
    """

    name: str
    unit: str
    true: float
    found: float
    sigma: float
    limit: float = _WITHIN

    @property
    def deviation(self) -> float:
        """Estimate less truth in standard deviations."""
        return (self.found - self.true) / self.sigma

    @property
    def agrees(self) -> bool:
        """Whether the truth lies within the limit."""
        return abs(self.deviation) <= self.limit


def against_truth(truth: Path, work: Path) -> tuple[Row, ...]:
    """Compare a run with the truth of its flight."""
    true = json.loads((truth / "truth.json").read_text(encoding="utf-8"))
    result = read_result(work / "calibration")
    check = json.loads((work / "georeferencing" / "check.json").read_text(encoding="utf-8"))
    rows = [*_camera(true, result), *_mounting(true, result)]
    if (truth / "exposures.csv").is_file() and (work / "ppk").is_dir():
        rows += _positions(truth, work)
    return (*rows, *_check_points(check))


def _camera(true: dict[str, Any], result: Result) -> Iterator[Row]:
    camera = result.cameras[true["camera"]["id"]]
    for name in camera.free:
        value = float(true["camera"][camera.unit].get(name, 0.0))
        unit = camera.unit if name in ("c", "x0", "y0") else ""
        yield Row(name, unit, value, camera.value(name), camera.sigma_of(name))


def _mounting(true: dict[str, Any], result: Result) -> Iterator[Row]:
    rig, mounting = true["rig"], result.mounting or {}
    truths = [*rig["camera_to_antenna_m"], *rig["boresight_deg"], rig["time_offset_s"]]
    units = ["m"] * 3 + ["deg"] * 3 + ["s"]
    for name, value, unit in zip((*_LEVER, *_BORESIGHT, "time_offset"), truths, units, strict=True):
        found = mounting[name]
        if found.estimated:
            yield Row(name.replace("_", " "), unit, value, found.value, found.sigma)


def _positions(truth: Path, work: Path) -> Iterator[Row]:
    """Antenna positions at the events by PPK: root mean square of their errors against 3 cm."""
    true = {row["image"]: row for row in _rows(truth / "exposures.csv")}
    squares: dict[str, list[float]] = {axis: [] for axis in "XYZ"}
    for row in _rows(work / "block" / "positions.csv"):
        for axis, key in zip("XYZ", ("antenna_E", "antenna_N", "antenna_h"), strict=True):
            squares[axis].append((float(row[axis]) - float(true[row["image"]][key])) ** 2)
    for axis, word in zip("XYZ", ("east", "north", "height"), strict=True):
        rms = math.sqrt(sum(squares[axis]) / len(squares[axis]))
        yield Row(f"antenna positions, rms {word}", "m", 0.0, rms, 0.03, 1.0)


def _check_points(check: dict[str, Any]) -> Iterator[Row]:
    """Check points by each method: the root of the mean of d' C^-1 d / 3 is 1 when the prediction holds."""
    for name, method in check["methods"].items():
        count = method["check"]["n"]
        ratio = method["check"]["errors_over_prediction"]
        if count and ratio is not None:
            # Points of one flight share errors: their mean square varies as that of one point at most.
            yield Row(f"{name}, check errors/prediction", "", 1.0, ratio, 1.0 / math.sqrt(6.0))


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def table(rows: tuple[Row, ...]) -> str:
    """Write the comparison for people."""
    lines = [f"{'':<36}{'truth':>13}{'found':>13}{'sigma':>11}{'deviation':>11}"]
    for row in rows:
        mark = "" if row.agrees else "  <--"
        cells = f"{_number(row.true):>13}{_number(row.found):>13}{_number(row.sigma):>11}"
        name = f"{row.name} {row.unit}".rstrip()
        lines.append(f"{name:<36}{cells}{row.deviation:>11.2f}{mark}")
    return "\n".join(lines)


def _number(value: float) -> str:
    return f"{value:.3e}" if value and abs(value) < 1e-3 else f"{value:.5f}"

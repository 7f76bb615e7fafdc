"""DBAT's interior orientation and ours, both ways.

DBAT (Damped Bundle Adjustment Toolbox) and PhotoModeler: image coordinates in px, x right, y down, from the
upper-left corner of the upper-left pixel, whose centre is (0.5, 0.5): the middle of an image of w x h pixels
is (w/2, h/2), half a pixel more than in our count. Interior orientation in mm: principal point (px, py) from
that same corner, y down; K and P with the opposite sign of ours; aspect = 1 - as, where as stretches x.

Lens models: -1 distorts the projection (`brown-ideal`); 1 and 2 correct the measurement and have no affinity;
3 applies the affinity before the correction; 4 after it; 5 scales x from the corner, before the principal
point is subtracted (a model 3 whose px is larger by the factor 1 + as), and skews after the correction.
Source: Boerlin, Murtiyoso, Grussenmeyer, Menna and Nocerino 2019, "Flexible photogrammetric computations
using modular bundle adjustment", PE&RS 85(5).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.base.errors import InputMalformedError
from photocal.exchange.source import Line, number, read_lines
from photocal.geometry.camera import PARAMETERS, Affinity, Camera, Model, camera

# What one field of the file stands for.
_SPREAD = {"sxy": ("sx", "sy"), "sxyz": ("sx", "sy", "sz")}
# DBAT's names in the order of its reports.
NAMES = ("cc", "px", "py", "as", "sk", "K1", "K2", "K3", "K4", "P1", "P2")
MODELS: dict[int, tuple[Model, Affinity]] = {
    -1: ("brown-ideal", "additive"),
    1: ("brown-observed", "additive"),
    2: ("brown-observed", "additive"),
    3: ("brown-observed", "before"),
    4: ("brown-observed", "after"),
    5: ("brown-observed", "before"),
}
WITH_AFFINITY = (3, 4, 5)
OURS = ("c", "x0", "y0", "B1", "B2", "K1", "K2", "K3", "K4", "P1", "P2")


@dataclass(frozen=True)
class DbatRow:
    """One row of a table; `cells`: text by field, blanks removed."""

    line: Line
    cells: dict[str, str]

    def value(self, field: str, default: float | None = None) -> float:
        """Number in a field; the default stands for a missing field, None forbids that."""
        if field in self.cells:
            return number(self.cells[field], self.line.place, field)
        if default is None:
            raise self.line.malformed(f"has no field {field}", "name it in the format")
        return default

    def name(self, field: str) -> str:
        """Identifier in a field; leading zeros of a number do not matter."""
        text = self.cells.get(field, "")
        if not text:
            raise self.line.malformed(f"has no {field}", "give every row its id")
        return str(int(text)) if text.isdecimal() else text

    def sigma(self) -> tuple[float, float, float]:
        """Standard deviations in x, y, z; 0 where the table has none."""
        values = (self.value("sx", 0.0), self.value("sy", 0.0), self.value("sz", 0.0))
        if min(values) < 0:
            raise self.line.malformed("a standard deviation is negative")
        return values


def read_rows(path: Path, layout: str, allowed: tuple[str, ...]) -> Iterator[DbatRow]:
    """Read the rows of a table whose columns a format names."""
    fields = [field.strip() for field in layout.split(",")]
    for field in fields:
        if field not in allowed:
            raise InputMalformedError(
                f"format {layout!r} has the unknown field {field!r}", f"use {', '.join(allowed)}", where=path
            )
    for line in read_lines(path):
        cells = [cell.strip() for cell in line.text.split(",")]
        if len(cells) != len(fields):
            raise line.malformed(
                f"has {len(cells)} cells where the format {layout!r} has {len(fields)}",
                "write decimal points, not commas"
                if len(cells) > len(fields)
                else "complete the row, or is the file truncated?",
            )
        row: dict[str, str] = {}
        for field, cell in zip(fields, cells, strict=True):
            row.update(dict.fromkeys(_SPREAD.get(field, (field,)), cell))
        yield DbatRow(line, row)


def from_dbat(
    name: str,
    number: int,
    size_px: tuple[int, int],
    pixel_mm: float,
    described: dict[str, float],
    estimate: tuple[str, ...],
    place: object,
) -> Camera:
    """Turn DBAT's description into a camera, whose polynomial DBAT evaluates at the measured coordinates.

    number: of the lens model, -1 or 1 to 5.
    pixel_mm: height of a pixel; its width is (1 + as) times this.
    described, estimate: by `NAMES`, in mm.
    """
    malformed = InputMalformedError.at(place)
    if number not in MODELS:
        raise malformed(f"lens model {number} is not known", "use -1 or 1 to 5")
    value = dict.fromkeys(NAMES, 0.0) | described
    if number not in WITH_AFFINITY:
        if value["as"] or value["sk"]:
            raise malformed(
                f"lens model {number} has no affinity, but aspect or skew is given", "use model 3, 4 or 5"
            )
        estimate = tuple(term for term in estimate if term not in ("as", "sk"))
    if number == 5:
        if value["sk"] or "sk" in estimate:
            raise malformed(
                "the skew of lens model 5 acts at another place than its aspect", "use model 3 or 4"
            )
        value["px"] /= 1 + value["as"]
    if not value["cc"] > 0:
        raise malformed("the camera constant is not positive", "give cc")
    width, height = np.array(size_px) * pixel_mm
    ours = {
        "c": value["cc"],
        "x0": value["px"] - width / 2,
        "y0": height / 2 - value["py"],
        "B1": value["as"],
        "B2": value["sk"],
    } | {term: -value[term] for term in ("K1", "K2", "K3", "K4", "P1", "P2")}
    model, affinity = MODELS[number]
    free = tuple(OURS[NAMES.index(term)] for term in estimate)
    pitch = (pixel_mm, pixel_mm)
    calibrated = camera(name, model, "mm", size_px, pitch, ours, estimate=free, affinity=affinity)
    return replace(calibrated, distortion_at="measured")


def to_dbat(camera: Camera, lens_model: int) -> dict[str, float]:
    """Turn a camera's parameters into DBAT's."""
    width, height = np.array(camera.size_px) * camera.pitch
    index = [PARAMETERS.index(name) for name in OURS]
    sign = np.array([1.0, 1, -1, 1, 1, -1, -1, -1, -1, -1, -1])
    vector = camera.values[index] * sign
    vector[1] += width / 2
    vector[2] += height / 2
    if lens_model == 5:
        vector[1] *= 1 + vector[3]
    return dict(zip(NAMES, vector.tolist(), strict=True))


def to_column_row(x: float, y: float) -> tuple[float, float]:
    """Turn DBAT's or PhotoModeler's pixel coordinates into column and row: half a pixel less."""
    return x - 0.5, y - 0.5

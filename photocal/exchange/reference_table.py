"""Metashape's reference tables: markers or cameras with coordinates and accuracies, comma-separated.

One header line, beginning with `#Label`, names the columns: X (or Easting, Longitude), Y, Z, and one accuracy
for all coordinates, two (XY and Z), or three; further columns are ignored. Coordinates in the chunk's
coordinate system, accuracies in m. A line before it, `#CoordinateSystem: ...`, names that system.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import InputMalformedError
from photocal.exchange.choices import Choices
from photocal.exchange.parts import require_unique
from photocal.exchange.reconstruction import Reconstruction
from photocal.exchange.source import number, read_text
from photocal.geometry.conversion import Conversion

_SYSTEM = "#CoordinateSystem:"
_COORDINATES = (("x", "easting", "longitude"), ("y", "northing", "latitude"), ("z", "altitude", "height"))


@dataclass(frozen=True)
class Reference:
    """One row of a reference table.

    accuracy: of X, Y, Z, m; NaN when the table has none.
    """

    label: str
    xyz: tuple[float, float, float]
    accuracy: tuple[float, float, float]


def read_references(path: Path) -> tuple[str, tuple[Reference, ...]]:
    """Read a reference table."""
    lines = [(k, line) for k, line in enumerate(read_text(path).split("\n"), start=1) if line.strip()]
    crs = ""
    if lines and lines[0][1].startswith(_SYSTEM):
        crs = lines[0][1].removeprefix(_SYSTEM).strip()
        lines = lines[1:]
    if not lines or not lines[0][1].lower().startswith("#label"):
        raise InputMalformedError(
            "has no header that begins with #Label", where=path, remedy="export it with one"
        )
    header = [cell.strip().lower() for cell in next(csv.reader(io.StringIO(lines[0][1])))]
    places = [_column(header, names, path) for names in _COORDINATES]
    accuracies = _accuracy_columns(header)
    found = []
    for k, line in lines[1:]:
        if line.startswith("#"):
            continue
        place = f"{path}, line {k}"
        try:
            cells = [cell.strip() for cell in next(csv.reader(io.StringIO(line), strict=True))]
        except csv.Error as failure:
            raise InputMalformedError(f"is no row of a table ({failure})", where=place) from failure
        if len(cells) != len(header):
            comma = len(cells) > len(header)
            raise InputMalformedError(
                f"has {len(cells)} cells where the header has {len(header)}",
                where=place,
                remedy="write decimal points, not commas" if comma else "is the file cut?",
            )
        if not any(cells[column] for column in places):
            continue
        x, y, z = (number(cells[column], place, "coordinate") for column in places)
        sx, sy, sz = (
            number(cells[column], place, "accuracy") if column >= 0 and cells[column] else float("nan")
            for column in accuracies
        )
        found.append(Reference(cells[0], (x, y, z), (sx, sy, sz)))
    require_unique([row.label for row in found], "label", path)
    return crs, tuple(found)


def references(names: Sequence[str], places: Floats, sigmas: Floats) -> list[Reference]:
    """Make rows of arrays.

    places (n, 3): m.
    sigmas (n, 3): m; NaN, or an empty array, when not known.
    """
    known = sigmas if len(sigmas) else np.full((len(names), 3), np.nan)
    return [
        Reference(name, (x, y, z), (sx, sy, sz))
        for name, (x, y, z), (sx, sy, sz) in zip(names, places.tolist(), known.tolist(), strict=True)
    ]


def write_references(path: Path, crs: str, references: Iterable[Reference]) -> None:
    """Write a reference table with an accuracy for each coordinate; the inverse of `read_references`."""
    out = io.StringIO()
    if crs:
        out.write(f"{_SYSTEM} {crs}\n")
    out.write("#Label,X,Y,Z,Accuracy_X_(m),Accuracy_Y_(m),Accuracy_Z_(m)\n")
    table = csv.writer(out, lineterminator="\n")
    for row in references:
        accuracy = ("" if value != value else repr(float(value)) for value in row.accuracy)
        table.writerow([row.label, *(repr(float(value)) for value in row.xyz), *accuracy])
    path.write_text(out.getvalue(), encoding="utf-8", newline="\n")


def _column(header: list[str], names: tuple[str, ...], path: Path) -> int:
    for k, cell in enumerate(header[1:], start=1):
        if any(re.fullmatch(rf"{name}(/\w+)?|\w+/{name}", cell) for name in names):
            return k
    raise InputMalformedError(
        f"has no column {names[0].upper()}", where=path, remedy="export the coordinates"
    )


def _accuracy_columns(header: list[str]) -> tuple[int, int, int]:
    """Columns of the accuracies of X, Y and Z; -1 where there is none."""
    given = [k for k, cell in enumerate(header) if cell.startswith("accuracy") and "(m)" in cell]
    if len(given) == 1:
        return given[0], given[0], given[0]
    if len(given) == 2:
        return given[0], given[0], given[1]
    return (given[0], given[1], given[2]) if len(given) == 3 else (-1, -1, -1)


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """Reference tables of the images and of the points."""
    crs = "" if given.frame == "local" else _wkt(given.frame)
    cameras = references(given.image_names, given.poses[:, 3:], given.pose_sigma[:, 3:])
    write_references(folder / "cameras.csv", crs, cameras)
    write_references(folder / "markers.csv", crs, references(given.point_names, given.xyz, given.xyz_sigma))
    return ()


def _wkt(frame: str) -> str:
    from pyproj import CRS

    return " ".join(CRS.from_user_input(frame).to_wkt("WKT1_GDAL").split())

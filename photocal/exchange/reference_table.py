"""Metashape's reference tables: markers or cameras with coordinates and accuracies, comma-separated.

One header line, beginning with `#Label`, names the columns: X (or Easting, Longitude), Y, Z, and one accuracy
for all coordinates, two (XY and Z), or three; further columns are ignored. Coordinates in the chunk's
coordinate system, accuracies in m. A line before it, `#CoordinateSystem: ...`, names that system.
"""

import csv
import io
import math
import re
from collections.abc import Iterable
from pathlib import Path

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.exporting import Choices
from photocal.exchange.parts import PointEntry, require_unique
from photocal.exchange.source import number, read_text
from photocal.geometry.conversion import Conversion

_SYSTEM = "#CoordinateSystem:"
_COORDINATES = (("x", "easting", "longitude"), ("y", "northing", "latitude"), ("z", "altitude", "height"))


def read_references(path: Path) -> tuple[str, tuple[PointEntry, ...]]:
    """Read a reference table: its coordinate system, and rows whose sigmas are NaN where it has none."""
    lines = [(k, line) for k, line in enumerate(read_text(path).split("\n"), start=1) if line.strip()]
    crs = ""
    if lines and lines[0][1].startswith(_SYSTEM):
        crs = lines[0][1].removeprefix(_SYSTEM).strip()
        lines = lines[1:]
    if not lines or not lines[0][1].lower().startswith("#label"):
        raise InputMalformedError("has no header that begins with #Label", "export it with one", where=path)
    header = [cell.strip().lower() for cell in next(csv.reader(io.StringIO(lines[0][1])))]
    places = [_column(header, names, path) for names in _COORDINATES]
    # Heads of degrees stand above degrees alone.
    if not crs and any("longitude" in cell for cell in header):
        crs = "EPSG:4326"
    # One for all coordinates, of the plane and of the height, or one each; -1 where there is none.
    given = [k for k, cell in enumerate(header) if cell.startswith("accuracy") and "(m)" in cell]
    accuracies = {1: given * 3, 2: [*given[:1], *given], 3: given}.get(len(given), [-1] * 3)
    entries = []
    for k, line in lines[1:]:
        if line.startswith("#"):
            continue
        place = f"{path}, line {k}"
        try:
            cells = [cell.strip() for cell in next(csv.reader(io.StringIO(line), strict=True))]
        except csv.Error as failure:
            raise InputMalformedError(f"is not a row of a table ({failure})", where=place) from failure
        if len(cells) != len(header):
            comma = len(cells) > len(header)
            raise InputMalformedError(
                f"has {len(cells)} cells where the header has {len(header)}",
                "write decimal points, not commas" if comma else "is the file truncated?",
                where=place,
            )
        if not any(cells[column] for column in places):
            continue
        x, y, z = (number(cells[column], place, "coordinate") for column in places)
        sx, sy, sz = (
            number(cells[column], place, "accuracy") if column >= 0 and cells[column] else float("nan")
            for column in accuracies
        )
        entries.append(PointEntry(cells[0], xyz=(x, y, z), sigma=(sx, sy, sz)))
    require_unique([row.name for row in entries], "label", path)
    return crs, tuple(entries)


def write_references(path: Path, crs: str, references: Iterable[PointEntry]) -> None:
    """Write a reference table with an accuracy for each coordinate; the inverse of `read_references`."""
    out = io.StringIO()
    if crs:
        out.write(f"{_SYSTEM} {crs}\n")
    out.write("#Label,X,Y,Z,Accuracy_X_(m),Accuracy_Y_(m),Accuracy_Z_(m)\n")
    table = csv.writer(out, lineterminator="\n")
    for row in references:
        accuracy = (repr(float(value)) if math.isfinite(value) else "" for value in row.sigma)
        table.writerow([row.name, *(repr(float(value)) for value in row.xyz), *accuracy])
    path.write_text(out.getvalue(), encoding="utf-8", newline="\n")


def _column(header: list[str], names: tuple[str, ...], path: Path) -> int:
    for k, cell in enumerate(header[1:], start=1):
        if any(re.fullmatch(rf"{name}(/\w+)?|\w+/{name}", cell) for name in names):
            return k
    raise InputMalformedError(f"has no column {names[0].upper()}", "export the coordinates", where=path)


def write(folder: Path, given: Block, _: Choices) -> tuple[Conversion, ...]:
    """Reference tables of the images and of the points."""
    from pyproj import CRS

    crs = ""
    if given.frame != "local":
        crs = " ".join(CRS.from_user_input(given.frame).to_wkt("WKT1_GDAL").split())
    for file, names, places, sigmas in (
        ("cameras.csv", given.images.names, given.images.values[:, 3:], given.images.sigma[:, 3:]),
        ("markers.csv", given.points.names, given.points.values, given.points.sigma),
    ):
        rows = zip(names, places, sigmas, strict=True)
        entries = (PointEntry(name, xyz=xyz, sigma=sigma) for name, xyz, sigma in rows)
        write_references(folder / file, crs, entries)
    return ()

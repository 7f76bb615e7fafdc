"""Spreadsheets and layers of points, read by GDAL, as columns of text.

Where a file has several, each is named by file and layer: `points.xlsx/Checks`.
"""

import re
import struct
import warnings
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import pyarrow as pa

from photocal.base.errors import InputMalformedError, InputNotFoundError

SHEETS = (".xlsx", ".ods")
SUFFIXES = (*SHEETS, ".shp", ".gpkg", ".geojson")
# The geometry says where a point is; these attributes say it again, perhaps in another system.
_SAID_AGAIN = re.compile(
    r"[xyen]|east(ing)?|north(ing)?|l?este|norte|lon\w*|lat\w*|[xy]_?coord|coord_?[xy]|point_[xy]",
    re.IGNORECASE,
)
# Digits that only the binary form of a number has.
_BINARY = re.compile(r"[-+]?\d+\.\d{9,}")


def file_of(path: Path) -> Path:
    """Give the file of a sheet or layer; the path itself where it names no layer."""
    return path.parent if path.parent.suffix.lower() in SUFFIXES and path.parent.is_file() else path


def layers_of(path: Path) -> tuple[Path, ...]:
    """List the sheets with rows, or the layers of points, of a file; the file itself where it has but one.

    raises InputNotFoundError: when no sheet has a table.
    raises InputMalformedError: when it cannot be opened.
    """
    import pyogrio  # type: ignore[import-untyped]

    _require_small(path)
    try:
        kinds = dict(pyogrio.list_layers(path).tolist())
    except (RuntimeError, ValueError) as failure:
        raise _unreadable(path) from failure
    if path.suffix.lower() in SHEETS:
        names = [name for name in kinds if _titles(_rows(path, name)) is not None]
        if not names:
            raise _without_table(path)
    else:
        # Where a layer may have anything, its first point tells.
        names = [
            name
            for name, kind in kinds.items()
            if "Point" in str(kind) or (kind == "Unknown" and any(map(_place, _read(path, name)[2])))
        ]
    return (path,) if len(names) == len(kinds) == 1 else tuple(path / name for name in names)


def read_layer(path: Path) -> tuple[Any, int]:
    """Read a sheet or a layer of points: its columns of text, and how many rows stand above its first.

    Points have the columns e, n or lon, lat; z where one has a height; crs where the file names a system.

    raises InputNotFoundError: when it has no table.
    raises InputMalformedError: when it cannot be read, or has more rows than control has.
    """
    file = file_of(path)
    _require_small(file)
    layer = None if file == path else path.name
    if file.suffix.lower() not in SHEETS:
        return _points(file, layer), 0
    rows = _rows(file, layer)
    if (titles := _titles(rows)) is None:
        raise _without_table(path)
    heads, *body = rows[titles:]
    named = [k for k, head in enumerate(heads) if head]
    columns = [pa.array([row[k] for row in body], pa.string()) for k in named]
    return pa.Table.from_arrays(columns, names=[heads[k] for k in named]), titles + 1


def _require_small(file: Path) -> None:
    """Refuse what is read whole before the first row is known, and has more than any list of control."""
    most_mb = 64
    kind, size = file.suffix.lower(), file.stat().st_size if file.is_file() else 0
    if kind in SHEETS:
        try:
            with ZipFile(file) as packed:
                size = sum(part.file_size for part in packed.infolist())
        except (BadZipFile, OSError) as failure:
            raise _unreadable(file) from failure
    if kind in (*SHEETS, ".geojson") and size > most_mb * 1_000_000:
        raise InputMalformedError(
            f"has more than {most_mb} MB of rows", "export the control points alone", where=file
        )


def _titles(rows: list[list[str]]) -> int | None:
    """Count the rows above the heads; None for a sheet that has no table."""
    # A point and its place; a row of fewer cells is a title or a note.
    fewest = 4
    return next((k for k, row in enumerate(rows[:-1]) if sum(map(bool, row)) >= fewest), None)


def _rows(file: Path, layer: str | None) -> list[list[str]]:
    """Read a sheet row by row, the heads among them."""
    import pyogrio

    as_text = {
        f"OGR_{kind}_{key}": value
        for kind in ("XLSX", "ODS")
        for key, value in (("HEADERS", "DISABLE"), ("FIELD_TYPES", "STRING"))
    }
    try:
        pyogrio.set_gdal_config_options(as_text)
        _, fields, _ = _read(file, layer)
    finally:
        pyogrio.set_gdal_config_options(dict.fromkeys(as_text))
    return [list(row) for row in zip(*fields.values(), strict=True)]


def _points(file: Path, layer: str | None) -> Any:
    """Read the places of points, and what else is said of them."""
    crs, fields, shapes = _read(file, layer)
    places = [_place(geometry) for geometry in shapes]
    axes = ("lon", "lat", "z") if _in_degrees(crs) else ("e", "n", "z")
    # Zero stands where nobody has measured a height.
    known = 3 if any(len(place) > 2 and place[2] for place in places) else 2
    columns = {
        axis: [repr(place[k]) if k < len(place) else "" for place in places]
        for k, axis in enumerate(axes[:known])
    }
    columns |= {"crs": [crs] * len(places)} if crs else {}
    others = {name: cells for name, cells in fields.items() if not _SAID_AGAIN.fullmatch(name)}
    return pa.table(
        {name: pa.array(cells, pa.string()) for name, cells in (columns | others | columns).items()}
    )


def _read(file: Path, layer: str | None) -> tuple[str, dict[str, list[str]], list[bytes]]:
    """Read the system of a layer, the texts of its fields by their names, and its geometries."""
    import pyogrio

    # Nobody surveys more control; a layer of more points is a cloud or a grid.
    most = 10_000
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            told, _, shapes, fields = pyogrio.raw.read(file, layer=layer, max_features=most + 1)
    except (RuntimeError, ValueError) as failure:
        raise _unreadable(file) from failure
    if max(map(len, fields), default=0) > most:
        raise InputMalformedError(f"has more than {most} rows", "export the control points alone", where=file)
    found = {name: list(map(_text, cells)) for name, cells in zip(told["fields"], fields, strict=True)}
    return told["crs"] or "", found, [] if shapes is None else list(shapes)


def _text(value: Any) -> str:
    """Give a cell as a person would write it."""
    if value is None or value != value:
        return ""
    text = f"{value:.15g}" if isinstance(value, float) else str(value).strip()
    return f"{float(text):.15g}" if _BINARY.fullmatch(text) else text


def _place(geometry: bytes | None) -> tuple[float, ...]:
    """Read the coordinates of a point, or of the only point of several, from the well-known binary form."""
    if not geometry:
        return ()
    order = "<" if geometry[0] else ">"
    # A type with heights is larger by 1000 (ISO), or has its highest bit set (EWKB).
    kind = struct.unpack_from(f"{order}I", geometry, 1)[0] % 0x80000000 % 1000
    point, multipoint = 1, 4
    if kind == multipoint:
        return _place(geometry[9:]) if struct.unpack_from(f"{order}I", geometry, 5)[0] == 1 else ()
    return struct.unpack_from(f"{order}{(len(geometry) - 5) // 8}d", geometry, 5) if kind == point else ()


def _in_degrees(crs: str) -> bool:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return bool(crs) and CRS(crs).is_geographic
    except CRSError:
        return False


def _unreadable(file: Path) -> InputMalformedError:
    return InputMalformedError(
        "has no sheet and no layer that can be read",
        "if it has control points, copy all its files again, or export the points as CSV",
        where=file,
    )


def _without_table(path: Path) -> InputNotFoundError:
    return InputNotFoundError("has no table", "write the heads of the columns in one row", where=path)

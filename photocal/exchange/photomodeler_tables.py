"""PhotoModeler's tables of points: "2-D points" (marks with residuals) and "3-D points", comma-separated.

Pixels from the upper-left corner of the upper-left pixel, x right, y down, half a pixel more than ours;
photos are numbered from 1. Residuals in px along the same axes, with the sign of the program. Coordinates and
precisions in the project's unit, which the first line names. Three lines stand before the header; texts are
in quotation marks. Tables of SmartPoints have the same columns in another order: columns go by name.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputMalformedError
from photocal.exchange.dbat_camera import to_column_row
from photocal.exchange.source import Line, number, read_lines, whole

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_UNIT = "Project Units:"
_METRES = {"meters": 1.0, "metres": 1.0, "centimeters": 1e-2, "millimeters": 1e-3}
_SECOND = ("Object Point ID", "Photo #", "X (pixels)", "Y (pixels)", "Residual X", "Residual Y")
_THIRD = ("Id", *(f"{axis} (project units)" for axis in "XYZ"), *(f"{axis} Precision" for axis in "XYZ"))


@dataclass(frozen=True)
class MarkTable:
    """Marks of points in photos.

    Attributes
    ----------
    point : tuple of str
        Number of the point of each mark.
    photo : ndarray of int, shape (n,)
        From 0.
    pixels, residuals_px : ndarray, shape (n, 2)
        Column and row, the centre of the upper-left pixel being (0, 0); residuals along x and y down.
    """

    point: tuple[str, ...]
    photo: Integers
    pixels: Floats
    residuals_px: Floats


@dataclass(frozen=True)
class PointTable:
    """Object points.

    Attributes
    ----------
    xyz, sigma : ndarray, shape (n, 3)
        m.
    """

    names: tuple[str, ...]
    xyz: Floats
    sigma: Floats


def read_marks(path: Path) -> MarkTable:
    """Read a table of 2-D points.

    Raises
    ------
    InputNotFoundError, InputMalformedError
        For a file that is no such table, or a point that is marked twice in a photo.
    """
    point, photo, rows = [], [], []
    seen: set[tuple[str, int]] = set()
    for place, cells in _rows(path, _SECOND)[1]:
        key = (str(whole(cells[0], place, "point")), whole(cells[1], place, "photo") - 1)
        if key in seen or key[1] < 0:
            what = "is marked twice in" if key in seen else "lies in the impossible"
            raise InputMalformedError(f"point {key[0]} {what} photo {key[1] + 1}", where=place)
        seen.add(key)
        x, y, vx, vy = (number(cell, place, "mark") for cell in cells[2:])
        point.append(key[0])
        photo.append(key[1])
        rows.append([*to_column_row(x, y), vx, vy])
    table = np.array(rows, dtype=float).reshape(-1, 4)
    return MarkTable(tuple(point), np.array(photo, dtype=np.int64), table[:, :2], table[:, 2:])


def read_points(path: Path) -> PointTable:
    """Read a table of 3-D points.

    Raises
    ------
    InputNotFoundError, InputMalformedError
        For a file that is no such table, another unit, or a point that is listed twice.
    """
    names, rows = [], []
    unit, body = _rows(path, _THIRD)
    for place, cells in body:
        name = str(whole(cells[0], place, "point"))
        if name in names:
            raise InputMalformedError(f"point {name} is listed twice", where=place)
        names.append(name)
        rows.append([number(cell, place, "coordinate") for cell in cells[1:]])
    table = np.array(rows, dtype=float).reshape(-1, 6) * unit
    return PointTable(tuple(names), table[:, :3], table[:, 3:])


def _rows(path: Path, columns: tuple[str, ...]) -> tuple[float, Iterator[tuple[str, list[str]]]]:
    """Metres per unit of the project, and the wanted cells of every row."""
    lines = read_lines(path, comment="")
    head = next((k for k, line in enumerate(lines) if set(columns) <= set(_cells(line))), None)
    unit = lines[0].text.removeprefix(_UNIT).strip().lower() if lines else ""
    if head is None or not lines[0].text.startswith(_UNIT):
        raise InputMalformedError(
            f"has no header with {columns[0]!r} and {columns[2]!r}",
            where=path,
            remedy="export the table of points with its header",
        )
    if unit not in _METRES:
        raise InputMalformedError(f"is in {unit!r}", where=path, remedy=f"use {', '.join(_METRES)}")
    header = _cells(lines[head])
    index = [header.index(name) for name in columns]
    return _METRES[unit], _body(lines[head + 1 :], index, len(header))


def _body(lines: list[Line], index: list[int], count: int) -> Iterator[tuple[str, list[str]]]:
    for line in lines:
        cells = _cells(line)
        if len(cells) != count:
            raise InputMalformedError(
                f"has {len(cells)} cells where the header has {count}",
                where=line.place,
                remedy="write decimal points, not commas" if len(cells) > count else "is the file cut?",
            )
        yield line.place, [cells[k] for k in index]


def _cells(line: Line) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line.text]))]

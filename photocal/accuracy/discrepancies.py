"""Discrepancies at check points and the table that they are read from."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import Flags, Floats
from drivers.errors import InputMalformedError, InputNotFoundError

SIGN = "reference minus product"
COMPONENTS = ("E", "N", "h")

_METRES: dict[str, float] = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "usft": 1200.0 / 3937.0,
}
_COLUMN = re.compile(r"^(?P<name>point|de|dn|dh|e|n|h)(?:[\s_]*[\[(]?\s*(?P<unit>[a-z]+)\s*[\])]?)?$")
_EXPECTED = "point, dE, dN, dh (metres, or with a unit: dE_cm, dN [mm], dh (ft))"


@dataclass(frozen=True)
class Discrepancies:
    """Reference minus product at check points.

    points: names, all different.
    d_m (n, 3): dE, dN, dh in m; NaN where a component was not measured.
    positions_m (n, 3): E, N, h of the points, m, for maps; NaN where not given.
    """

    points: tuple[str, ...]
    d_m: Floats
    positions_m: Floats | None = None

    def component(self, name: str) -> tuple[tuple[str, ...], Floats]:
        """Give the values of one component with the names of their points.

        Returns
        -------
        values_m : ndarray, shape (k,)
            Discrepancies, m.
        """
        return self._complete([COMPONENTS.index(name)], 0)

    def planimetric(self) -> tuple[tuple[str, ...], Floats]:
        """Give the plane vectors of the points that have both dE and dN."""
        return self._complete([0, 1], slice(None))

    def spatial(self) -> tuple[tuple[str, ...], Floats]:
        """Give the vectors of the points that have all three components."""
        return self._complete([0, 1, 2], slice(None))

    def _complete(self, columns: list[int], pick: int | slice) -> tuple[tuple[str, ...], Floats]:
        known: Flags = np.all(np.isfinite(self.d_m[:, columns]), axis=1)
        names = tuple(name for name, has in zip(self.points, known.tolist(), strict=True) if has)
        return names, self.d_m[known][:, columns][:, pick]


def read_discrepancies(path: Path) -> Discrepancies:
    """Read a table of discrepancies.

    Parameters
    ----------
    path : Path
        CSV with the columns point, dE, dN, dh (dE and dN, or dh, may be missing), and optional E, N, h;
        separated by comma, semicolon or tab; decimal commas where the separator is not a comma. Metres,
        unless the header gives another unit (m, dm, cm, mm, ft, usft).

    Returns
    -------
    Discrepancies
        In metres, in the order of the file.

    Raises
    ------
    InputNotFoundError
        When there is no such file.
    InputMalformedError
        When it is not such a table; the message says the line.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as refusal:
        reason = refusal.strerror or str(refusal)
        raise InputNotFoundError(
            f"cannot be read ({reason})", where=path, remedy="name a CSV of discrepancies"
        ) from refusal
    except UnicodeDecodeError as refusal:
        raise InputMalformedError(
            "is not UTF-8 text", where=path, remedy="save it as CSV, UTF-8"
        ) from refusal
    return parse_discrepancies(text, str(path))


def parse_discrepancies(text: str, where: str) -> Discrepancies:
    """Read a table of discrepancies from its text."""
    rows = _rows(text, where)
    if not rows:
        raise InputMalformedError(
            "is empty", where=where, remedy=f"the first line names the columns: {_EXPECTED}"
        )
    line, header = rows[0]
    columns, factors = _columns(header, f"{where}, line {line}")
    decimal_comma = "," not in _separator(text)
    points: list[str] = []
    values: list[list[float]] = []
    for line, row in rows[1:]:
        place = f"{where}, line {line}"
        if len(row) != len(header):
            raise InputMalformedError(
                f"has {len(row)} fields, the header {len(header)}", where=place, remedy="complete the line"
            )
        points.append(row[columns["point"]].strip())
        values.append(
            [
                factors[name] * _number(row[columns[name]], name, place, decimal_comma=decimal_comma)
                if name in columns
                else math.nan
                for name in ("de", "dn", "dh", "e", "n", "h")
            ]
        )
    _check_points(points, where)
    table = np.array(values, dtype=np.float64).reshape(-1, 6)
    if not np.isfinite(table[:, :3]).any():
        raise InputMalformedError("holds no discrepancy", where=where, remedy="give at least one check point")
    positions = table[:, 3:] if {"e", "n"} <= columns.keys() else None
    return Discrepancies(tuple(points), table[:, :3], positions)


def _separator(text: str) -> str:
    header = next((line for line in text.splitlines() if line.strip()), "")
    return next((mark for mark in (";", "\t") if mark in header), ",")


def _rows(text: str, where: str) -> list[tuple[int, list[str]]]:
    if "\0" in text:
        raise InputMalformedError("is not a text table", where=where, remedy="save it as CSV, UTF-8")
    reader = csv.reader(io.StringIO(text), delimiter=_separator(text))
    try:
        return [(reader.line_num, row) for row in reader if any(field.strip() for field in row)]
    except csv.Error as refusal:
        raise InputMalformedError(
            f"is not a table ({refusal})", where=f"{where}, line {reader.line_num}", remedy="save it as CSV"
        ) from refusal


def _columns(header: list[str], place: str) -> tuple[dict[str, int], dict[str, float]]:
    columns: dict[str, int] = {}
    factors: dict[str, float] = {}
    for position, title in enumerate(header):
        match = _COLUMN.match(title.strip().lower())
        if match is None:
            raise InputMalformedError(
                f"unknown column {title.strip()!r}",
                where=place,
                remedy=f"the columns are {_EXPECTED}, and E, N, h",
            )
        name, unit = match["name"], match["unit"]
        if name in columns:
            raise InputMalformedError(f"column {name} stands twice", where=place, remedy="keep one")
        if unit is not None and (unit not in _METRES or name == "point"):
            raise InputMalformedError(
                f"unknown unit {unit!r} of column {title.strip()!r}",
                where=place,
                remedy=f"known are {', '.join(_METRES)}",
            )
        columns[name] = position
        factors[name] = _METRES[unit or "m"]
    missing = [name for name in ("point",) if name not in columns]
    if ("de" in columns) != ("dn" in columns):
        missing.append("dn" if "de" in columns else "de")
    if missing or not {"de", "dh"} & columns.keys():
        lacking = " and ".join(missing) or "dE, dN or dh"
        raise InputMalformedError(
            f"has no column {lacking}", where=place, remedy=f"the columns are {_EXPECTED}"
        )
    return columns, factors


def _number(field: str, name: str, place: str, *, decimal_comma: bool) -> float:
    field = field.strip()
    if not field:
        return math.nan
    try:
        value = float(field.replace(",", ".") if decimal_comma else field)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in field:
        raise InputMalformedError(
            f"{name} = {field!r} is not a number", where=place, remedy="correct it, or leave it empty"
        )
    return value


def _check_points(points: list[str], where: str) -> None:
    if "" in points:
        raise InputMalformedError(
            f"row {points.index('') + 1} has no point name", where=where, remedy="name every check point"
        )
    seen: set[str] = set()
    for point in points:
        if point in seen:
            raise InputMalformedError(
                f"point {point!r} stands twice", where=where, remedy="keep one row a point"
            )
        seen.add(point)

"""Discrepancies at check points and the table that they are read from."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Flags, Floats
from photocal.base.errors import InputMalformedError
from photocal.block.table import TextTable, read_columns

SIGN = "product minus reference"
COMPONENTS = ("E", "N", "h")
GROUND = "ground"

_METRES: dict[str, float] = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "usft": 1200.0 / 3937.0,
}
_COLUMN = re.compile(r"^(?P<name>point|(d|correction_)?[enh])(?:[\s_]*[\[(]?\s*(?P<unit>[a-z]+)\s*[\])]?)?$")
_EXPECTED = "point, correction_E, correction_N, correction_h (reference minus product; also as dE, dN, dh)"


@dataclass(frozen=True)
class Discrepancies:
    """Product minus reference at check points.

    Attributes
    ----------
    d_m : array, shape (n, 3)
        DE, dN, dh in m; NaN where a component was not measured.
    positions_m : array, shape (n, 3)
        E, N, h of the points, m, for maps; NaN where not given.
    vegetated : array, shape (n,)
        Which points lie in vegetated ground; None where nobody said, then none does.
    """

    points: tuple[str, ...]
    d_m: Floats
    positions_m: Floats | None = None
    vegetated: Flags | None = None

    def of_ground(self, ground: Literal["open", "vegetated"]) -> "Discrepancies":
        """Give the points in open, or in vegetated ground."""
        grown = np.zeros(len(self.points), dtype=np.bool_) if self.vegetated is None else self.vegetated
        chosen = grown if ground == "vegetated" else ~grown
        names = tuple(name for name, has in zip(self.points, chosen.tolist(), strict=True) if has)
        return Discrepancies(names, self.d_m[chosen])

    @property
    def correction_m(self) -> Floats:
        """Reference minus product, as most studies print it: what is to be added to the product."""
        return 0.0 - self.d_m

    def component(self, name: str) -> tuple[tuple[str, ...], Floats]:
        """Give the values of one component with the names of their points."""
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
    """Read a table of corrections at check points.

    path: table with the columns point, correction_E, correction_N, correction_h (those of the plane, or of
        the height, may be missing), and optional E, N, h, and ground (open or vegetated). dE, dN, dh are
        other names of the corrections: as published studies print them, reference minus product. Metres,
        unless the header gives another unit (m, dm, cm, mm, ft, usft).
    raises InputNotFoundError, InputMalformedError: when it is not such a table; the message says the line.
    """
    table = read_columns(path)
    title, factor = _columns(table)
    points = table.unique_names(title["point"])

    def metres(names: str) -> Floats:
        """Columns by their names, in metres; NaN where a column is missing or a cell is empty."""
        given = (
            factor[name] * table.numbers(title[name], empty=np.nan)
            if name in title
            else np.full(len(points), np.nan)
            for name in names.split()
        )
        return np.column_stack(tuple(given))

    corrections = metres("de dn dh")
    if not np.isfinite(corrections).any():
        raise InputMalformedError("holds no discrepancy", "give at least one check point", where=path)
    positions = metres("e n h") if {"e", "n"} <= title.keys() else None
    return Discrepancies(points, 0.0 - corrections, positions, _vegetated(table))


def _vegetated(table: TextTable) -> Flags | None:
    """The column `ground`: open or vegetated."""
    if not table.has(GROUND):
        return None
    which, kinds = table.names(GROUND)
    wrong = [kind for kind in kinds if kind not in ("open", "vegetated")]
    if wrong:
        row = int(np.flatnonzero(which == kinds.index(wrong[0]))[0])
        raise InputMalformedError(
            f"ground {wrong[0]!r} is not known",
            "write open (bare, rock, short grass, paved) or vegetated",
            where=table.place(row),
        )
    return np.asarray([kind == "vegetated" for kind in kinds])[which]


def _columns(table: TextTable) -> tuple[dict[str, str], dict[str, float]]:
    """Titles of the columns by their short name, and how many metres their unit has."""
    titles: dict[str, str] = {}
    factors: dict[str, float] = {}
    place, remedy = f"{table.path}, line 1", f"the columns are {_EXPECTED}, and E, N, h"
    malformed = InputMalformedError.at(place)
    for title in table.columns.column_names:
        if title == GROUND:
            continue
        match = _COLUMN.match(title.lower())
        if match is None:
            raise malformed(f"unknown column {title!r}", remedy)
        name, unit = match["name"].replace("correction_", "d"), match["unit"]
        if name in titles:
            raise malformed(f"column {name} stands twice", "keep one")
        if unit is not None and (unit not in _METRES or name == "point"):
            raise malformed(f"unknown unit {unit!r} of column {title!r}", f"known are {', '.join(_METRES)}")
        titles[name], factors[name] = title, _METRES[unit or "m"]
    missing = [] if "point" in titles else ["point"]
    if ("de" in titles) != ("dn" in titles):
        missing.append("dn" if "de" in titles else "de")
    if missing or not {"de", "dh"} & titles.keys():
        lacking = " and ".join(missing) or "dE, dN or dh"
        raise malformed(f"has no column {lacking}", remedy)
    return titles, factors

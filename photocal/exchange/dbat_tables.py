"""DBAT's comma-separated tables: control points, images, image points, positions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputMalformedError
from photocal.exchange.source import Line, number, read_lines

CONTROL_FIELDS = ("id", "label", "dummy", "x", "y", "z", "sx", "sy", "sz", "sxy", "sxyz")
IMAGE_FIELDS = ("id", "path", "dummy", "ignored")
MARK_FIELDS = ("id", "im", "ignored", "dummy", "x", "y", "sx", "sy", "sxy")
# What one field of the file stands for.
_SPREAD = {"sxy": ("sx", "sy"), "sxyz": ("sx", "sy", "sz")}


@dataclass(frozen=True)
class Row:
    """One row of a table.

    cells: text by field, blanks removed.
    """

    line: Line
    cells: dict[str, str]

    def value(self, field: str, default: float | None = None) -> float:
        """Number in a field; the default stands for a missing field, None forbids that."""
        if field in self.cells:
            return number(self.cells[field], self.line.place, field)
        if default is None:
            raise InputMalformedError(
                f"has no field {field}", where=self.line.place, remedy="name it in the format"
            )
        return default

    def name(self, field: str) -> str:
        """Identifier in a field; leading zeros of a number do not matter."""
        text = self.cells.get(field, "")
        if not text:
            raise InputMalformedError(
                f"has no {field}", where=self.line.place, remedy="give every row its id"
            )
        return str(int(text)) if text.isdecimal() else text

    def sigma(self, default: float = 0.0) -> tuple[float, float, float]:
        """Standard deviations in x, y, z."""
        values = (self.value("sx", default), self.value("sy", default), self.value("sz", default))
        if min(values) < 0:
            raise InputMalformedError("a standard deviation is negative", where=self.line.place)
        return values


def read_rows(path: Path, layout: str, allowed: tuple[str, ...], separator: str = ",") -> Iterator[Row]:
    """Read the rows of a table whose columns a format names."""
    fields = [field.strip() for field in layout.split(",")]
    for field in fields:
        if field not in allowed:
            raise InputMalformedError(
                f"format {layout!r} has the unknown field {field!r}",
                where=path,
                remedy=f"use {', '.join(allowed)}",
            )
    for line in read_lines(path):
        cells = [cell.strip() for cell in line.text.split(separator)]
        if len(cells) != len(fields):
            comma = len(cells) > len(fields) and separator == ","
            raise InputMalformedError(
                f"has {len(cells)} cells where the format {layout!r} has {len(fields)}",
                where=line.place,
                remedy="write decimal points, not commas"
                if comma
                else "complete the row, or is the file cut?",
            )
        row: dict[str, str] = {}
        for field, cell in zip(fields, cells, strict=True):
            row.update(dict.fromkeys(_SPREAD.get(field, (field,)), cell))
        yield Row(line, row)

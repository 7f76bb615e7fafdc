"""The rows of the ministry's technical report, each filled or marked as not determined."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import ConfigurationError, InputNotFoundError
from photocal.report.ministry_rows import FILLERS, Context, Origin

LAYOUT = Path(__file__).with_name("ministry_aerial_survey.csv")
COLUMNS = ("section", "item", "key", "en", "pt-BR", "unit", "obligation")


@dataclass(frozen=True)
class LayoutRow:
    """One row of the form: where it stands, what fills it, how it is called in each language."""

    section: str
    item: str
    key: str
    labels: dict[str, str]
    unit: str
    obligation: str


@dataclass(frozen=True)
class Entry:
    """A row with its value and where that came from."""

    row: LayoutRow
    value: str
    origin: Origin


def read_layout(path: Path = LAYOUT) -> tuple[LayoutRow, ...]:
    """Read the rows of the form."""
    if not path.is_file():
        raise InputNotFoundError("no such file", where=path, remedy="install photocal again")
    with path.open(encoding="utf-8", newline="") as stream:
        reader = csv.DictReader(stream)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise ConfigurationError(
                f"columns must be {','.join(COLUMNS)}", where=path, remedy="correct the table"
            )
        rows = [
            LayoutRow(
                row["section"],
                row["item"],
                row["key"],
                {"en": row["en"], "pt-BR": row["pt-BR"]},
                row["unit"],
                row["obligation"],
            )
            for row in reader
        ]
    for row in rows:
        if row.key not in FILLERS:
            raise ConfigurationError(f"no figure is called {row.key!r}", where=path, remedy="correct the key")
    return tuple(rows)


def entries(layout: tuple[LayoutRow, ...], context: Context) -> tuple[Entry, ...]:
    """Fill every row."""
    filled = [(row, FILLERS[row.key](context)) for row in layout]
    missing = context.say("ministry.not_determined")
    return tuple(
        Entry(row, *value) if value else Entry(row, missing, "not_determined") for row, value in filled
    )

"""Reading one CSV table strictly: header, width of every row, every number finite."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputMalformedError, InputNotFoundError

if TYPE_CHECKING:
    from _csv import Reader as CsvReader


@dataclass(frozen=True)
class Columns:
    """Content of a table.

    Attributes
    ----------
    texts : dict
        The text columns by name, one string per row.
    numbers : ndarray, shape (n, m)
        The number columns in the order that was asked for.
    """

    texts: dict[str, tuple[str, ...]]
    numbers: NDArray[np.float64]


def read_table(
    path: Path, texts: tuple[str, ...], numbers: tuple[str, ...], may_be_empty: tuple[str, ...] = ()
) -> Columns:
    """Read the named columns of a table, comma separated or Parquet; others are passed over.

    Parameters
    ----------
    path : Path
        The file: UTF-8 with a header line, or named .parquet.
    texts, numbers : tuple of str
        Columns to read as they stand, and as finite numbers.
    may_be_empty : tuple of str
        Those numbers whose cells may be empty: nan then.

    Raises
    ------
    InputNotFoundError
        When the file is missing or empty.
    InputMalformedError
        When a column is missing, a row is cut or too long, or a number is none.
    """
    if not path.is_file():
        raise InputNotFoundError(
            "no such file", where=path, remedy="give the folder that `photocal adjust` wrote"
        )
    if path.suffix == ".parquet":
        return _read_parquet(path, texts, numbers, may_be_empty)
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return _parse(csv.reader(stream, strict=True), path, texts, numbers, may_be_empty)
    except (UnicodeDecodeError, csv.Error) as broken:
        raise InputMalformedError(
            f"is not a comma separated table in UTF-8 ({broken})",
            where=path,
            remedy="run `photocal adjust` again",
        ) from None


def _parse(
    rows: CsvReader,
    path: Path,
    texts: tuple[str, ...],
    numbers: tuple[str, ...],
    may_be_empty: tuple[str, ...],
) -> Columns:
    header = next(rows, None)
    if header is None:
        raise InputNotFoundError("the file is empty", where=path, remedy="run `photocal adjust` again")
    missing = [name for name in (*texts, *numbers) if name not in header]
    if missing:
        raise InputMalformedError(
            f"column {missing[0]} is missing", where=f"{path}, line 1", remedy="run `photocal adjust` again"
        )
    text_at = [header.index(name) for name in texts]
    number_at = [header.index(name) for name in numbers]
    words: list[tuple[str, ...]] = []
    figures: list[list[float]] = []
    for row in rows:
        if len(row) != len(header):
            raise InputMalformedError(
                f"row has {len(row)} of {len(header)} columns",
                where=f"{path}, line {rows.line_num}",
                remedy="the table was cut; run `photocal adjust` again",
            )
        words.append(tuple(row[i] for i in text_at))
        figures.append(
            [_number(row[i], header[i], path, rows.line_num, header[i] in may_be_empty) for i in number_at]
        )
    columns = tuple(zip(*words, strict=True)) if words else ((),) * len(texts)
    return Columns(
        dict(zip(texts, columns, strict=True)), np.array(figures, dtype=np.float64).reshape(-1, len(numbers))
    )


def _number(text: str, column: str, path: Path, line: int, may_be_empty: bool) -> float:
    if may_be_empty and not text:
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputMalformedError(
            f"{column} is {text!r}, a number was expected",
            where=f"{path}, line {line}",
            remedy="run `photocal adjust` again",
        )
    return value


def _read_parquet(
    path: Path, texts: tuple[str, ...], numbers: tuple[str, ...], may_be_empty: tuple[str, ...]
) -> Columns:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    try:
        table = parquet.read_table(path, columns=[*texts, *numbers])
        words = {name: tuple(str(value) for value in table[name].to_pylist()) for name in texts}
        figures = [np.asarray(table[name].to_numpy(), dtype=np.float64) for name in numbers]
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError) as broken:
        reason = str(broken).splitlines()[0]
        raise InputMalformedError(
            f"cannot be read as Parquet ({reason})", where=path, remedy="run `photocal adjust` again"
        ) from None
    for name, values in zip(numbers, figures, strict=True):
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size and name not in may_be_empty:
            raise InputMalformedError(
                f"{name} is no number",
                where=f"{path}, row {wrong[0] + 1}",
                remedy="run `photocal adjust` again",
            )
    return Columns(words, np.column_stack(figures))

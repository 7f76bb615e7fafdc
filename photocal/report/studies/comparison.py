"""Printed figures against ours, one by one.

A study repeated: its folder copied, its commands run, its figures compared.
"""

import contextlib
import csv
import io
import json
import math
import shlex
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from photocal.base.errors import ConfigurationError, InputNotFoundError, OutputError, PhotocalError
from photocal.base.files import refusals, rows_text
from photocal.findings.texts import Catalogue, catalogue
from photocal.report.studies.study import Apart, Command, Figure, PrintedTable, Study, read_study

RESULTS = "results"
SCHEMA = "photocal.study/1"


@dataclass(frozen=True)
class ComparedFigure:
    """One printed figure.

    ours: None where no command gives it.
    agrees: within what rounding allows, or the same word.
    why: why it need not agree; empty where it should.
    """

    table: str
    label: str
    column: str
    printed: str
    ours: float | str | None
    agrees: bool
    why: str


@dataclass(frozen=True)
class ComparedTable:
    """All figures of one printed table."""

    printed: PrintedTable
    figures: tuple[ComparedFigure, ...]

    @property
    def agreeing(self) -> int:
        """How many agree."""
        return sum(figure.agrees for figure in self.figures)


@dataclass(frozen=True)
class Repeated:
    """A study, repeated."""

    study: Study
    tables: tuple[ComparedTable, ...]

    @property
    def figures(self) -> tuple[ComparedFigure, ...]:
        """All figures of all tables."""
        return tuple(figure for table in self.tables for figure in table.figures)

    @property
    def printed(self) -> tuple[int, int]:
        """How many printed figures agree, and of how many."""
        tables = [table for table in self.tables if not table.printed.recomputed]
        return sum(table.agreeing for table in tables), sum(len(table.figures) for table in tables)

    @property
    def unexplained(self) -> tuple[ComparedFigure, ...]:
        """Figures that differ without a known reason."""
        return tuple(figure for figure in self.figures if not figure.agrees and not figure.why)


def compare_study(study: Study, folder: Path) -> Repeated:
    """Compare the printed tables of a study with the answers of its commands in a folder.

    raises InputNotFoundError, ConfigurationError: for an answer or a figure that is not there.
    """
    read = cache(lambda name: _answer(folder, name))
    return Repeated(study, tuple(_table(table, folder, read) for table in study.table))


def _table(table: PrintedTable, folder: Path, read: Any) -> ComparedTable:
    path = folder / table.printed
    if not path.is_file():
        raise InputNotFoundError("does not exist", "the study needs it", where=path)
    with path.open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if _chosen(row, table.rows)]
    figures = []
    for number, row in enumerate(rows):
        label = " ".join(row[name] for name in table.label)
        named = {column: table.names.get(word, word) for column, word in row.items()}
        for figure in table.figure:
            printed = row[figure.column]
            if printed == "":
                continue
            ours = _ours(read(figure.answer or table.answer), figure, named | {"row": str(number)}, path)
            agrees = _agree(printed, ours, figure, row)
            why = "" if agrees else _why(table.apart, figure.column, row)
            figures.append(ComparedFigure(table.title, label, figure.column, printed, ours, agrees, why))
    return ComparedTable(table, tuple(figures))


def _chosen(row: dict[str, str], wanted: dict[str, tuple[str, ...]]) -> bool:
    return all(row[name] in words for name, words in wanted.items())


def _why(apart: Iterable[Apart], column: str, row: dict[str, str]) -> str:
    fitting = (one for one in apart if one.column in ("", column) and _chosen(row, one.where))
    return next((one.why for one in fitting), "")


def _answer(folder: Path, name: str) -> Any:
    """Read what a command answered, or a table or JSON file that it wrote."""
    path = folder / name if "." in name else folder / RESULTS / f"{name}.json"
    if not path.is_file():
        raise InputNotFoundError("does not exist", "run the commands of the study first", where=path)
    if path.suffix == ".parquet":
        return _covariances(path)
    text = path.read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines())) if path.suffix == ".csv" else json.loads(text)


def _covariances(path: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Read covariance.parquet of a run: by kind, by name, by both parameters with a blank between."""
    import pyarrow.parquet as pq

    kinds: dict[str, dict[str, dict[str, float]]] = {}
    for row in pq.read_table(path).to_pylist():
        names = row["names"]
        pairs = [(a, b) for i, a in enumerate(names) for b in names[: i + 1]]
        entries = zip(pairs, row["lower"], strict=True)
        both = {f"{a} {b}": value for pair, value in entries for a, b in (pair, pair[::-1])}
        kinds.setdefault(row["kind"], {})[row["id"]] = both
    return kinds


def _ours(answer: Any, figure: Figure, row: dict[str, str], path: Path) -> float | str | None:
    found = answer
    for part in figure.ours.split("/"):
        key = part.format_map(row)
        try:
            found = _step(found, key)
        except (KeyError, IndexError, ValueError, StopIteration, TypeError):
            raise ConfigurationError(
                f"the answer has no {figure.ours.format_map(row)}", f"there is none at {key}", where=path
            ) from None
    if found is None or isinstance(found, bool):
        return None if found is None else str(found).lower()
    try:
        value = figure.times * float(found)
    except ValueError:
        return str(found)
    return abs(value) if figure.absolute else value


def _step(found: Any, key: str) -> Any:
    """Go one part of the way; a list is entered by a number, or by what its object or row says."""
    if not isinstance(found, list):
        return found[key]
    if "=" not in key:
        return found[int(key)]
    wanted = dict(pair.split("=", 1) for pair in key.split(","))
    return next(one for one in found if all(_said(one[name]) == word for name, word in wanted.items()))


def _said(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _agree(printed: str, ours: float | str | None, figure: Figure, row: dict[str, str]) -> bool:
    if printed in figure.words:
        meant = figure.words[printed]
        return ours == (str(meant).lower() if isinstance(meant, bool) else meant or None)
    if isinstance(ours, str) or ours is None:
        return printed == ours
    value = abs(_number(printed)) if figure.absolute else _number(printed)
    allowed = max(figure.within, abs(value) * figure.percent / 100.0)
    if figure.within_column:
        allowed = figure.share * _number(row[figure.within_column])
    apart = ours - value
    if figure.period:
        apart = math.remainder(apart, figure.period)
    # What stands at the edge of its rounding is within it.
    return math.isfinite(ours) and abs(apart) <= allowed * (1.0 + 1e-9)


def _number(printed: str) -> float:
    """Read a printed number, also a fraction such as 3/5."""
    over, _, under = printed.partition("/")
    return float(over) / float(under or 1)


def as_record(repeated: Repeated) -> dict[str, Any]:
    """Give a comparison as plain values, ready for JSON."""
    return {
        "schema": SCHEMA,
        "title": repeated.study.title,
        "year": repeated.study.year,
        "agreeing": repeated.printed[0],
        "figures": repeated.printed[1],
        "unexplained": len(repeated.unexplained),
        "tables": [
            {
                "title": table.printed.title,
                "printed": table.printed.printed,
                "recomputed": table.printed.recomputed,
                "agreeing": table.agreeing,
                "figures": [
                    {key: value for key, value in vars(figure).items() if key != "table"}
                    for figure in table.figures
                ],
            }
            for table in repeated.tables
        ],
    }


def as_text(repeated: Repeated, say: Catalogue) -> str:
    """Write a comparison for people: each table in a line, and below it what does not agree."""
    study, own = repeated.study, repeated.study.languages.get(say.language)
    lines = [f"{say.stored(study.title, own)} ({study.year})"]
    for table in repeated.tables:
        title, n = say.stored(table.printed.title, own), len(table.figures)
        lines.append(say("studied.table", title=title, agreeing=table.agreeing, n=n))
        differing = [figure for figure in table.figures if not figure.agrees]
        lines += [f"    {line}" for line in grouped(differing, own, say)]
    agreeing, of = repeated.printed
    return "\n".join([*lines, say("studied.all", agreeing=agreeing, n=of)])


def grouped(figures: Iterable[ComparedFigure], own: Mapping[str, str] | None, say: Catalogue) -> list[str]:
    """Name the differing figures, those of one reason in one line; `own`: texts of the study."""
    by_reason: dict[str, list[str]] = {}
    for one in figures:
        what = {"label": one.label, "column": one.column, "printed": one.printed}
        reason = say.stored(one.why, own) if one.why else say("studied.unexplained")
        by_reason.setdefault(reason, []).append(say("studied.figure", **what, ours=shown(one.ours, say)))
    return [
        f"{why}: {'; '.join(said[:6])}" + (say("join.more", count=len(said) - 6) if len(said) > 6 else "")
        for why, said in by_reason.items()
    ]


def shown(ours: float | str | None, say: Catalogue | None = None) -> str:
    """Write a figure of ours."""
    say = say or catalogue("en")
    if ours is None:
        return say("studied.none")
    return ours if isinstance(ours, str) else say.row([ours], ".6g")


# Runs the arguments of a command in the current folder.
Run = Callable[[list[str]], None]


def repeat_study(
    source: Path, folder: Path, run: Run, done: Callable[[str], None] = lambda _: None
) -> Repeated:
    """Copy a study into a new folder, run its commands there and compare.

    raises OutputError: when the folder exists and is not empty.
    raises ConfigurationError: when a command ends otherwise than the study says.
    """
    study = read_study(source)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError("exists and is not empty", "name a new folder", where=folder)
    with refusals(folder):
        shutil.copytree(source, folder, dirs_exist_ok=True)
        (folder / RESULTS).mkdir(exist_ok=True)
    for command in study.command:
        _run(command, folder, run)
        done(command.name)
    repeated = compare_study(study, folder)
    rows = [
        (
            one.table,
            one.label,
            one.column,
            one.printed,
            shown(one.ours),
            "yes" if one.agrees else "no",
            one.why,
        )
        for one in repeated.figures
    ]
    heads = ("table", "row", "column", "printed", "ours", "agrees", "why")
    with refusals(folder):
        (folder / RESULTS / "compared.csv").write_text(rows_text(heads, rows), encoding="utf-8")
    return repeated


def _run(command: Command, folder: Path, run: Run) -> None:
    words = shlex.split(command.line)[1:]
    ended, said = 0, io.StringIO()
    # Paths of the commands are those of the study's folder.
    with contextlib.chdir(folder), contextlib.redirect_stdout(said):
        try:
            run(words)
        except PhotocalError as refusal:
            if refusal.exit_code != command.exit:
                raise
            ended = refusal.exit_code
    if ended != command.exit:
        raise ConfigurationError(
            f"{command.line} ended with exit code {ended}, the study states {command.exit}",
            "correct study.toml",
            where=folder,
        )
    ending = ".json" if "--json" in words else ".txt"
    with refusals(folder):
        (folder / RESULTS / f"{command.name}{ending}").write_text(said.getvalue(), encoding="utf-8")

"""A study as a file: what was asked and printed, the commands, and which figure answers which."""

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from photocal.base.checked_toml import Table, read_toml
from photocal.base.errors import InputNotFoundError

FILE = "study.toml"
_SOURCES = Path(__file__).parents[3] / "configs" / "studies"


class Command(Table):
    """A command of the study.

    name: its answer is kept as results/NAME.json, or .txt where it gives no JSON.
    exit: the exit code that it ends with.
    """

    name: str
    line: str
    why: str = ""
    exit: int = 0


class Apart(Table):
    """Printed figures that need not agree, and the reason."""

    where: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    column: str = ""
    why: str


class Figure(Table):
    """One column of a printed table and the figure of ours that answers it.

    column: of the printed table.
    ours: way through the answer, parts with / between: keys of objects, and numbers or key=value of lists,
        with {column} of the printed row.
    times: ours is multiplied by it: of another unit.
    within, percent: allowed difference, absolute or as a share of the printed figure.
    within_column, share: allowed difference as a share of a column, such as the standard deviation.
    period: after which the figure is the same again, such as 360 for degrees.
    words: what the printed words mean in our answer.
    answer: the command, where it is not that of the table.
    """

    column: str
    ours: str
    times: float = 1.0
    absolute: bool = False
    period: float = 0.0
    within: float = 0.0
    percent: float = 0.0
    within_column: str = ""
    share: float = 1.0
    words: dict[str, Any] = Field(default_factory=dict)
    answer: str = ""


class PrintedTable(Table):
    """A printed table that is computed anew.

    printed: CSV in the folder of the study.
    answer: name of the command, or file that a command writes.
    rows: only the rows with these words in these columns.
    label: columns that name a row.
    names: what printed names are called in our answers.
    recomputed: not printed by the study, but computed from its print by others: counted apart.
    rounding: where the allowed difference comes from.
    """

    title: str
    printed: str
    answer: str
    label: tuple[str, ...]
    figure: tuple[Figure, ...] = Field(min_length=1)
    rows: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    names: dict[str, str] = Field(default_factory=dict)
    recomputed: bool = False
    rounding: str
    apart: tuple[Apart, ...] = ()


class Input(Table):
    """A file of the folder that a command reads, and the printed tables that it holds."""

    file: str
    what: str
    tables: tuple[str, ...] = ()


class NotRepeated(Table):
    """Printed tables that no command repeats, and why."""

    what: str
    tables: tuple[str, ...] = ()
    why: str


class DrawnPicture(Table):
    """A figure drawn anew by a command, and what the study concluded from its own."""

    file: str
    shows: str
    concluded: str


class Study(Table):
    """A published study.

    year: of print, or of its data where the print has none.
    languages: titles and reasons in other languages, by language and English text, with places for values.
    """

    title: str
    year: int
    kind: Literal["dissertation", "bachelor's thesis", "article"]
    place: str
    asked: str
    concluded: str
    input: tuple[Input, ...]
    command: tuple[Command, ...] = Field(min_length=1)
    table: tuple[PrintedTable, ...] = ()
    picture: tuple[DrawnPicture, ...] = ()
    not_repeated: tuple[NotRepeated, ...] = ()
    languages: dict[str, dict[str, str]] = Field(default_factory=dict)


def read_study(folder: Path) -> Study:
    """Read the study of a folder; errors as of `read_toml`."""
    return read_toml(folder / FILE, Study)


def shipped() -> dict[str, Path]:
    """Find the folders of the shipped studies by their names: those of the sources, or those installed."""
    if _SOURCES.is_dir():
        found = [path.parent for path in _SOURCES.glob(f"*/{FILE}")]
    else:
        try:
            installed = files("photocal") or []
        except PackageNotFoundError:
            installed = []
        found = [Path(str(one.locate())).resolve().parent for one in installed if one.name == FILE]
    return {path.name: path for path in sorted(found)}


def study_folder(name: str) -> Path:
    """Find the folder of a shipped study, or of one's own; raises InputNotFoundError."""
    known = shipped()
    if name in known:
        return known[name]
    if (Path(name) / FILE).is_file():
        return Path(name)
    raise InputNotFoundError(
        f"no study {name}", f"there are {', '.join(known) or 'none'}, or name a folder with a {FILE}"
    )

"""Outputs that are whole or not there: written aside, then renamed."""

import csv
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from photocal.base.arrays import as_plain
from photocal.base.errors import ConfigurationError, OutputError
from photocal.base.operating_system import replace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Kinds of pictures by their endings, with what would differ from one writing to the next.
_PICTURES: dict[str, dict[str, None] | None] = {
    "png": None,
    "pdf": {"CreationDate": None},
    "svg": {"Date": None},
}


@contextmanager
def output_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it takes the place of `path`.

    raises OutputError: when the folder cannot be made or written, or `path` is a folder.
    """
    if path.is_dir():
        raise OutputError("is a folder, a file was expected", "name a file", where=path)
    with refusals(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent)
        os.close(handle)
    aside = Path(name)
    try:
        yield aside
        with refusals(path):
            # mkstemp makes private files; a result is as readable as any file that the user makes.
            mask = os.umask(0)
            os.umask(mask)
            aside.chmod(0o666 & ~mask)
            replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def picture_kind(path: Path) -> str:
    """Give the kind of a picture by its ending; raises ConfigurationError for one that is not made."""
    kind = path.suffix.lower()[1:]
    if kind not in _PICTURES:
        raise ConfigurationError(f"{path} has no known ending", "use .pdf, .svg or .png")
    return kind


@contextmanager
def output_picture(
    path: Path, inches: tuple[float, float], font: float = 8.0, dpi: float = 200.0
) -> "Iterator[Figure]":
    """Give a figure that is written on success; errors as of `output_file` and `picture_kind`."""
    kind = picture_kind(path)
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": "photocal", "svg.fonttype": "path", "font.size": font}):
        figure = Figure(figsize=inches, layout="constrained")
        yield figure
        with output_file(path) as aside:
            figure.savefig(aside, format=kind, metadata=_PICTURES[kind], dpi=dpi)


@contextmanager
def output_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder beside `path`; on success its files take their places in `path`.

    Files of an earlier run that this one does not make again stay where they are.

    raises OutputError: when the folder cannot be made or written, or `path` is a file.
    """
    if path.exists() and not path.is_dir():
        raise OutputError("is a file, a folder was expected", "name a folder", where=path)
    with refusals(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent))
    try:
        yield aside
        with refusals(path):
            for made in sorted(p for p in aside.rglob("*") if p.is_file()):
                final = path / made.relative_to(aside)
                final.parent.mkdir(parents=True, exist_ok=True)
                made.replace(final)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV table with its head."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([columns, *rows])


def rows_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Give a CSV table with its head as text; a cell of None is empty."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()


def write_json(path: Path, content: Any, indent: int | None = 1) -> None:
    """Write figures for programs; what is no finite number becomes null."""
    text = json.dumps(as_plain(content), indent=indent, allow_nan=False)
    path.write_text(f"{text}\n", encoding="utf-8", newline="\n")


@contextmanager
def refusals(path: Path, remedy: str = "choose a place that you may write to") -> Iterator[None]:
    """Say in one line why something cannot be written."""
    try:
        yield
    except OSError as refusal:
        reason = refusal.strerror or str(refusal)
        raise OutputError(f"cannot be written ({reason})", remedy, where=path) from refusal

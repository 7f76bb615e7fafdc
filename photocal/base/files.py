"""Outputs that are whole or not there: written aside, then renamed.

Names that people give: on one line, without characters that hide, and compared as people read them.
"""

import csv
import hashlib
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
from photocal.base.errors import ConfigurationError, OutputError, PhotocalError, reason, system_refusals
from photocal.base.operating_system import replace

if TYPE_CHECKING:
    from matplotlib.figure import Figure
import unicodedata

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
        with filled(aside, path):
            yield aside
        with refusals(path):
            # mkstemp makes private files; a result is as readable as any file that the user makes.
            mask = os.umask(0)
            os.umask(mask)
            aside.chmod(0o666 & ~mask)
            replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def refuse_input_as_output(output: Path, *inputs: Path) -> None:
    """Refuse to write over what is read; raises ConfigurationError."""
    for path in inputs:
        if path.exists() and output.exists() and path.samefile(output):
            raise ConfigurationError("is read, and would be overwritten", "name another output", where=path)


def refuse_to_replace(output: Path) -> None:
    """Refuse to write over a file: a recording cannot be made again; raises ConfigurationError."""
    if output.exists() and not output.is_dir():
        raise ConfigurationError(
            "exists, and may be a recording", "name another output, or delete it first", where=output
        )


def picture_kind(path: Path) -> str:
    """Give the kind of a picture by its ending; raises ConfigurationError for one that is not made."""
    kind = path.suffix.lower()[1:]
    if kind not in _PICTURES:
        raise ConfigurationError(f"{path} has no known extension", "use .pdf, .svg or .png")
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
        with filled(aside, path):
            yield aside
        with refusals(path):
            for made in sorted(p for p in aside.rglob("*") if p.is_file()):
                final = path / made.relative_to(aside)
                final.parent.mkdir(parents=True, exist_ok=True)
                made.replace(final)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV table with its head."""
    with _of(path), path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([columns, *rows])


def rows_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Give a CSV table with its head as text; a cell of None is empty."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()


def write_json(path: Path, content: Any, indent: int | None = 1) -> None:
    """Write figures for programs; what is no finite number becomes null."""
    text = json.dumps(as_plain(content), indent=indent, allow_nan=False)
    with _of(path):
        path.write_text(f"{text}\n", encoding="utf-8", newline="\n")


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file that is there whole or not at all; errors as of `output_file`."""
    with output_file(path) as aside:
        aside.write_bytes(content.encode() if isinstance(content, str) else content)


def write_pdf(path: Path, content: bytes) -> None:
    """Write a PDF; raises ConfigurationError for a name that does not say so: it would not open."""
    if path.suffix.lower() != ".pdf":
        raise ConfigurationError(f"{path} has no known extension", "use .pdf")
    write_file(path, content)


@contextmanager
def _of(path: Path) -> Iterator[None]:
    """Give a refusal the name of the file: those of a full disk have none."""
    try:
        yield
    except OSError as refusal:
        refusal.filename = refusal.filename or str(path)
        raise


@contextmanager
def filled(aside: Path, path: Path) -> Iterator[None]:
    """Say in one line why what is written aside cannot be, by the name that it would get.

    raises InputNotFoundError: when it is another file that cannot be read.
    """
    try:
        with system_refusals(path):
            yield
    except PhotocalError as refusal:
        # Not only its own: what was written there by others, too.
        refusal.where = refusal.where.replace(str(aside), str(path))
        raise


@contextmanager
def refusals(path: Path, remedy: str = "choose a place that you may write to") -> Iterator[None]:
    """Say in one line why something cannot be written."""
    try:
        yield
    except OSError as refusal:
        raise OutputError(f"cannot be written ({reason(refusal)})", remedy, where=path) from refusal


# Control and format (zero width, right to left), line and paragraph ends, halves and no characters.
_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


def one_line(name: str) -> str:
    """Return a name that a terminal prints as it is.

    raises ValueError: when a character in it cannot be seen, steers a terminal or ends a line.
    """
    hidden = next((c for c in name if unicodedata.category(c) in _HIDDEN), None)
    if hidden is not None:
        what = unicodedata.name(hidden, "control character").lower()
        raise ValueError(f"has a character that is not printed, U+{ord(hidden):04X} ({what})")
    return name


def plain_name(name: str) -> str:
    """Return a name in its one form: NFKC of Unicode, blanks folded, none at its ends.

    raises ValueError: as of `one_line`, and for a name of blanks.
    """
    plain = " ".join(unicodedata.normalize("NFKC", one_line(name)).split())
    if not plain:
        raise ValueError("is empty")
    return one_line(plain)


def compared(name: str) -> str:
    """Return what two names have in common that people take for the same: neither case nor form counts."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())

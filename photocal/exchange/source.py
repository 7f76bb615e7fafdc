"""Reading other programs' text safely: encodings, line ends, numbers, sizes, and paths that stay inside."""

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, TypeVar
from xml.etree.ElementTree import Element, ParseError, indent, tostring

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.base.text_tables import MARKS, require_file, windows_encoding
from photocal.block.model import InputFile
from photocal.block.model import fingerprint as plain_fingerprint

# Larger text than any block in use; above it a file is taken for something else.
MAX_BYTES = 2 << 30
# No camera has more pixels on a side; a larger number is a damaged or hostile file.
MAX_SIDE_PX = 1_000_000
# Halves of an end of line with halves of their neighbours: letters that no alphabet has.
_SHIFTED = ("\u0a00", "\u0a0d")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
T = TypeVar("T")
MAX_XML_BYTES = 256 << 20


@dataclass(frozen=True)
class Line:
    """A line of a text file that can name its place."""

    path: Path
    number: int
    text: str

    @property
    def place(self) -> str:
        """File and line, for messages."""
        return f"{self.path}, line {self.number}"

    def malformed(self, what: str, remedy: str = "") -> InputMalformedError:
        """Complaint about it."""
        return InputMalformedError(what, remedy, where=self.place)


def require_readable(path: Path) -> int:
    """Refuse a path that is not a file with content of a credible size.

    raises InputNotFoundError: when it is missing, empty or a folder.
    raises InputMalformedError: when it is too large to be what it should be.
    """
    size = require_file(path)
    if size > MAX_BYTES:
        raise InputMalformedError(
            f"has {size / 2**30:.1f} GiB, more than the {MAX_BYTES / 2**30:.0f} GiB that can be read",
            "is it the right file?",
            where=path,
        )
    return size


def read_text(path: Path, *, windows: bool = False) -> str:
    """Read a text file: UTF-8, or UTF-16 with its mark.

    windows: whether it may be in a code page of Windows, as spreadsheets write texts.

    raises InputNotFoundError: when it is missing, empty or a folder.
    raises InputMalformedError: when it is not text of these encodings.
    """
    require_readable(path)
    content = path.read_bytes()
    encoding = next((name for mark, name in MARKS if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as failure:
        if windows and encoding == "utf-8":
            return _plain(content.decode(windows_encoding(content), "replace"), path)
        line = content[: failure.start].count(b"\n") + 1
        raise InputMalformedError(
            f"is not {encoding.removesuffix('-sig').upper()} text (byte 0x{content[failure.start]:02x})",
            "save it as UTF-8",
            where=f"{path}, line {line}",
        ) from failure
    if encoding == "utf-16" and any(mark in text for mark in _SHIFTED):
        raise InputMalformedError(
            "is UTF-16 whose line ends were changed as if it were plain text: letters are cut in two",
            "copy it again as a binary file, or save it as UTF-8",
            where=path,
        )
    return _plain(text, path)


def _plain(text: str, path: Path) -> str:
    """Give a text with the line ends of ours; what has no letters of a text is none."""
    if "\0" in text:
        raise InputMalformedError("is not a text file", "is it the right file?", where=path)
    # Programs of DOS end a text with this sign.
    return text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a")


def read_lines(path: Path, comment: str = "#", *, windows: bool = False) -> list[Line]:
    """Read the lines of a text file that have content.

    windows: as of `read_text`.

    raises InputNotFoundError, InputMalformedError: as `read_text`.
    """
    lines = (
        Line(path, k, text) for k, text in enumerate(read_text(path, windows=windows).split("\n"), start=1)
    )
    return [
        line
        for line in lines
        if line.text.strip() and not (comment and line.text.lstrip().startswith(comment))
    ]


def number(cell: str, place: object, what: str) -> float:
    """Read one finite number.

    raises InputMalformedError: when it is not a finite number with a decimal point.
    """
    text = cell.strip()
    try:
        # float() would take underscores for separators of thousands.
        value = float(text.replace("_", "?"))
    except ValueError:
        comma = _DECIMAL_COMMA.fullmatch(text) is not None
        said = f"{what} is {text[:40]!r}, written with a decimal comma" if comma else ""
        raise InputMalformedError(
            said or f"{what} is {text[:40]!r}, not a number",
            "write numbers with a decimal point" if comma else "correct it",
            where=place,
        ) from None
    if not math.isfinite(value):
        raise InputMalformedError(f"{what} is {text[:40]!r}, not finite", "correct it", where=place)
    return value


def printed(text: Any) -> float:
    """Read a number that a program has printed for people; NaN for "none" and what is no number."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


def decimal_comma(cells: Sequence[str]) -> bool:
    """Whether cells, one or more, are numbers with decimal commas."""
    return bool(cells) and all(_DECIMAL_COMMA.fullmatch(cell.strip()) for cell in cells)


def numbers(text: str, place: object, what: str, count: int | None = None) -> list[float]:
    """Read numbers separated by blanks."""
    cells = text.split()
    if count is not None and len(cells) != count:
        raise InputMalformedError(
            f"{what}: {len(cells)} values where {count} were expected",
            "complete the line, or is the file truncated?",
            where=place,
        )
    return [number(cell, place, what) for cell in cells]


def image_size(width: float, height: float, place: object) -> tuple[int, int]:
    """Check an image size that a file claims."""
    if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX) or width % 1 or height % 1:
        raise InputMalformedError(
            f"image size {width:g} x {height:g} px is impossible", "correct it", where=place
        )
    return int(width), int(height)


def beside(folder: Path, name: str, place: object) -> Path:
    """Find a file that a set-up names, inside the folder of the set-up.

    Set-ups name their tables by relative paths that hold on the machine where they were made. When the
    path does not exist here, a file of the same name beside the set-up is taken.

    raises InputMalformedError: for absolute paths and paths that lead out of the folder.
    raises InputNotFoundError: when there is no such file.
    """
    parts = PurePosixPath(name.replace("\\", "/"))
    outside = parts.is_absolute() or bool(PureWindowsPath(name).drive) or ".." in parts.parts
    malformed = InputMalformedError.at(place)
    # Bytes of a name: what the file systems in use allow.
    longest_name = 255
    if outside or "\0" in name or not 0 < len(parts.name.encode("utf-8", "replace")) <= longest_name:
        raise malformed(
            f"names the file {name!r}, which is not inside its folder",
            "put the file beside the set-up and name it without folders",
        )
    for candidate in (folder / parts, folder / parts.name):
        if candidate.is_file():
            if not candidate.resolve().is_relative_to(folder.resolve()):
                raise malformed(
                    f"names the file {name!r}, a link that leads out of its folder", "copy the file"
                )
            return candidate
    raise InputNotFoundError(
        f"names the file {name!r}, which is neither there nor beside the set-up",
        "put it beside the set-up",
        where=place,
    )


def fingerprint(path: Path) -> InputFile:
    """Digest of a file that was read, under its whole path; a block has them within their common folder."""
    require_readable(path)
    return plain_fingerprint(path, path.resolve().as_posix())


def read_json(path: Path) -> Any:
    """Read a JSON object; errors in one line; raises InputNotFoundError, InputMalformedError."""
    text = read_text(path)
    try:
        content = json.loads(text, parse_constant=_finite, parse_float=_finite)
        if "\\u" in text:
            # Half of a character may be escaped, though no table or document can hold it.
            json.dumps(content, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as failure:
        raise InputMalformedError(
            f"is not valid JSON ({failure})", "was it written completely?", where=path
        ) from failure
    return content


def structured(path: Path, what: str, read: Callable[[], T]) -> T:
    """Read something of a JSON file; turn what a wrong structure raises into one line."""
    try:
        return read()
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, IndexError) as failure:
        raise InputMalformedError(
            f"lacks the structure of {what} ({type(failure).__name__}: {str(failure)[:80]})", where=path
        ) from failure


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:40]} is not finite")
    return value


def read_xml(path: Path) -> Element:
    """Read an XML file.

    raises InputNotFoundError: when it is missing, empty or a folder.
    raises InputMalformedError: when it is no XML, declares entities, or is too large.
    """
    if require_readable(path) > MAX_XML_BYTES:
        raise InputMalformedError(
            f"is larger than the {MAX_XML_BYTES >> 20} MiB that are read as XML",
            "is it the right file?",
            where=path,
        )
    return parse_xml(path.read_bytes(), path)


def parse_xml(content: bytes, path: object) -> Element:
    """Parse XML that is already in memory."""
    try:
        return fromstring(content, forbid_dtd=False)
    except DefusedXmlException as refusal:
        raise InputMalformedError(
            "declares XML entities or external references, which are not read",
            "remove the DOCTYPE",
            where=path,
        ) from refusal
    except (ParseError, ValueError, LookupError) as failure:
        raise InputMalformedError(
            f"is not valid XML ({failure})", "was it written completely?", where=path
        ) from failure


def child(element: Element, path: str, place: object) -> Element:
    """Find an element that must be there."""
    inner = element.find(path)
    if inner is None:
        raise InputMalformedError(
            f"<{element.tag}> has no <{path}>", "is it the right kind of file?", where=place
        )
    return inner


def text_of(element: Element, path: str, place: object) -> str:
    """Text of an element that must be there; parameters as in `child`."""
    return (child(element, path, place).text or "").strip()


def number_of(element: Element, path: str, place: object) -> float:
    """Number in an element that must be there; parameters as in `child`."""
    return number(text_of(element, path, place), place, path.rsplit("/", 1)[-1])


def write_xml(path: Path, root: Element) -> None:
    """Write a document as indented UTF-8."""
    indent(root)
    path.write_bytes(b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="utf-8") + b"\n")

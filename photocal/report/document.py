"""What a report consists of, whatever prints it: sections of paragraphs, lists, tables and figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Align = Literal["left", "right", "center"]
Tone = Literal["good", "bad", "note"]


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str


@dataclass(frozen=True)
class Statement:
    """A sentence that stands out: a verdict, a warning, or a remark."""

    tone: Tone
    title: str
    text: str


@dataclass(frozen=True)
class KeyValues:
    """A list of what is called how: (label, value)."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Column:
    """Heading, unit and alignment of one column; `code` for what is compared letter by letter."""

    head: str
    unit: str = ""
    align: Align = "right"
    code: bool = False


@dataclass(frozen=True)
class Table:
    """A table with its caption above and its note beneath.

    caption: what it shows.
    columns: the columns.
    rows: one text for each column.
    note: explanation beneath, may be empty.
    dense: whether it has so many columns that small type is needed.
    widths: shares of the width for each column of text that wraps; empty for columns as wide as their
        content.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    dense: bool = False
    widths: tuple[float, ...] = ()


@dataclass(frozen=True)
class Figure:
    """A picture.

    name: short name, unique within the document.
    caption: what it shows, printed beneath.
    alternative: what it shows, in words, for those who cannot see it.
    svg: the picture.
    width: share of the text width, 0 to 1.
    """

    name: str
    caption: str
    alternative: str
    svg: str
    width: float = 1.0


@dataclass(frozen=True)
class Signature:
    """A place to sign: what stands beneath each line."""

    lines: tuple[str, ...]


Piece = Paragraph | Statement | KeyValues | Table | Figure | Signature


@dataclass(frozen=True)
class Section:
    """A numbered part of the report."""

    title: str
    pieces: tuple[Piece, ...]


@dataclass(frozen=True)
class Highlight:
    """One of the figures that a reader looks for first: label, value, what it means."""

    label: str
    value: str
    remark: str = ""


@dataclass(frozen=True)
class Document:
    """A whole report.

    language: code of its language, as HTML wants it.
    title, subtitle: what it is, and of what.
    number: its own number.
    facts: date, client and such, beneath the title.
    highlights: the main figures.
    verdicts: what follows from them.
    sections: the parts.
    words: the few words that the renderers need themselves (page, table, figure ...).
    """

    language: str
    title: str
    subtitle: str
    number: str
    facts: KeyValues
    highlights: tuple[Highlight, ...]
    verdicts: tuple[Statement, ...]
    sections: tuple[Section, ...]
    words: dict[str, str]

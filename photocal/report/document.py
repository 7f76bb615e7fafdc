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

    Attributes
    ----------
    caption : str
        What it shows.
    columns : tuple of Column
        The columns.
    rows : tuple of tuple of str
        One text for each column.
    note : str
        Explanation beneath, may be empty.
    dense : bool
        Whether it has so many columns that small type is needed.
    widths : tuple of float
        Shares of the width for each column of text that wraps; empty for columns as wide as their content.
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

    Attributes
    ----------
    name : str
        Short name, unique within the document.
    caption : str
        What it shows, printed beneath.
    alternative : str
        What it shows, in words, for those who cannot see it.
    svg : str
        The picture.
    width : float
        Share of the text width, 0 to 1.
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

    Attributes
    ----------
    language : str
        Code of its language, as HTML wants it.
    title, subtitle : str
        What it is, and of what.
    number : str
        Its own number.
    facts : KeyValues
        Date, client and such, beneath the title.
    highlights : tuple of Highlight
        The main figures.
    verdicts : tuple of Statement
        What follows from them.
    sections : tuple of Section
        The parts.
    words : dict
        The few words that the renderers need themselves (page, table, figure ...).
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

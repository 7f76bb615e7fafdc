"""What a document consists of, and its renderers: terminal, Markdown, HTML, and PDF set by typst."""

import datetime as dt
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib import resources
from textwrap import TextWrapper
from typing import Any, Literal

from photocal.base.arrays import as_plain
from photocal.base.errors import OutputError
from photocal.findings.digits import PLAIN
from photocal.findings.texts import Catalogue

Align = Literal["left", "right", "center"]
Tone = Literal["good", "bad", "note"]
HTML_TEMPLATE = "document.html.j2"
HTML_STYLE = "document.css"
TEMPLATE = "document.typ"
_PARAGRAPH = TextWrapper(118)
_WRAPPED = TextWrapper(118, initial_indent="* ", subsequent_indent="  ")


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str


@dataclass(frozen=True)
class Statement:
    """What stands out: a verdict, a warning, or a remark; lines: its reasons, one below the other."""

    tone: Tone
    title: str
    text: str
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Remarks:
    """Sentences that each stand for themselves."""

    texts: tuple[str, ...]


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


def columns(say: Catalogue, section: str, *heads: str) -> tuple[Column, ...]:
    """Make columns whose heads stand in a section of the catalogue.

    heads: keys, "key<" for a column set left and "key=" for a centred one, "key [unit]".
    """
    aligned: dict[str, Align] = {"<": "left", "=": "center"}
    made = []
    for head in heads:
        key, _, unit = head.removesuffix("]").partition(" [")
        name = key.rstrip("<=")
        made.append(Column(say(f"{section}.{name}"), unit, aligned.get(key[len(name) :], "right")))
    return tuple(made)


@dataclass(frozen=True)
class TablePart:
    """A table with its caption above and its note beneath.

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


def said_table(
    say: Catalogue,
    key: str,
    heads: Sequence[str | Column],
    rows: Iterable[Sequence[str]],
    note: str = "",
    *,
    dense: bool = False,
    widths: tuple[float, ...] = (),
    **values: object,
) -> TablePart:
    """Make a table whose caption is a text of the catalogue, and whose heads stand in its section.

    heads: as of `columns`, or columns as they are.
    values: of the caption.
    """
    section = key.partition(".")[0]
    shown = (each if isinstance(each, Column) else columns(say, section, each)[0] for each in heads)
    return TablePart(say(key, **values), tuple(shown), tuple(map(tuple, rows)), note, dense, widths)


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> TablePart:
    """Make a table of figures; its first column has names, one whose head ends in "<" has text."""
    lefts = (k == 0 or head.endswith("<") for k, head in enumerate(heads))
    columns = tuple(
        Column(head.rstrip("<"), align="left" if left else "right")
        for head, left in zip(heads, lefts, strict=True)
    )
    return TablePart(caption, columns, tuple(map(tuple, rows)), note)


@dataclass(frozen=True)
class PicturePart:
    """A picture.

    name: short name, unique within the document.
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


Piece = Paragraph | Statement | Remarks | KeyValues | TablePart | PicturePart | Signature


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
    words: the few words that the renderers need themselves (page, table, figure ...).
    sheets: whether each section begins a page of its own, without numbers.
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
    sheets: bool = False


def text(sections: Sequence[Section]) -> str:
    """Render sections for a terminal, parameters as programs write them: pictures are left out."""
    blocks = ("\n\n".join(filter(None, map(_lines, section.pieces))) for section in sections)
    titled = (
        f"{section.title}\n{block}".strip("\n") for section, block in zip(sections, blocks, strict=True)
    )
    return "\n\n".join(titled).translate(PLAIN)


def _lines(piece: Piece) -> str:
    match piece:
        case TablePart():
            return "\n".join(filter(None, (piece.caption, aligned(piece.columns, piece.rows), piece.note)))
        case KeyValues(rows):
            return aligned((Column("", align="left"),) * 2, rows)
        case Remarks(texts):
            return "\n".join(map(_WRAPPED.fill, texts))
        case Statement():
            head = f"{piece.title}: {piece.text}" if piece.title else piece.text
            return "\n".join([_PARAGRAPH.fill(head), *map(_WRAPPED.fill, piece.lines)])
        case Signature(lines):
            return "\n".join(lines)
        case PicturePart():
            return ""
    return piece.text


def aligned(columns: Sequence[Column], rows: Sequence[Sequence[str]]) -> str:
    """Set a table in columns of one width, below their heads where there are any."""
    table = [row for row in (_heads(columns), *rows) if any(row)]
    widths = [max(map(len, cells)) for cells in zip(*table, strict=True)]
    signs = {"left": "<", "right": ">", "center": "^"}
    forms = [f"{{:{signs[c.align]}{width}}}" for c, width in zip(columns, widths, strict=True)]
    return "\n".join("  ".join(forms).format(*row).rstrip() for row in table)


def _heads(columns: Sequence[Column]) -> list[str]:
    return [f"{column.head} [{column.unit}]" if column.unit else column.head for column in columns]


def markdown(title: str, sections: Sequence[Section]) -> str:
    """Render sections as Markdown: pictures are left out."""
    blocks = [f"# {title}"]
    for section in sections:
        blocks += [f"## {section.title}"] if section.title else []
        for piece in section.pieces:
            if isinstance(piece, TablePart):
                table = [_heads(piece.columns), ["---"] * len(piece.columns), *piece.rows]
                lines = "\n".join(f"| {' | '.join(row)} |" for row in table)
                blocks += [part for part in (piece.caption, lines, piece.note) if part]
            elif isinstance(piece, Remarks):
                blocks.append("\n".join(f"- {remark}" for remark in piece.texts))
            else:
                blocks.append(_lines(piece))
    return "\n\n".join(blocks) + "\n"


# Blanks within a figure: before its unit, and about the signs between value, sigma and factor.
_UNITS = r"(?:[mcµk]?m|px|µm|m?s|min|h|ha|deg|graus|ppm|rad|mrad|arcsec|[kM]B|GB|sd|gon|%|°|″)"
_BEFORE_UNIT = rf"(?<=[\d⁰¹²³⁴-⁹]) (?=(?:10[⁻⁰¹²³⁴-⁹]+ )?{_UNITS}[²³]?(?!\w)|±|×)"
_WITHIN = re.compile(rf"{_BEFORE_UNIT}|(?<=[=±≈<>×]) (?=[+−\d-])")


def unbroken(text: str) -> str:
    """Keep value, sigma and unit of each figure on one line, by blanks that do not break."""
    return _WITHIN.sub("\N{NO-BREAK SPACE}", text)


def _unbroken(part: Any) -> Any:
    """The same of all texts of a part of a document; drawings stay."""
    if isinstance(part, str):
        return unbroken(part)
    if isinstance(part, tuple):
        return tuple(map(_unbroken, part))
    if not is_dataclass(part) or isinstance(part, type):
        return part
    texts = (field.name for field in fields(part) if field.name not in ("svg", "name", "words"))
    return replace(part, **{name: _unbroken(getattr(part, name)) for name in texts})


def html(document: Document) -> str:
    """Render a report as HTML."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    document = _unbroken(document)

    figures = [piece for piece in _pieces(document) if isinstance(piece, PicturePart)]
    numbers = numbered(document)
    pages = Environment(loader=FunctionLoader(_text), autoescape=True, undefined=StrictUndefined)
    text = pages.get_template(HTML_TEMPLATE).render(
        document=document,
        css=Markup(_text(HTML_STYLE)),  # noqa: S704 - our own style sheet
        number=lambda piece: numbers[id(piece)],
        pictures={figure.name: Markup(_inline(figure)) for figure in figures},  # noqa: S704 - drawn here
    )
    return re.sub(r"\n{2,}", "\n", text).strip() + "\n"


def numbered(document: Document) -> dict[int, int]:
    """Number the tables and the figures, each kind from 1 on, as they stand: equal ones are two."""
    numbers: dict[int, int] = {}
    for kind in (TablePart, PicturePart):
        pieces = [piece for piece in _pieces(document) if isinstance(piece, kind)]
        numbers.update({id(piece): number for number, piece in enumerate(pieces, start=1)})
    return numbers


def _pieces(document: Document) -> list[object]:
    return [piece for section in document.sections for piece in section.pieces]


def _inline(figure: PicturePart) -> str:
    """Make the ids of a picture its own, as several stand in one page, and name it for a screen reader."""
    from markupsafe import escape

    svg = re.sub(r'\bid="', f'id="{figure.name}-', figure.svg)
    svg = re.sub(r"url\(#", f"url(#{figure.name}-", svg)
    svg = re.sub(r'href="#', f'href="#{figure.name}-', svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return svg.replace("<svg", f'<svg role="img" aria-label="{escape(figure.alternative)}"', 1)


def _text(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def pdf(document: Document, date: dt.date) -> bytes:
    """Render a report as PDF."""
    inputs = {"document": json.dumps(as_json(_unbroken(document)), ensure_ascii=False)}
    return typeset(resources.files(__package__).joinpath(TEMPLATE).read_bytes(), date, inputs)


def typeset(source: bytes, date: dt.date, inputs: Mapping[str, str] | None = None) -> bytes:
    """Set a PDF by Typst, with the fonts that are its own; raises OutputError.

    date: of the PDF, that it is the same each time.
    inputs: what the source takes by `sys.inputs`.
    """
    import typst

    fonts = typst.Fonts(include_system_fonts=False)
    compiler = typst.Compiler(font_paths=fonts, sys_inputs=dict(inputs or {}))
    midnight = dt.datetime.combine(date, dt.time(), tzinfo=dt.UTC)
    wrong, remedy = "the PDF could not be typeset ({})", "report this"
    try:
        made = compiler.compile(source, format="pdf", timestamp=midnight)
    except typst.TypstError as refusal:
        raise OutputError(wrong.format(refusal), remedy) from None
    if not isinstance(made, bytes):
        raise OutputError(wrong.format("no single file"), remedy)
    # Poppler complains of what holds unless another is said (ISO 32000-1, 14.7.1); blanks keep all offsets.
    unsaid = b"/Suspects false"
    return made.replace(unsaid, b" " * len(unsaid))


def as_json(document: Document) -> dict[str, Any]:
    """Give a report as a JSON value: each piece says its kind, tables and pictures their numbers."""
    numbers = numbered(document)

    def beside(part: object) -> dict[str, Any]:
        """Give what accompanies a part: its kind, its number, its cells as text."""
        more: dict[str, Any] = {"kind": type(part).__name__}
        if id(part) in numbers:
            more["number"] = numbers[id(part)]
        if isinstance(part, TablePart):
            texts = zip(*[(c.head, c.unit) for c in part.columns], strict=True)
            # The longest text shares the width; heads are bold, a digest is set in very small type.
            more["shares"] = [
                max(5, min(max(1.2 * len(head), *map(len, column)), 40))
                for head, *column in zip(*texts, *part.rows, strict=True)
            ]
        return more

    plain: dict[str, Any] = as_plain(document, beside)
    return plain

"""A report as PDF, set by Typst with the fonts that come with it: the same bytes everywhere."""

from __future__ import annotations

import dataclasses
import datetime as dt
import json
from importlib import resources
from typing import Any

from drivers.errors import OutputError
from photocal.report.document import Document, Piece, Table
from photocal.report.html import numbered

TEMPLATE = "certificate.typ"


def pdf(document: Document, date: dt.date) -> bytes:
    """Render a report as PDF."""
    import typst

    template = resources.files(__package__).joinpath(TEMPLATE).read_bytes()
    compiler = typst.Compiler(
        font_paths=typst.Fonts(include_system_fonts=False),
        sys_inputs={"document": json.dumps(_plain(document), ensure_ascii=False)},
    )
    midnight = dt.datetime.combine(date, dt.time(), tzinfo=dt.UTC)
    try:
        pages = compiler.compile(template, format="pdf", timestamp=midnight)
    except typst.TypstError as refusal:
        raise OutputError(
            f"the PDF could not be set ({refusal})", remedy="report this with the run folder"
        ) from None
    if not isinstance(pages, bytes):
        raise OutputError(
            "the PDF could not be set (no single file)", remedy="report this with the run folder"
        )
    return pages


def _plain(document: Document) -> dict[str, Any]:
    numbers = numbered(document)
    plain = dataclasses.asdict(document)
    plain["facts"] = document.facts.rows
    plain["sections"] = [
        {"title": section.title, "pieces": [_piece(piece, numbers) for piece in section.pieces]}
        for section in document.sections
    ]
    return plain


def _piece(piece: Piece, numbers: dict[int, int]) -> dict[str, Any]:
    plain = {"kind": type(piece).__name__, **dataclasses.asdict(piece)}
    if id(piece) in numbers:
        plain["number"] = numbers[id(piece)]
    if isinstance(piece, Table):
        plain["columns"] = [
            {**dataclasses.asdict(column), "weight": _weight(piece, i)}
            for i, column in enumerate(piece.columns)
        ]
    return plain


def _weight(table: Table, column: int) -> int:
    """Length of the longest text in a column, by which the width is shared."""
    texts = [table.columns[column].head, table.columns[column].unit, *(row[column] for row in table.rows)]
    longest = max(len(text) for text in texts)
    # A digest is set in very small type.
    return max(5, min(longest, 40))

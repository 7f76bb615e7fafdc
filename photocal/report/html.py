"""A report as one HTML page that needs no other file."""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING

from photocal.report.document import Document, Figure, Table

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATE = "certificate.html.j2"
STYLE = "certificate.css"


def html(document: Document) -> str:
    """Render a report as HTML."""
    from markupsafe import Markup

    figures = [piece for piece in _pieces(document) if isinstance(piece, Figure)]
    numbers = numbered(document)
    template = _environment().get_template(TEMPLATE)
    text = template.render(
        document=document,
        css=Markup(_text(STYLE)),  # noqa: S704 - our own style sheet
        number=lambda piece: numbers[id(piece)],
        pictures={figure.name: Markup(_inline(figure)) for figure in figures},  # noqa: S704 - drawn here
    )
    return re.sub(r"\n{2,}", "\n", text).strip() + "\n"


def numbered(document: Document) -> dict[int, int]:
    """Number the tables and the figures, each kind from 1 on, as they stand: equal ones are two."""
    numbers: dict[int, int] = {}
    for kind in (Table, Figure):
        found = [piece for piece in _pieces(document) if isinstance(piece, kind)]
        numbers.update({id(piece): number for number, piece in enumerate(found, start=1)})
    return numbers


def _pieces(document: Document) -> list[object]:
    return [piece for section in document.sections for piece in section.pieces]


def _inline(figure: Figure) -> str:
    """Make the ids of a picture its own, as several stand in one page, and name it for a screen reader."""
    from markupsafe import escape

    svg = re.sub(r'\bid="', f'id="{figure.name}-', figure.svg)
    svg = re.sub(r"url\(#", f"url(#{figure.name}-", svg)
    svg = re.sub(r'href="#', f'href="#{figure.name}-', svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return svg.replace("<svg", f'<svg role="img" aria-label="{escape(figure.alternative)}"', 1)


def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(loader=FunctionLoader(_text), autoescape=True, undefined=StrictUndefined)


def _text(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")

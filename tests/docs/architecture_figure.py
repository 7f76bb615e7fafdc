"""The figure of the architecture, laid out from the imports of the sources.

A room stands one floor above the highest room that it imports. Its sentence is the first line of its package.
Arrows that follow from others are left out. `python -m tests.docs` writes docs/architecture.svg.
"""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from xml.sax.saxutils import escape

from tests.docs.rooms import ROOT, Edges, between_rooms, modules

FIGURE = ROOT / "docs" / "architecture.svg"

# `python -m` goes the way of the command.
_ENTRANCES = {"acquire.__main__": "acquire.commands", "photocal.__main__": "photocal.commands"}
# Number on the way of one observation, as the page tells it.
STEPS = {
    "drivers": "1",
    "acquire.recording": "2",
    "acquire.importing": "2",
    "acquire.log": "3",
    "acquire.channels": "3",
    "photocal.navigation": "4",
    "photocal.measurement": "5",
    "photocal.block": "6",
    "photocal.adjustment": "7",
    "photocal.analysis": "8",
    "photocal.hypotheses": "8",
    "photocal.report": "9",
}
_FILL = {"drivers": "#f3ead7", "acquire": "#e2eee6", "photocal": "#e4ebf5"}
_INK, _PALE = "#1d2733", "#5b6b7b"
_WIDE, _TALL, _APART, _BETWEEN, _MARGIN = 190, 92, 16, 34, 20


@dataclass(frozen=True)
class Box:
    """A room of the figure: name, sentence, floor (0 on the ground) and place on the floor."""

    room: str
    sentence: str
    floor: int
    place: int


def rooms() -> Edges:
    """Return which room imports from which, the ways into a package joined to one room."""
    edges: Edges = {}
    for room, others in between_rooms().items():
        edges.setdefault(_ENTRANCES.get(room, room), set()).update(others)
    return {room: others - {room} for room, others in edges.items()}


def sentence(room: str) -> str:
    """Return the first line of a room's docstring; empty where it has none."""
    tree = ast.parse(modules()[room].read_text(encoding="utf-8"))
    return (ast.get_docstring(tree) or "").split("\n")[0]


@cache
def boxes() -> dict[str, Box]:
    """Place every room on its floor; on a floor rooms of one package stand together."""
    edges = rooms()

    @cache
    def floor(room: str) -> int:
        return 1 + max(map(floor, edges[room]), default=-1)

    floors: dict[int, list[str]] = {}
    for room in sorted(edges, key=lambda name: (name.partition(".")[0] == "photocal", name)):
        floors.setdefault(floor(room), []).append(room)
    return {
        room: Box(room, sentence(room), level, place)
        for level, members in floors.items()
        for place, room in enumerate(members)
    }


def arrows() -> list[tuple[str, str]]:
    """Return the arrows that do not follow from others."""
    edges = rooms()

    @cache
    def reached(room: str) -> frozenset[str]:
        return frozenset(edges[room]).union(*map(reached, edges[room]))

    return [
        (room, other)
        for room in sorted(edges)
        for other in sorted(edges[room])
        if not any(other in reached(third) for third in edges[room] - {other})
    ]


def figure() -> str:
    """Draw the figure as SVG."""
    placed = boxes()
    floors = 1 + max(box.floor for box in placed.values())
    across = 1 + max(box.place for box in placed.values())
    width = 2 * _MARGIN + across * (_WIDE + _APART) - _APART
    height = 2 * _MARGIN + floors * (_TALL + _BETWEEN)
    crowd = {level: sum(box.floor == level for box in placed.values()) for level in range(floors)}

    def corner(box: Box) -> tuple[float, float]:
        spare = (across - crowd[box.floor]) * (_WIDE + _APART) / 2
        left = _MARGIN + spare + box.place * (_WIDE + _APART)
        return left, _MARGIN + (floors - 1 - box.floor) * (_TALL + _BETWEEN)

    def arrow(room: str, other: str) -> str:
        (x0, y0), (x1, y1) = corner(placed[room]), corner(placed[other])
        return (
            f'<line x1="{x0 + _WIDE / 2:g}" y1="{y0 + _TALL:g}" x2="{x1 + _WIDE / 2:g}" y2="{y1 - 1:g}" '
            f'stroke="{_PALE}" stroke-width="1.2" stroke-opacity="0.75" marker-end="url(#tip)"/>'
        )

    parts = [
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height + 30:g}" '
            'font-family="Helvetica, Arial, sans-serif">'
        ),
        "<title>Subpackages of photocal and their imports</title>",
        (
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
            f'orient="auto"><path d="M0 0.8 L8 4 L0 7.2 z" fill="{_PALE}"/></marker></defs>'
        ),
        f'<rect width="{width:g}" height="{height + 30:g}" fill="#ffffff"/>',
        *(arrow(*pair) for pair in arrows()),
        *(line for box in placed.values() for line in _box(box, *corner(box))),
        _badge(_MARGIN + 12, height + 6, "1"),
        (
            f'<text x="{_MARGIN + 32}" y="{height + 11:g}" font-size="13" fill="{_INK}">the way of one '
            "observation; an arrow points to what is imported, and what follows from other arrows is left "
            "out</text>"
        ),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _box(box: Box, left: float, top: float) -> Iterator[str]:
    fill = _FILL[box.room.partition(".")[0]]
    yield (
        f'<rect x="{left:g}" y="{top:g}" width="{_WIDE}" height="{_TALL}" rx="5" fill="{fill}" '
        f'stroke="{_INK}"/>'
    )
    middle = f'x="{left + _WIDE / 2:g}" text-anchor="middle" fill="{_INK}"'
    yield f'<text {middle} y="{top + 20:g}" font-size="14" font-weight="bold">{escape(box.room)}</text>'
    for k, line in enumerate(textwrap.wrap(box.sentence, 31)[:5]):
        yield f'<text {middle} y="{top + 36 + 13 * k:g}" font-size="11">{escape(line)}</text>'
    if box.room in STEPS:
        yield _badge(left + 3, top + 3, STEPS[box.room])


def _badge(x: float, y: float, number: str) -> str:
    return (
        f'<circle cx="{x:g}" cy="{y:g}" r="11" fill="#a33a1b"/>'
        f'<text x="{x:g}" y="{y + 4.5:g}" text-anchor="middle" font-size="13" font-weight="bold" '
        f'fill="#ffffff">{number}</text>'
    )


def main() -> None:
    """Write docs/architecture.svg."""
    FIGURE.write_text(figure(), encoding="utf-8")


if __name__ == "__main__":
    main()

"""The figure of the architecture: rooms where they stand, arrows from the real imports.

`python -m tests.docs.architecture_figure` writes docs/architecture.svg.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

from tests.docs.rooms import Edges, between_rooms

FIGURE = Path(__file__).parents[2] / "docs" / "architecture.svg"

# Small rooms that everybody may use, and the demonstration above all: arrows to and from them are not drawn.
SHARED = (
    "acquire.console",
    "acquire.operating_system",
    "acquire.outputs",
    "acquire.web",
    "acquire.checked_toml",
    "acquire.checked_json",
    "acquire.names",
    "photocal.compiled",
    "photocal.findings",
    "photocal.geopackage",
    "photocal.tasks",
)
ABOVE_ALL = "photocal.demo"

_ROW, _TALL, _GAP = 84, 56, 13
_INK, _PALE = "#1d2733", "#5b6b7b"
_FILL = {"drivers": "#f3ead7", "acquire": "#e2eee6", "photocal": "#e4ebf5"}
_WIDTH, _HEIGHT = 1180, 790


@dataclass(frozen=True)
class Box:
    """A room of the figure.

    Attributes
    ----------
    title, says : str
        What stands in it.
    rooms : tuple of str
        The folders that it is.
    left, width, row : float
        Place; rows count from the top.
    step : str
        Number on the way of one observation, or nothing.
    """

    title: str
    says: str
    rooms: tuple[str, ...]
    left: int
    width: int
    row: int
    step: str = ""

    @property
    def right(self) -> int:
        """Right edge."""
        return self.left + self.width

    @property
    def top(self) -> int:
        """Upper edge."""
        return 70 + self.row * _ROW

    @property
    def bottom(self) -> int:
        """Lower edge."""
        return self.top + _TALL


def _typed(package: str) -> tuple[str, ...]:
    return f"{package}.commands", f"{package}.cli", f"{package}.__main__"


BOXES = (
    Box("commands", "what a person types", _typed("acquire"), 20, 500, 0),
    Box("simulate", "a flight with its truth", ("acquire.simulate",), 20, 140, 2),
    Box("monitor", "the live view", ("acquire.monitor",), 176, 140, 2),
    Box("importing", "recordings of others", ("acquire.importing",), 332, 140, 2, "2"),
    Box("recording", "devices, alarms", ("acquire.recording",), 176, 140, 3, "2"),
    Box("log · channels", "raw frames, and decoded", ("acquire.log", "acquire.channels"), 176, 344, 5, "3"),
    Box("transports", "serial, UDP, TCP, NTRIP", ("acquire.transports",), 176, 190, 6),
    Box("drivers", "bytes to messages and back; no file, no clock", ("drivers",), 20, 1140, 8, "1"),
    Box("commands · api", "what a person types", (*_typed("photocal"), "photocal.api"), 560, 600, 0),
    Box("run · debrief", "stages, kept by content", ("photocal.run", "photocal.debrief"), 560, 370, 1),
    Box("navigation", "PPK, exposures", ("photocal.navigation",), 560, 150, 2, "4"),
    Box("report", "certificate, verification", ("photocal.report",), 780, 230, 2, "9"),
    Box("products", "orthophotos", ("photocal.products",), 1020, 66, 2),
    Box("planning", "next flight", ("photocal.planning",), 1094, 66, 2),
    Box("measurement", "targets, ties, marks", ("photocal.measurement",), 560, 150, 3, "5"),
    Box("georeferencing", "DG, ISO, AT", ("photocal.georeferencing",), 880, 130, 3, "8"),
    Box("accuracy", "classes", ("photocal.accuracy",), 1060, 100, 4, "8"),
    Box("project", "the project file", ("photocal.project", "photocal.project"), 560, 150, 4),
    Box("analysis", "hidden errors", ("photocal.analysis",), 780, 150, 4, "8"),
    Box(
        "block · results · exchange",
        "folders, formats",
        ("photocal.block", "photocal.results", "photocal.exchange"),
        560,
        206,
        5,
        "6",
    ),
    Box("adjustment", "network, solver, covariance, reliability", ("photocal.adjustment",), 560, 480, 6, "7"),
    Box("geometry", "cameras, rotations, frames", ("photocal.geometry",), 560, 480, 7),
)  # fmt: skip


def boxes_of_rooms() -> dict[str, Box]:
    """Return the box of every room that has one."""
    return {room: box for box in BOXES for room in box.rooms}


def arrows() -> tuple[tuple[Box, Box], ...]:
    """Return the arrows between boxes as the sources have them, less those that follow from others."""
    places = boxes_of_rooms()
    edges: Edges = {}
    numbers = {box: str(k) for k, box in enumerate(BOXES)}
    for room, others in between_rooms().items():
        if room in places:
            there = {numbers[places[one]] for one in others if one in places}
            mine = numbers[places[room]]
            edges.setdefault(mine, set()).update(there - {mine})
    return tuple(
        (BOXES[int(a)], BOXES[int(b)])
        for a in sorted(edges, key=int)
        for b in sorted(edges[a], key=int)
        if not any(b in _reached(edges, other) for other in edges[a] - {b})
    )


def _reached(edges: Edges, start: str) -> set[str]:
    seen, waiting = set(), [start]
    while waiting:
        for other in edges.get(waiting.pop(), ()):
            if other not in seen:
                seen.add(other)
                waiting.append(other)
    return seen


def figure() -> str:
    """Draw the figure.

    Returns
    -------
    str
        SVG.
    """
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT + 60}" '
        'font-family="Helvetica, Arial, sans-serif">\n'
        "<title>Rooms of photocal and the arrows between them</title>\n"
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
        f'orient="auto"><path d="M0 0.8 L8 4 L0 7.2 z" fill="{_PALE}"/></marker></defs>\n'
        f'<rect width="{_WIDTH}" height="{_HEIGHT + 60}" fill="#ffffff"/>'
    )
    body = [*_titles(), *(_arrow(a, b) for a, b in arrows()), *(_box(box) for box in BOXES), *_legend()]
    return "\n".join([head, *body, "</svg>"]) + "\n"


def _titles() -> Iterator[str]:
    for left, name, says in ((20, "acquire", "in the field"), (560, "photocal", "after the flight")):
        yield (
            f'<text x="{left}" y="44" font-size="22" font-weight="bold" fill="{_INK}">{name}'
            f'<tspan font-size="14" font-weight="normal" fill="{_PALE}" dx="10">{says}</tspan></text>'
        )


def _arrow(a: Box, b: Box) -> str:
    left, right = max(a.left, b.left), min(a.right, b.right)
    if left < right:
        x = (left + right) / 2
        points = [(x, a.bottom), (x, b.top - 1)]
    elif b.right <= a.left:
        # To the left: out at the near corner, along under the box, down into the far end of the other.
        x, end = a.left + 20, b.right - 22
        points = [(x, a.bottom), (x, a.bottom + _GAP), (end, a.bottom + _GAP), (end, b.top - 1)]
    else:
        x, end = a.right - 20, b.left + 22
        points = [(x, a.bottom), (x, a.bottom + _GAP), (end, a.bottom + _GAP), (end, b.top - 1)]
    way = " ".join(f"{x:g},{y:g}" for x, y in points)
    return (
        f'<polyline points="{way}" fill="none" stroke="{_PALE}" stroke-width="1.4" '
        'stroke-linejoin="round" marker-end="url(#tip)"/>'
    )


def _box(box: Box) -> str:
    fill = _FILL[box.rooms[0].split(".")[0]]
    middle = (box.left + box.right) / 2
    x, fonts = f'x="{middle:g}"', f'text-anchor="middle" fill="{_INK}"'
    place = f'x="{box.left}" y="{box.top}" width="{box.width}" height="{_TALL}"'
    parts = [
        f'<rect {place} rx="5" fill="{fill}" stroke="{_INK}"/>',
        f'<text {x} y="{box.top + 25}" font-size="15" font-weight="bold" {fonts}>{escape(box.title)}</text>',
        f'<text {x} y="{box.top + 43}" font-size="12" {fonts}>{escape(box.says)}</text>',
    ]
    if box.step:
        parts.append(_badge(box.left + 3, box.top + 3, box.step))
    return "\n".join(parts)


def _badge(x: float, y: float, number: str) -> str:
    return (
        f'<circle cx="{x:g}" cy="{y:g}" r="11" fill="#a33a1b"/>'
        f'<text x="{x:g}" y="{y + 4.5:g}" text-anchor="middle" font-size="13" font-weight="bold" '
        f'fill="#ffffff">{number}</text>'
    )


def _legend() -> Iterator[str]:
    y = _HEIGHT + 44
    yield _badge(32, y - 4, "1")
    yield (
        f'<text x="52" y="{y}" font-size="13" fill="{_INK}">the way of one observation, from the bytes on a '
        "wire to the certificate</text>"
    )
    yield (
        f'<line x1="560" y1="{y - 4}" x2="592" y2="{y - 4}" stroke="{_PALE}" stroke-width="1.4" '
        'marker-end="url(#tip)"/>'
        f'<text x="602" y="{y}" font-size="13" fill="{_INK}">imports; what follows from other arrows is '
        "left out</text>"
    )


def main() -> None:
    """Write docs/architecture.svg."""
    FIGURE.write_text(figure(), encoding="utf-8")


if __name__ == "__main__":
    main()

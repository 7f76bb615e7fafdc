"""What targets look like on paper: filled outlines in mm about their middle, x right, y down."""

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Flags
from photocal.base.errors import ConfigurationError
from photocal.findings.document import typeset
from photocal.measurement.markers import DICTIONARIES, Board, charuco_board, dictionary
from photocal.measurement.target_centre import BAR, HOLE

Cells = Flags
Place = tuple[float, float]

# Uncoded targets.
PLAIN = ("disc", "ring", "cross", "hourglass")
PAPERS_MM = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
# What printers leave white, and the strip at the foot with the bar and the words.
EDGE_MM, FOOT_MM = 6.0, 22.0
# The sheets do not depend on the day.
_DATE = dt.date(2000, 1, 1)


@dataclass(frozen=True)
class Disc:
    """A filled circle about the middle."""

    diameter: float
    black: bool = True


# Or the corners of a black polygon.
Shape = Disc | tuple[Place, ...]


@dataclass(frozen=True)
class Sheet:
    """A target on a page.

    shapes: one drawn over the other.
    size_mm: width and height of the target without its white margin.
    margin_mm: white space that it needs around it.
    """

    title: str
    shapes: tuple[Shape, ...]
    size_mm: tuple[float, float]
    margin_mm: float


def plain_target(kind: str, size_mm: float) -> Sheet:
    """Draw an uncoded target: disc, ring, cross or hourglass; raises ConfigurationError."""
    half, bar = size_mm / 2, BAR * size_mm / 2
    drawn: dict[str, tuple[Shape, ...]] = {
        "disc": (Disc(size_mm),),
        "ring": (Disc(size_mm), Disc(HOLE * size_mm, black=False)),
        "cross": (_rectangle(-half, -bar, half, bar), _rectangle(-bar, -half, bar, half)),
        "hourglass": (
            ((0, 0), (-half, -half), (half, -half)),
            ((0, 0), (half, half), (-half, half)),
        ),
    }
    if kind not in drawn:
        raise ConfigurationError(
            f"target {kind!r} is not known",
            f"use {', '.join((*PLAIN, 'chessboard', 'charuco'))}, or {', '.join(DICTIONARIES)}",
        )
    # White space around a target, as a part of its size.
    margin = 0.15
    return Sheet(f"{kind} {size_mm:g} mm", drawn[kind], (size_mm, size_mm), margin * size_mm)


def coded_target(dictionary_name: str, number: int, size_mm: float) -> Sheet:
    """Draw an ArUco or AprilTag marker.

    raises ConfigurationError: for an unknown dictionary or a number that it does not have.
    """
    import cv2

    codes = dictionary(dictionary_name)
    count, side = len(codes.bytesList), int(codes.markerSize) + 2
    if not 0 <= number < count:
        raise ConfigurationError(
            f"{dictionary_name} has no number {number}", f"its numbers are 0 to {count - 1}"
        )
    cells = np.asarray(cv2.aruco.generateImageMarker(codes, number, side)) == 0
    cell = size_mm / side
    title = f"{dictionary_name} number {number}, black square {size_mm:g} mm"
    return Sheet(title, _cells(cells, cell), (size_mm, size_mm), 2 * cell)


def board_target(board: Board) -> Sheet:
    """Draw a chessboard or ChArUco board."""
    square = 1000 * board.square_m
    size = (board.columns * square, board.rows * square)
    title = f"{board.kind} {board.columns} x {board.rows}, squares of {square:g} mm"
    if board.kind == "chessboard":
        row, column = np.mgrid[0 : board.rows, 0 : board.columns]
        return Sheet(title, _cells((row + column) % 2 == 0, square), size, square)
    codes = dictionary(board.dictionary)
    side = int(codes.markerSize) + 2
    # Marker cells, three quarters of a square, and the space around them as multiples of one step.
    step = 8 * side
    drawn = charuco_board(board).generateImage((board.columns * step, board.rows * step), None, 0, 1)
    cells = np.asarray(drawn) < 128
    return Sheet(f"{title}, {board.dictionary}", _cells(cells, square / step), size, square / 2)


def _rectangle(left: float, top: float, right: float, bottom: float) -> tuple[Place, ...]:
    return (left, top), (right, top), (right, bottom), (left, bottom)


def _cells(black: Cells, cell: float) -> tuple[Shape, ...]:
    """Black cells as runs along rows and along columns: between touching rectangles hairlines would show."""
    rows, columns = black.shape
    x, y = -columns * cell / 2, -rows * cell / 2
    across = [
        _rectangle(x + a * cell, y + r * cell, x + b * cell, y + (r + 1) * cell)
        for r in range(rows)
        for a, b in _runs(black[r])
    ]
    down = [
        _rectangle(x + c * cell, y + a * cell, x + (c + 1) * cell, y + b * cell)
        for c in range(columns)
        for a, b in _runs(black[:, c])
    ]
    return (*across, *down)


def _runs(line: Cells) -> Sequence[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.r_[False, line, False].astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def sheets_pdf(sheets: Sequence[Sheet], paper: str) -> bytes:
    """Set target sheets, one on a page.

    raises ConfigurationError: when a target does not fit, or the paper is not known.
    raises OutputError.
    """
    if paper.lower() not in PAPERS_MM:
        raise ConfigurationError(f"paper {paper!r} is not known", f"use {', '.join(PAPERS_MM)}")
    source = "\n#pagebreak()\n".join(_page(sheet, paper.lower()) for sheet in sheets)
    head = '#set text(font: "Libertinus Serif", size: 9pt)\n#set page(margin: 0mm)\n'
    return typeset((head + source).encode(), _DATE)


def _page(sheet: Sheet, paper: str) -> str:
    width, height = _turned(PAPERS_MM[paper], sheet)
    _require_room(sheet, paper)
    middle = (width / 2, (height - FOOT_MM) / 2)
    foot = height - FOOT_MM
    parts = [f"#set page(width: {width}mm, height: {height}mm)", *(_drawn(s, middle) for s in sheet.shapes)]
    # The bar that tells whether the print has its scale.
    bar_mm = 100.0
    for k in range(int(bar_mm // 10) + 1):
        long = k % 5 == 0
        parts.append(_line((EDGE_MM + 10 * k, foot + 6 - (4 if long else 2)), (EDGE_MM + 10 * k, foot + 6)))
    parts.append(_line((EDGE_MM, foot + 6), (EDGE_MM + bar_mm, foot + 6)))
    parts.append(_words(foot + 7.5, f"{bar_mm:g} mm: print at 100 % and measure this bar"))
    parts.append(_words(foot + 12, f"photocal: {sheet.title}"))
    return "\n".join(parts)


def _turned(size: tuple[float, float], sheet: Sheet) -> tuple[float, float]:
    return (size[1], size[0]) if sheet.size_mm[0] > sheet.size_mm[1] else size


def _require_room(sheet: Sheet, paper: str) -> None:
    needed = [side + 2 * sheet.margin_mm for side in sheet.size_mm]
    fitting = [
        name
        for name, size in PAPERS_MM.items()
        for width, height in [_turned(size, sheet)]
        if needed[0] <= width - 2 * EDGE_MM and needed[1] <= height - FOOT_MM - EDGE_MM
    ]
    if paper not in fitting:
        remedy = f"use --paper {fitting[0]}" if fitting else "make it smaller, or have it printed from parts"
        raise ConfigurationError(
            f"the target needs {needed[0]:g} x {needed[1]:g} mm, more than {paper} has", remedy
        )


def _drawn(shape: Shape, middle: tuple[float, float]) -> str:
    x, y = middle
    if isinstance(shape, Disc):
        r, fill = shape.diameter / 2, "black" if shape.black else "white"
        return f"#place(dx: {x - r:.4f}mm, dy: {y - r:.4f}mm, circle(radius: {r:.4f}mm, fill: {fill}))"
    corners = ", ".join(f"({x + a:.4f}mm, {y + b:.4f}mm)" for a, b in shape)
    return f"#place(polygon(fill: black, {corners}))"


def _line(start: tuple[float, float], end: tuple[float, float]) -> str:
    ends = ", ".join(f"{name}: ({x:.3f}mm, {y:.3f}mm)" for name, (x, y) in (("start", start), ("end", end)))
    return f"#place(line({ends}, stroke: 0.2mm))"


def _words(top: float, text: str) -> str:
    plain = text.replace("\\", "").replace('"', "")
    return f'#place(dx: {EDGE_MM}mm, dy: {top:.2f}mm, text("{plain}"))'

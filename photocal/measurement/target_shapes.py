"""What targets look like on paper: filled outlines in mm about their middle, x right, y down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Flags
from drivers.errors import ConfigurationError
from photocal.measurement.boards import Board, charuco_board
from photocal.measurement.markers import DICTIONARIES, dictionary

Cells = Flags
Place = tuple[float, float]

# Uncoded targets; the bars of a cross are a fifth as wide as long, a ring's hole is half as wide.
PLAIN = ("disc", "ring", "cross", "hourglass")
BAR, HOLE = 1 / 5, 1 / 2
# White space around a target, as a part of its size.
MARGIN = 0.15


@dataclass(frozen=True)
class Disc:
    """A filled circle about the middle."""

    diameter: float
    black: bool = True


@dataclass(frozen=True)
class Outline:
    """A filled polygon."""

    corners: tuple[Place, ...]
    black: bool = True


Shape = Disc | Outline


@dataclass(frozen=True)
class Sheet:
    """A target on a page.

    title: what it is, for the reader.
    shapes: one drawn over the other.
    size_mm: width and height of the target without its white margin.
    margin_mm: white space that it needs around it.
    """

    title: str
    shapes: tuple[Shape, ...]
    size_mm: tuple[float, float]
    margin_mm: float


def plain_target(kind: str, size_mm: float) -> Sheet:
    """Draw an uncoded target: disc, ring, cross or hourglass.

    raises ConfigurationError.
    """
    half, bar = size_mm / 2, BAR * size_mm / 2
    drawn: dict[str, tuple[Shape, ...]] = {
        "disc": (Disc(size_mm),),
        "ring": (Disc(size_mm), Disc(HOLE * size_mm, black=False)),
        "cross": (_rectangle(-half, -bar, half, bar), _rectangle(-bar, -half, bar, half)),
        "hourglass": (
            Outline(((0, 0), (-half, -half), (half, -half))),
            Outline(((0, 0), (half, half), (-half, half))),
        ),
    }
    if kind not in drawn:
        raise ConfigurationError(
            f"target {kind!r} is not known",
            remedy=f"use {', '.join((*PLAIN, 'chessboard', 'charuco'))}, or {', '.join(DICTIONARIES)}",
        )
    return Sheet(f"{kind} {size_mm:g} mm", drawn[kind], (size_mm, size_mm), MARGIN * size_mm)


def coded_target(dictionary_name: str, number: int, size_mm: float) -> Sheet:
    """Draw an ArUco or AprilTag marker.

    raises ConfigurationError: for an unknown dictionary or a number that it does not have.
    """
    import cv2

    codes = dictionary(dictionary_name)
    count, side = len(codes.bytesList), int(codes.markerSize) + 2
    if not 0 <= number < count:
        raise ConfigurationError(
            f"{dictionary_name} has no number {number}", remedy=f"its numbers are 0 to {count - 1}"
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
    # Marker cells and the space around them as multiples of one step.
    step = 8 * side
    marker = round(board.marker * step / side) * side
    drawn = charuco_board(board).generateImage((board.columns * step, board.rows * step), None, 0, 1)
    cells = np.asarray(drawn) < 128
    if marker / step != board.marker:
        raise ConfigurationError(
            f"markers of {board.marker} squares cannot be drawn", remedy="use 0.75 or 0.5"
        )
    return Sheet(f"{title}, {board.dictionary}", _cells(cells, square / step), size, square / 2)


def _rectangle(left: float, top: float, right: float, bottom: float) -> Outline:
    return Outline(((left, top), (right, top), (right, bottom), (left, bottom)))


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

"""The map in a terminal: Braille dots, two by four in each cell, with a scale bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from rich.text import Text

from acquire.monitor.chart import Layer
from drivers.arrays import Floats, Integers

# Dots of a Braille cell by column and row (Unicode 15, chapter 21.1).
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
_BLANK = 0x2800
_SIGNS = {"missed": ("✕", "bold red"), "station": ("▲", "green")}
_TRACK, _PICTURE, _HERE = "blue", "bold", "bold blue"
# Ellipsoid of WGS 84.
_A, _E2 = 6378137.0, 0.00669437999014
_LEAST_EXTENT_M = 20.0


def braille_map(layers: Sequence[Layer], width: int, height: int) -> Text:
    """Draw layers, north up."""
    rows = height - 1
    drawn = [layer for layer in layers if len(layer.points)]
    if not drawn or width < 8 or rows < 2:
        return Text("\n" * (rows // 2) + "no position yet".center(width), style="dim")
    shown = [layer for layer in drawn if layer.kind != "station"] or drawn
    places = metres(np.concatenate([layer.points for layer in shown]), drawn[0].points[0])
    low, high = places.min(axis=0), places.max(axis=0)
    extent = np.maximum(high - low, _LEAST_EXTENT_M)
    dots_per_m = min((2 * width - 3) / extent[0], (4 * rows - 3) / extent[1])
    middle = (low + high) / 2

    def dots(layer: Layer) -> Floats:
        away = (metres(layer.points, drawn[0].points[0]) - middle) * dots_per_m
        return np.column_stack([width - 0.5 + away[:, 0], 2 * rows - 0.5 - away[:, 1]])

    cells = np.full((rows, width), _BLANK, np.int64)
    styles: dict[tuple[int, int], str] = {}
    signs: dict[tuple[int, int], tuple[str, str]] = {}
    for layer in drawn:
        at = dots(layer)
        if layer.kind == "track":
            _line(cells, styles, at)
            signs |= dict.fromkeys(_cells(at[-1:], cells.shape), ("◆", _HERE))
        elif layer.kind == "picture":
            styles |= dict.fromkeys(_cells(at, cells.shape), _PICTURE)
            _set(cells, at)
    for layer in drawn:
        if layer.kind in _SIGNS:
            signs |= dict.fromkeys(_cells(dots(layer), cells.shape), _SIGNS[layer.kind])
    text = Text()
    for row in range(rows):
        for column in range(width):
            key = (row, column)
            sign, style = signs.get(key, (chr(cells[row, column]), styles.get(key, "")))
            text.append(" " if sign == chr(_BLANK) else sign, style)
        text.append("\n")
    return text.append(_scale_bar(width, dots_per_m))


def metres(points: Floats, origin: Floats) -> Floats:
    """Return metres east and north of an origin, with the radii of curvature there."""
    sine = math.sin(math.radians(origin[0]))
    w = math.sqrt(1 - _E2 * sine**2)
    meridian = _A * (1 - _E2) / w**3
    parallel = _A / w * math.cos(math.radians(origin[0]))
    north = np.radians(points[:, 0] - origin[0]) * meridian
    east = np.radians((points[:, 1] - origin[1] + 540) % 360 - 180) * parallel
    return np.column_stack([east, north])


def round_step(value: float) -> float:
    """Return the greatest of 1, 2, 5, 10, 20... that is not above a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (5, 2, 1) if factor * power <= value * (1 + 1e-9))


def _line(cells: Integers, styles: dict[tuple[int, int], str], at: Floats) -> None:
    for start, end in pairwise(at):
        steps = max(int(np.ceil(np.abs(end - start).max())), 1)
        between = start + (end - start) * np.linspace(0, 1, steps + 1)[:, None]
        _set(cells, between)
        styles |= dict.fromkeys(_cells(between, cells.shape), _TRACK)
    _set(cells, at)


def _set(cells: Integers, at: Floats) -> None:
    for x, y in np.rint(at).astype(int).tolist():
        if 0 <= y // 4 < cells.shape[0] and 0 <= x // 2 < cells.shape[1]:
            cells[y // 4, x // 2] |= _DOTS[x % 2][y % 4]


def _cells(at: Floats, shape: tuple[int, ...]) -> list[tuple[int, int]]:
    places = [(y // 4, x // 2) for x, y in np.rint(at).astype(int).tolist()]
    return [(row, column) for row, column in places if 0 <= row < shape[0] and 0 <= column < shape[1]]


def _scale_bar(width: int, dots_per_m: float) -> Text:
    step = round_step(width / 3 * 2 / dots_per_m)
    cells = max(round(step * dots_per_m / 2), 2)
    label = f"{step / 1000:g} km" if step >= 1000 else f"{step:g} m"
    bar = f"├{'─' * (cells - 2)}┤ {label}"
    return Text(bar + "N ↑".rjust(max(width - len(bar), 4)), style="bold")

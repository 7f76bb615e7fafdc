"""Thinning: strong tracks that are spread evenly over the images, or keep apart in them."""

from typing import NamedTuple

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.compiled import compiled, inlined
from photocal.measurement.tracks import Tracks

# Cells in this part of the least distance have room for one place each.
_PART = 1.5
# Cells to each side that a place within the least distance may lie in.
_REACH = 2


class _Cells(NamedTuple):
    """Cells of all images that have rays.

    columns: of the cells of an image; a cell's number divided by them is that of its line.
    cells (n,): their numbers, sorted; begins (lines + 1,): where each line begins among them.
    held (n,): the ray that is kept in each, or -1.
    """

    columns: int
    cells: Integers
    begins: Integers
    held: Integers


def thin(tracks: Tracks, sizes: Floats, cells: int, in_a_cell: int) -> Tracks:
    """Keep strong points, evenly spread over each image.

    Tracks with many rays come first; a track stays when it is among the first few in a cell of any of its
    images.
    """
    side = sizes.max(axis=1)[tracks.image] / cells
    order, starts = _strongest_first(tracks)
    column, row = (np.maximum(tracks.pixels.T, 0.0) / side).astype(np.int64)
    cell = (tracks.image * (cells + 1) + column) * (cells + 1) + row
    keep, filled = np.zeros(tracks.count, dtype=np.bool_), np.zeros(int(cell.max(initial=-1)) + 1, np.int64)
    _fill(order, starts, cell, in_a_cell, filled, keep)
    return tracks.some(keep[tracks.track])


def spaced(tracks: Tracks, least_px: float) -> Tracks:
    """Keep strong points of which no two are neighbours in an image.

    Patches that overlap share pixels, and with them the errors of their places: neighbours say less than
    their number.
    """
    order, starts = _strongest_first(tracks)
    column, row = np.floor(tracks.pixels.T * (_PART / least_px)).astype(np.int64)
    # A margin around each image: neighbours of its cells are cells of no other.
    column, row = (of - of.min(initial=0) + _REACH for of in (column, row))
    columns, rows = (int(of.max(initial=0)) + _REACH + 1 for of in (column, row))
    line = tracks.image * rows + row
    cell = line * columns + column
    # Only cells with rays: all of them are hundreds of megabytes of large pictures.
    cells = np.sort(cell)
    cells = cells[np.diff(cells, prepend=-1) > 0]
    begins = np.searchsorted(cells, np.arange(int(line.max(initial=-1)) + _REACH + 2) * columns)
    grid = _Cells(columns, cells, begins, np.full(len(cells), -1, dtype=np.int64))
    keep = np.zeros(tracks.count, dtype=np.bool_)
    _keep_apart(order, starts, np.ascontiguousarray(tracks.pixels), cell, least_px, grid, keep)
    return tracks.some(keep[tracks.track])


def _strongest_first(tracks: Tracks) -> tuple[Integers, Integers]:
    """Order of the tracks, many rays and small scale first; where the rays of each begin."""
    starts = np.r_[np.flatnonzero(np.r_[True, np.diff(tracks.track) > 0]), len(tracks.track)]
    finest = np.minimum.reduceat(tracks.scale, starts[:-1]) if tracks.count else np.zeros(0)
    return np.lexsort((finest, -tracks.rays)), starts


@compiled
def _fill(
    order: Integers, starts: Integers, cell: Integers, most: int, filled: Integers, keep: Flags
) -> None:
    """Keep tracks while a cell of theirs has room; `filled` counts those of each cell."""
    for track in order:
        room = False
        for ray in range(starts[track], starts[track + 1]):
            room |= filled[cell[ray]] < most
        if room:
            keep[track] = True
            for ray in range(starts[track], starts[track + 1]):
                filled[cell[ray]] += 1


@compiled
def _keep_apart(
    order: Integers,
    starts: Integers,
    pixels: Floats,
    cell: Integers,
    least_px: float,
    grid: _Cells,
    keep: Flags,
) -> None:
    """Keep tracks none of whose rays lies near one of a track that is kept; `cell` (rays,)."""
    for track in order:
        near = False
        for ray in range(starts[track], starts[track + 1]):
            near = near or _near(ray, pixels, cell[ray], least_px, grid)
        if not near:
            keep[track] = True
            for ray in range(starts[track], starts[track + 1]):
                grid.held[_place(grid, cell[ray] // grid.columns, cell[ray])] = ray


@inlined
def _near(ray: int, pixels: Floats, cell: int, least_px: float, grid: _Cells) -> bool:
    """Whether a ray that is kept lies within the least distance of a ray."""
    for down in range(-_REACH, _REACH + 1):
        first, line = cell + down * grid.columns - _REACH, cell // grid.columns + down
        for k in range(_place(grid, line, first), grid.begins[line + 1]):
            if grid.cells[k] > first + 2 * _REACH:
                break
            other = grid.held[k]
            if other >= 0:
                x, y = pixels[ray, 0] - pixels[other, 0], pixels[ray, 1] - pixels[other, 1]
                if x * x + y * y <= least_px * least_px:
                    return True
    return False


@inlined
def _place(grid: _Cells, line: int, cell: int) -> int:
    """Where a cell stands among those of its line, or would stand."""
    low, high = int(grid.begins[line]), int(grid.begins[line + 1])
    while low < high:
        middle = (low + high) // 2
        if grid.cells[middle] < cell:
            low = middle + 1
        else:
            high = middle
    return low

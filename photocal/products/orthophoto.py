"""Orthophotos: each cell has its grey value from the image with the best nadir; what images cover."""

from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.geometry.frames import LocalFrame
from photocal.geometry.oriented_images import OrientedImages
from photocal.products.kernels import GreyRange, resample
from photocal.products.oriented import best_places, border, lens_tables
from photocal.products.terrain import Bounds, Grid, TerrainSource, ground_points

TILE = 512
# What a pixel needs of memory while its tile is worked on is some 200 bytes; images are the larger part.
IMAGE_MEMORY = 800_000_000


def candidates(shots: OrientedImages, borders: Floats, ground: Floats) -> Integers:
    """Images whose footprint, at the lowest or the highest ground, touches the ground."""
    finite = ground[np.isfinite(ground[:, 2])]
    if not len(finite):
        return np.zeros(0, dtype=np.int64)
    low, high = finite.min(axis=0), finite.max(axis=0)
    touches = np.ones(len(shots.names), dtype=np.bool_)
    for axis in range(2):
        reach = []
        for level in (low[2], high[2]):
            with np.errstate(divide="ignore", invalid="ignore"):
                steps = (level - shots.station[:, None, 2]) / borders[..., 2]
                steps[~((borders[..., 2] < 0) & (steps > 0))] = np.nan
                reach.append(shots.station[:, None, axis] + steps * borders[..., axis])
        both = np.concatenate(reach, axis=1)
        seen = np.isfinite(both).all(axis=1)
        # A border that looks to the horizon, or polynomials without inverse, say nothing of the reach.
        both[~seen] = 0
        margin = 0.05 * np.ptp(both, axis=1) + 1e-6
        apart = (both.min(axis=1) - margin > high[axis]) | (both.max(axis=1) + margin < low[axis])
        touches &= ~(apart & seen)
    return np.flatnonzero(touches).astype(np.int64)


def footprints(shots: OrientedImages, frame: LocalFrame, height: float) -> Bounds:
    """Rectangle around what the images show at one height, in the terrain's coordinates."""
    given = frame.to_given(shots.station)
    nadir = frame.to_local(np.column_stack([given[:, :2], np.full(len(given), height)]))
    points = shots.on_level(border(16), nadir[:, 2])
    shown = points[np.isfinite(points).all(axis=(1, 2))]
    corners = [given[:, :2]]
    if len(shown):
        corners.append(frame.to_given(shown.reshape(-1, 3))[:, :2])
    reach = np.vstack(corners)
    west, south = np.nanmin(reach, axis=0)
    east, north = np.nanmax(reach, axis=0)
    return float(west), float(south), float(east), float(north)


# A finished piece: its first column and row, the pixels (bands, rows, columns), and the image of each cell,
# -1 for none.
Tile = tuple[int, int, NDArray[Any], Integers]


class ImageStore:
    """Decoded images, kept while there is room.

    read: from the number of an image to its pixels, shape (rows, columns, bands).
    room: bytes to keep; a single image may be larger.
    """

    def __init__(self, read: Callable[[int], NDArray[Any]], room: int = IMAGE_MEMORY) -> None:
        self._read, self._room = read, room
        self._kept: OrderedDict[int, NDArray[Any]] = OrderedDict()
        self._lock = Lock()

    def get(self, number: int) -> NDArray[Any]:
        """Give an image; one that is not kept is decoded."""
        # One reader at a time: two threads must not hold the same image twice.
        with self._lock:
            if number in self._kept:
                self._kept.move_to_end(number)
                return self._kept[number]
            # Room is made before: the next image will be as large as the last one.
            expected = next(reversed(self._kept.values())).nbytes if self._kept else 0
            while self._kept and sum(kept.nbytes for kept in self._kept.values()) + expected > self._room:
                self._kept.popitem(last=False)
            pixels = self._read(number)
            self._kept[number] = pixels
            return pixels


@dataclass(frozen=True)
class Recipe:
    """What an orthophoto is made of.

    frame: from the coordinates of the terrain to those of the shots.
    method: `NEAREST`, `BILINEAR` or `CUBIC` of the kernels.
    nodata: value of cells that no image shows.
    """

    shots: OrientedImages
    frame: LocalFrame
    terrain: TerrainSource
    grid: Grid
    method: int
    bands: int
    dtype: str
    nodata: float

    def require_nodata(self) -> None:
        """Refuse a value for nothing that the type of the pixels cannot hold, or at neither end of it."""
        if self.dtype.startswith("float"):
            return
        limits = np.iinfo(np.dtype(self.dtype))
        if self.nodata not in (limits.min, limits.max):
            raise ConfigurationError(
                f"--nodata {self.nodata:g} does not fit pixels of {self.dtype}",
                f"use {limits.min} or {limits.max}",
            )


def orthophoto(recipe: Recipe, images: ImageStore, workers: int) -> Iterator[Tile]:
    """Make an orthophoto tile by tile."""
    lenses = lens_tables(recipe.shots.cameras)
    borders = recipe.shots.directions(border(16))

    def make(window: tuple[int, int, int, int]) -> Tile:
        """Colour one tile, from the images whose footprints reach it."""
        column, row, columns, rows = window
        x, y = recipe.grid.centers(*window)
        half = recipe.grid.cell / 2
        piece = recipe.terrain((x[0] - half, y[-1] - half, x[-1] + half, y[0] + half))
        ground = ground_points(x, y, piece, recipe.frame)
        place, chosen = best_places(ground, lenses, recipe.shots, candidates(recipe.shots, borders, ground))
        pixels = np.full((recipe.bands, len(ground)), recipe.nodata, dtype=recipe.dtype)
        for number in np.unique(chosen[chosen >= 0]):
            image = images.get(int(number))
            resample(image, int(number), recipe.method, place, chosen, _range(recipe), pixels)
        return column, row, pixels.reshape(recipe.bands, rows, columns), chosen.reshape(rows, columns)

    with ThreadPoolExecutor(max_workers=workers) as pool:
        waiting: deque[Future[Tile]] = deque()
        try:
            for window in _windows(recipe):
                waiting.append(pool.submit(make, window))
                # Finished tiles wait to be written: no more of them than there are threads.
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _windows(recipe: Recipe) -> list[tuple[int, int, int, int]]:
    """Tiles of the grid; those nearest to the same image follow each other, so that it stays decoded."""
    grid = recipe.grid
    tiles = [
        (column, row, min(TILE, grid.columns - column), min(TILE, grid.rows - row))
        for row in range(0, grid.rows, TILE)
        for column in range(0, grid.columns, TILE)
    ]
    height = float(recipe.frame.to_given(recipe.shots.station)[:, 2].mean())
    centers = np.array(
        [
            [grid.west + (c + w / 2) * grid.cell, grid.north - (r + h / 2) * grid.cell, height]
            for c, r, w, h in tiles
        ]
    )
    places = recipe.frame.to_local(centers)[:, :2]
    station = recipe.shots.station[:, :2]
    nearest = [int(((station - place) ** 2).sum(axis=1).argmin()) for place in places]
    return [tiles[n] for n in sorted(range(len(tiles)), key=lambda n: (nearest[n], n))]


def _range(recipe: Recipe) -> GreyRange:
    """Range of the values to write; whole numbers keep clear of the one that means nothing."""
    if recipe.dtype.startswith("float"):
        return -np.inf, np.inf, False
    limits = np.iinfo(np.dtype(recipe.dtype))
    lowest, highest = float(limits.min), float(limits.max)
    if recipe.nodata == lowest:
        lowest += 1
    elif recipe.nodata == highest:
        highest -= 1
    return lowest, highest, True

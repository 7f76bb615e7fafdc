"""Terrain: a grid on the ground, heights on it, with the kind of the heights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Floats, Integers
from photocal.geometry.frames import Frame


@dataclass(frozen=True)
class Grid:
    """Cells of an orthophoto, rows from north to south.

    west, north: corner of the first cell, m.
    cell: size of a cell, m.
    """

    west: float
    north: float
    cell: float
    columns: int
    rows: int

    @property
    def transform(self) -> Transform:
        """From column and row to X and Y."""
        return (self.cell, 0.0, self.west, 0.0, -self.cell, self.north)

    def centers(self, column: int, row: int, columns: int, rows: int) -> tuple[Floats, Floats]:
        """Coordinates of the cell centres of a window: X, shape (columns,), and Y, shape (rows,)."""
        x = self.west + (column + np.arange(columns) + 0.5) * self.cell
        y = self.north - (row + np.arange(rows) + 0.5) * self.cell
        return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)


def ground_points(x: Floats, y: Floats, terrain: Terrain, frame: Frame) -> Floats:
    """Ground points of a window in local coordinates.

    x (columns,).
    y (rows,): of the cell centres, m.
    frame: from the terrain's coordinates to local ones.
    returns (rows * columns, 3): m; NaN without terrain.

    Notes
    -----
    The frame is evaluated on a lattice over the window at its lowest and highest height and interpolated:
    over a window of a few hundred metres the curvature of the earth between two nodes is micrometres.
    """
    xs, ys = np.broadcast_to(x, (len(y), len(x))), np.broadcast_to(y[:, None], (len(y), len(x)))
    z = terrain.at(xs, ys)
    if not np.isfinite(z).any():
        return np.full((z.size, 3), np.nan)
    low, high = float(np.nanmin(z)), float(np.nanmax(z)) + 1.0
    nodes = 9
    gx, gy = np.linspace(x[0], x[-1], nodes), np.linspace(y[0], y[-1], nodes)
    lattice = np.stack(np.meshgrid([low, high], gy, gx, indexing="ij"), axis=-1)[..., ::-1]
    local = frame.to_local(lattice.reshape(-1, 3)).reshape(2, nodes, nodes, 3)
    j, u = _between(len(x), nodes)
    i, v = _between(len(y), nodes)
    along = local[:, :, j] * (1 - u)[:, None] + local[:, :, j + 1] * u[:, None]
    flat = along[:, i] * (1 - v)[:, None, None] + along[:, i + 1] * v[:, None, None]
    share = ((z - low) / (high - low))[..., None]
    return np.ascontiguousarray((flat[0] * (1 - share) + flat[1] * share).reshape(-1, 3))


def _between(count: int, nodes: int) -> tuple[Integers, Floats]:
    """Node before each of evenly spaced places, and the share of the way to the next one."""
    place = np.linspace(0, nodes - 1, count) if count > 1 else np.zeros(1)
    node = np.minimum(place.astype(np.int64), nodes - 2)
    return node, place - node


Heights = NDArray[np.floating]

# West, south, east, north.
Bounds = tuple[float, float, float, float]
# a, b, c, d, e, f: X = a column + b row + c, Y = d column + e row + f, from the corner of the first cell.
Transform = tuple[float, float, float, float, float, float]

HEIGHT_KINDS = ("ellipsoidal", "orthometric", "local")


@dataclass(frozen=True)
class Terrain:
    """Heights of a piece of terrain.

    heights (rows, columns): at the centres of the cells, m; NaN where there are none.
    transform: from column and row to X and Y.
    crs: reference system as WKT; empty for a local frame.
    height_kind: "ellipsoidal", "orthometric", "local", or empty when it is not known.
    """

    heights: Heights
    transform: Transform
    crs: str
    height_kind: str

    def at(self, x: Floats, y: Floats) -> Floats:
        """Interpolate heights bilinearly.

        x, y: m, of one shape.
        returns: m; NaN outside the outermost cell centres and beside cells without height.
        """
        a, b, c, d, e, f = self.transform
        determinant = a * e - b * d
        column = (e * (x - c) - b * (y - f)) / determinant - 0.5
        row = (a * (y - f) - d * (x - c)) / determinant - 0.5
        rows, columns = self.heights.shape
        # Rounding must not cut off the outermost centres themselves.
        slack = 1e-6
        inside = (column >= -slack) & (column <= columns - 1 + slack)
        inside &= (row >= -slack) & (row <= rows - 1 + slack)
        j = np.clip(np.nan_to_num(column), 0, max(columns - 1, 0))
        i = np.clip(np.nan_to_num(row), 0, max(rows - 1, 0))
        j0 = np.minimum(j.astype(np.int64), max(columns - 2, 0))
        i0 = np.minimum(i.astype(np.int64), max(rows - 2, 0))
        j1, i1 = np.minimum(j0 + 1, columns - 1), np.minimum(i0 + 1, rows - 1)
        u, v = j - j0, i - i0
        z = self.heights
        total = np.zeros(np.shape(x))
        # A corner without weight may be without height.
        for weight, rows_at, columns_at in (
            ((1 - u) * (1 - v), i0, j0),
            (u * (1 - v), i0, j1),
            ((1 - u) * v, i1, j0),
            (u * v, i1, j1),
        ):
            total += np.where(weight > 0, weight * z[rows_at, columns_at], 0.0)
        return np.where(inside, total, np.nan)


# Gives the terrain of a rectangle, with a margin of at least one cell where there is one.
TerrainSource = Callable[[Bounds], Terrain]


def bounds_of(transform: Transform, columns: int, rows: int) -> Bounds:
    """Rectangle around a grid, m."""
    a, b, c, d, e, f = transform
    x = [c + a * i + b * j for i in (0, columns) for j in (0, rows)]
    y = [f + d * i + e * j for i in (0, columns) for j in (0, rows)]
    return min(x), min(y), max(x), max(y)

"""Cells of a product on the ground, and the ground points in their middle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats, Integers
from photocal.geometry.frames import Frame
from photocal.products.terrain import Terrain, Transform


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

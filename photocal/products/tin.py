"""Terrain from scattered points or contours: a triangulated irregular network, put on a grid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import Floats, Integers
from drivers.errors import ConfigurationError, IllPosedError
from photocal.block.table import read_table
from photocal.products.terrain import Terrain

# Larger grids would not fit into memory beside the triangles.
_MOST_CELLS = 100_000_000
_STRIP = 64


@dataclass(frozen=True)
class TerrainPoints:
    """Points on the terrain.

    xyz (n, 3): m.
    line (n,): contour of each point, in the order along it; -1 for a point of its own.
    """

    xyz: Floats
    line: Integers


def read_terrain_points(path: Path) -> TerrainPoints:
    """Read points, vertices of contours, or the points of an adjustment.

    path: CSV with X, Y, Z (m) and optional `line`; `points.csv` of a block or a run is one too. Points
        without height, and check points, are left out.
    raises InputNotFoundError, InputMalformedError: when it is no such table.
    """
    table = read_table(path, ("X", "Y", "Z"), ("line", "point", "role", "sX", "sY", "sZ", "rays"))
    xyz = np.column_stack([table.numbers(name, empty=np.nan) for name in ("X", "Y", "Z")])
    line = np.full(len(xyz), -1, dtype=np.int64)
    if table.has("line"):
        line, _ = table.names("line")
    keep = np.isfinite(xyz).all(axis=1)
    if table.has("role"):
        # Check points judge the product; they must not make it.
        index, roles = table.names("role")
        keep &= np.array([role != "check" for role in roles])[index]
    return TerrainPoints(xyz[keep], line[keep])


def grid_of_points(
    points: TerrainPoints, cell: float, crs: str, height_kind: str
) -> tuple[Terrain, int, int]:
    """Triangulate points (Delaunay) and interpolate linearly within the triangles.

    cell: size of the cells, m.
    crs: WKT of the reference system, empty for a local frame.
    returns terrain: cells outside the convex hull of the points are NaN.
    returns triangles, flat: of all triangles, and of those whose corners lie on one contour: there the ground
        is cut off level.
    raises ConfigurationError: for a cell that is not positive, or a grid that is too large.
    raises IllPosedError: for fewer than three points, or points on a line.
    """
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import Delaunay, QhullError

    if not (np.isfinite(cell) and cell > 0):
        raise ConfigurationError(f"the cell is {cell:g} m", remedy="give a positive length in metres")
    xyz, line = _unique(*_denser(points, 2 * cell))
    if len(xyz) < 3:
        raise IllPosedError(f"{len(xyz)} points make no terrain", remedy="give at least three")
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    west, south = np.floor(low / cell) * cell
    columns, rows = (np.maximum(np.ceil((high - [west, south]) / cell - 1e-9), 1)).astype(np.int64)
    if columns * rows > _MOST_CELLS:
        raise ConfigurationError(
            f"a cell of {cell:g} m makes {columns} x {rows} cells", remedy="choose larger cells"
        )
    origin = np.array([west, south])
    try:
        network = Delaunay(xyz[:, :2] - origin)
    except QhullError as failure:
        raise IllPosedError(
            "the points make no triangles (they lie on a line)", remedy="spread them over the terrain"
        ) from failure
    interpolate = LinearNDInterpolator(network, xyz[:, 2])
    heights = np.full((int(rows), int(columns)), np.nan)
    x = (np.arange(columns) + 0.5) * cell
    for first in range(0, int(rows), _STRIP):
        last = min(first + _STRIP, int(rows))
        y = (rows - np.arange(first, last) - 0.5) * cell
        heights[first:last] = interpolate(*np.meshgrid(x, y))
    corners = line[network.simplices]
    flat = (corners[:, 0] >= 0) & (corners == corners[:, :1]).all(axis=1)
    north = float(south + rows * cell)
    terrain = Terrain(heights, (cell, 0.0, float(west), 0.0, -cell, north), crs, height_kind)
    return terrain, len(network.simplices), int(flat.sum())


def _denser(points: TerrainPoints, spacing: float) -> tuple[Floats, Integers]:
    """Put further vertices on the contours wherever two are farther apart than `spacing`."""
    xyz, line = points.xyz, points.line
    if len(xyz) < 2 or not (line >= 0).any():
        return xyz, line
    step = xyz[1:] - xyz[:-1]
    same = (line[1:] == line[:-1]) & (line[1:] >= 0)
    parts = np.where(same, np.maximum(np.ceil(np.hypot(step[:, 0], step[:, 1]) / spacing), 1), 1).astype(int)
    # Every vertex, then the further ones on the way to the next.
    start = np.repeat(np.arange(len(step)), parts)
    share = (np.arange(len(start)) - np.repeat(np.cumsum(parts) - parts, parts)) / np.repeat(parts, parts)
    between = xyz[start] + share[:, None] * step[start]
    return np.vstack([between, xyz[-1:]]), np.append(line[start], line[-1])


def _unique(xyz: Floats, line: Integers) -> tuple[Floats, Integers]:
    """Take the mean height of points at one place."""
    places, first, group = np.unique(xyz[:, :2], axis=0, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    height = np.bincount(group, weights=xyz[:, 2]) / np.bincount(group)
    return np.column_stack([places, height]), line[first]

"""Terrain: heights on a grid on the ground, with their kind, also from scattered points or contours."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.text_tables import read_table
from photocal.geometry.frames import LocalFrame

# a, b, c, d, e, f: X = a column + b row + c, Y = d column + e row + f, from the corner of the first cell.
Transform = tuple[float, float, float, float, float, float]
Heights = NDArray[np.floating]

# West, south, east, north.
Bounds = tuple[float, float, float, float]

HEIGHT_KINDS = ("ellipsoidal", "orthometric", "local")


@dataclass(frozen=True)
class Grid:
    """Cells of an orthophoto, rows from north to south.

    west, north: corner of the first cell, m.
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


def ground_points(x: Floats, y: Floats, terrain: "Terrain", frame: LocalFrame) -> Floats:
    """Ground points of a window in local coordinates."""
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


@dataclass(frozen=True)
class Terrain:
    """Heights of a piece of terrain.

    heights (rows, columns): at the centres of the cells, m; NaN where there are none.
    crs: reference system as WKT; empty for a local frame.
    height_kind: "ellipsoidal", "orthometric", "local", or empty when it is not known.
    """

    heights: Heights
    transform: Transform
    crs: str
    height_kind: str

    def at(self, x: Floats, y: Floats) -> Floats:
        """Interpolate heights bilinearly."""
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


def read_terrain_points(path: Path) -> tuple[Floats, Integers]:
    """Read points, vertices of contours, or the points of an adjustment.

    path: CSV with X, Y, Z (m) and optional `line`; `points.csv` of a block or a run is one too. Points
        without height, and check points, are left out.
    returns xyz (n, 3), line (n,): contour of each point, in the order along it; -1 for a point of its own.
    raises InputNotFoundError, InputMalformedError: when it is no such table.
    """
    table = read_table(path, ("X", "Y", "Z"), ("line", "point", "role", "sX", "sY", "sZ", "rays"))
    xyz = table.matrix("XYZ", empty=np.nan)
    line = np.full(len(xyz), -1, dtype=np.int64)
    if table.has("line"):
        line, _ = table.names("line")
    keep = np.isfinite(xyz).all(axis=1)
    if table.has("role"):
        # Check points judge the product; they must not make it.
        index, roles = table.names("role")
        keep &= np.array([role != "check" for role in roles])[index]
    return xyz[keep], line[keep]


def grid_of_points(
    xyz: Floats, line: Integers, cell: float, crs: str, height_kind: str
) -> tuple[Terrain, int, int]:
    """Triangulate points (Delaunay) and interpolate linearly within the triangles.

    xyz, line: as of `read_terrain_points`.
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
        raise ConfigurationError(f"the cell is {cell:g} m", "give a positive length in metres")
    xyz, line = _unique(*_denser(xyz, line, 2 * cell))
    if len(xyz) < 3:
        raise IllPosedError(f"{len(xyz)} points do not define a terrain", "give at least three")
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    west, south = np.floor(low / cell) * cell
    columns, rows = (np.maximum(np.ceil((high - [west, south]) / cell - 1e-9), 1)).astype(np.int64)
    # Larger grids would not fit into memory beside the triangles.
    most_cells = 100_000_000
    if columns * rows > most_cells:
        raise ConfigurationError(
            f"a cell of {cell:g} m makes {columns} x {rows} cells", "choose larger cells"
        )
    origin = np.array([west, south])
    try:
        network = Delaunay(xyz[:, :2] - origin)
    except QhullError as failure:
        raise IllPosedError(
            "the points form no triangles (they lie on a line)", "spread them over the terrain"
        ) from failure
    interpolate = LinearNDInterpolator(network, xyz[:, 2])
    heights = np.full((int(rows), int(columns)), np.nan)
    x = (np.arange(columns) + 0.5) * cell
    # Lines that are made at a time.
    strip = 64
    for first in range(0, int(rows), strip):
        last = min(first + strip, int(rows))
        y = (rows - np.arange(first, last) - 0.5) * cell
        heights[first:last] = interpolate(*np.meshgrid(x, y))
    corners = line[network.simplices]
    flat = (corners[:, 0] >= 0) & (corners == corners[:, :1]).all(axis=1)
    north = float(south + rows * cell)
    terrain = Terrain(heights, (cell, 0.0, float(west), 0.0, -cell, north), crs, height_kind)
    return terrain, len(network.simplices), int(flat.sum())


def _denser(xyz: Floats, line: Integers, spacing: float) -> tuple[Floats, Integers]:
    """Put further vertices on the contours wherever two are farther apart than `spacing`."""
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

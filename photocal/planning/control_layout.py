"""Suggested places for control and check points in an area."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.planning.area import inside, polygon_area
from photocal.planning.flight import best_azimuth

# Control points and check points, east and north in the plane of the flight, m.
Layout = tuple[Floats, Floats]
# Side of the grid of candidate places as a share of the root of the area.
_GRID_SHARE = 1.0 / 60.0


def suggest_layout(corners_m: Floats, control: int, check: int, margin_m: float) -> Layout:
    """Spread control and check points over an area.

    Control goes to the corners first, because a block bends most where it ends, then always to the
    place that is farthest from all control chosen so far, which fills the border and the middle in
    turn. Check points are chosen in the same way, away from the control and from each other: where the
    block is weakest, and never a control point again.

    corners_m (n, 2): corners of the area, m.
    margin_m: distance that the places keep from the border, m, so that they lie on several photos.
    raises ConfigurationError: with too few control points, or when the area has no place for so many.
    """
    if control < 3 or check < 0:
        raise ConfigurationError(
            f"{control} control points do not orient a block", remedy="plan at least 3, better 5 or more"
        )
    candidates = _candidates(corners_m, margin_m)
    if len(candidates) < control + check:
        raise ConfigurationError(
            f"the area has no room for {control + check} points {margin_m:g} m from its border",
            remedy="plan fewer points or a smaller margin",
        )
    corners = _corner_candidates(candidates, corners_m)
    # When there are fewer control points than corners, the ones farthest apart are taken.
    if control < len(corners):
        corners = [corners[row] for row in _farthest(candidates[corners], [0], control)]
    chosen = _farthest(candidates, corners, control + check)
    return candidates[chosen[:control]], candidates[chosen[control:]]


def _candidates(corners: Floats, margin: float) -> Floats:
    step = max(1.0, _GRID_SHARE * math.sqrt(abs(polygon_area(corners))))
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes = [np.arange(low[k] + step / 2.0, high[k], step) for k in range(2)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[inside(grid, corners)]
    return grid[_distance_to_border(grid, corners) >= margin]


def _corner_candidates(candidates: Floats, corners: Floats) -> list[int]:
    """Find the candidates farthest out in the four directions between the axes of the area."""
    azimuth = best_azimuth(corners)
    along = np.array([math.sin(azimuth), math.cos(azimuth)])
    across = np.array([along[1], -along[0]])
    # In units of the extent, so that the corners of a long area are its four corners too.
    frame = np.column_stack([candidates @ axis / np.ptp(corners @ axis) for axis in (along, across)])
    directions = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
    return list(dict.fromkeys(np.argmax(frame @ directions.T, axis=0).tolist()))


def _distance_to_border(points: Floats, corners: Floats) -> Floats:
    nearest = np.full(len(points), np.inf)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = end - start
        square = float(side @ side)
        share = np.clip((points - start) @ side / square, 0.0, 1.0) if square else np.zeros(len(points))
        foot = start + share[:, np.newaxis] * side
        nearest = np.minimum(nearest, np.hypot(*(points - foot).T))
    return nearest


def _farthest(candidates: Floats, chosen: list[int], count: int) -> list[int]:
    """Add the candidate farthest from all chosen ones until there are enough (Gonzalez 1985)."""
    result = list(chosen)
    nearest = np.full(len(candidates), np.inf)
    for row in result:
        nearest = np.minimum(nearest, np.hypot(*(candidates - candidates[row]).T))
    while len(result) < count:
        row = int(np.argmax(nearest))
        result.append(row)
        nearest = np.minimum(nearest, np.hypot(*(candidates - candidates[row]).T))
    return result

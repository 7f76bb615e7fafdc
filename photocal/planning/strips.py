"""Parallel strips over a polygon, with their exposures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError

# More than any aircraft can fly in one mission: a mistaken unit, not a plan.
_MOST_EXPOSURES = 50_000


@dataclass(frozen=True)
class Strip:
    """One straight line with exposures at equal distances.

    exposures_m (k, 2): east and north of the exposures in flying order, m.
    height_m: height above the ground of the area, m.
    """

    exposures_m: Floats
    height_m: float

    @property
    def length_m(self) -> float:
        """Distance from the first to the last exposure, m."""
        return math.dist(self.exposures_m[0], self.exposures_m[-1])


def best_azimuth(corners_m: Floats) -> float:
    """Give the flying direction that needs the fewest strips."""
    from scipy.spatial import ConvexHull

    hull = corners_m[ConvexHull(corners_m).vertices]
    sides = np.roll(hull, -1, axis=0) - hull
    azimuths = np.arctan2(sides[:, 0], sides[:, 1]) % math.pi
    widths = [float(np.ptp(_across(hull, float(azimuth)))) for azimuth in azimuths]
    return float(azimuths[int(np.argmin(widths))])


def plan_strips(
    corners_m: Floats,
    azimuth_rad: float,
    spacing_m: float,
    base_m: float,
    run_out_m: float,
    height_m: float,
) -> tuple[Strip, ...]:
    """Cover a polygon with parallel strips, flown to and fro.

    The outer strips fly along the border, so that ground at the border lies in the middle of their
    photos, and each strip runs out beyond the area. The distances of the strips are evened out: never
    larger than asked.
    """
    if not (spacing_m > 0.0 and base_m > 0.0 and run_out_m >= 0.0):
        raise ConfigurationError("the distances of strips and exposures must be positive")
    along, across = _along(corners_m, azimuth_rad), _across(corners_m, azimuth_rad)
    width, length = float(np.ptp(across)), float(np.ptp(along))
    count = max(1, math.ceil(width / spacing_m - 1e-9)) + 1
    if count * ((length + 2.0 * run_out_m) / base_m + 2.0) > _MOST_EXPOSURES:
        raise ConfigurationError(
            f"the plan would need more than {_MOST_EXPOSURES} exposures",
            remedy="look at height, overlap and area",
        )
    lines = np.linspace(across.min(), across.max(), count)
    half = (lines[1] - lines[0]) / 2.0
    rotated = np.column_stack((along, across))
    strips = []
    for number, line in enumerate(lines):
        first, last = _extent_in_band(rotated, float(line - half), float(line + half))
        exposures = math.ceil((last - first + 2.0 * run_out_m) / base_m - 1e-9) + 1
        middle = (first + last) / 2.0
        steps: Floats = middle + (np.arange(exposures, dtype=np.float64) - (exposures - 1) / 2.0) * base_m
        if number % 2:
            steps = steps[::-1]
        strips.append(Strip(_to_plane(steps, float(line), azimuth_rad), height_m))
    return tuple(strips)


def _along(points: Floats, azimuth: float) -> Floats:
    result: Floats = points @ np.array([math.sin(azimuth), math.cos(azimuth)])
    return result


def _across(points: Floats, azimuth: float) -> Floats:
    result: Floats = points @ np.array([math.cos(azimuth), -math.sin(azimuth)])
    return result


def _to_plane(along: Floats, across: float, azimuth: float) -> Floats:
    sine, cosine = math.sin(azimuth), math.cos(azimuth)
    return np.column_stack((along * sine + across * cosine, along * cosine - across * sine))


def _extent_in_band(rotated: Floats, low: float, high: float) -> tuple[float, float]:
    """Extent along the strip of that part of the polygon which lies nearest to it."""
    ends = np.roll(rotated, -1, axis=0)
    found = [rotated[(rotated[:, 1] >= low) & (rotated[:, 1] <= high), 0]]
    for border in (low, high):
        crossing = (rotated[:, 1] > border) != (ends[:, 1] > border)
        a, b = rotated[crossing], ends[crossing]
        found.append(a[:, 0] + (border - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))
    values = np.concatenate(found)
    return float(values.min()), float(values.max())

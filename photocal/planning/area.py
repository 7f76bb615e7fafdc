"""The area to be flown, and the local plane that it is laid into."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.arrays import Flags, Floats
from drivers.errors import InputMalformedError

# Beyond this the plane of one flight is no plane any more, and the polygon rather a mistake.
_LARGEST_EXTENT_M = 100_000.0


@dataclass(frozen=True)
class Area:
    """A simple polygon on WGS 84.

    latitude_deg, longitude_deg (n,): corners in order, degrees, the first not repeated at the end.
    """

    latitude_deg: Floats
    longitude_deg: Floats

    @property
    def centre_deg(self) -> tuple[float, float]:
        """Middle of the extent: latitude and longitude, degrees."""
        return (
            float(self.latitude_deg.min() + self.latitude_deg.max()) / 2.0,
            float(self.longitude_deg.min() + self.longitude_deg.max()) / 2.0,
        )


@dataclass(frozen=True)
class LocalPlane:
    """Azimuthal equidistant plane about a point: true to a millimetre over some kilometres.

    latitude_deg, longitude_deg: origin on WGS 84, degrees.
    """

    latitude_deg: float
    longitude_deg: float

    def to_plane(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Lay positions into the plane."""
        return np.column_stack(self._projection()(longitude_deg, latitude_deg))

    def to_degrees(self, plane_m: Floats) -> tuple[Floats, Floats]:
        """Take positions back from the plane."""
        longitude, latitude = self._projection()(plane_m[:, 0], plane_m[:, 1], inverse=True)
        return np.asarray(latitude), np.asarray(longitude)

    def _projection(self) -> Any:
        from pyproj import Proj

        return Proj(proj="aeqd", lat_0=self.latitude_deg, lon_0=self.longitude_deg, ellps="WGS84")


def area_from_corners(corners_deg: list[tuple[float, float]], where: str) -> Area:
    """Make an area from corners and refuse what cannot be flown."""
    if len(corners_deg) > 1 and corners_deg[0] == corners_deg[-1]:
        corners_deg = corners_deg[:-1]
    if len(set(corners_deg)) < 3:
        raise InputMalformedError("has fewer than three different corners", where=where)
    for longitude, latitude in corners_deg:
        if not (math.isfinite(longitude) and math.isfinite(latitude)):
            raise InputMalformedError("has a corner that is not a number", where=where)
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            raise InputMalformedError(
                f"has a corner at latitude {latitude:g}, longitude {longitude:g}",
                where=where,
                remedy="latitude and longitude may be swapped, or the coordinates are not degrees",
            )
    longitude_deg, latitude_deg = (
        np.array(column, dtype=np.float64) for column in zip(*corners_deg, strict=True)
    )
    area = Area(latitude_deg, longitude_deg)
    corners_m = LocalPlane(*area.centre_deg).to_plane(latitude_deg, longitude_deg)
    if not np.isfinite(corners_m).all() or float(np.ptp(corners_m, axis=0).max()) > _LARGEST_EXTENT_M:
        raise InputMalformedError(
            "is larger than 100 km",
            where=where,
            remedy="look for a wrong corner; one flight covers some kilometres",
        )
    if abs(polygon_area(corners_m)) < 1.0 or _crosses_itself(corners_m):
        raise InputMalformedError(
            "is not a simple polygon (no area, or sides that cross)",
            where=where,
            remedy="put the corners in order",
        )
    return area


def polygon_area(corners_m: Floats) -> float:
    """Give the area of a polygon."""
    x, y = (corners_m - corners_m[0]).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def inside(points_m: Floats, corners_m: Floats) -> Flags:
    """Say which points lie in a polygon."""
    result = np.zeros(len(points_m), dtype=np.bool_)
    x, y = points_m.T
    for (x1, y1), (x2, y2) in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        if y1 == y2:
            continue
        between = (y1 > y) != (y2 > y)
        result ^= between & (x < x1 + (y - y1) * (x2 - x1) / (y2 - y1))
    return result


def _crosses_itself(corners: Floats) -> bool:
    count = len(corners)
    ends = np.roll(corners, -1, axis=0)
    return any(
        _cross(corners[i], ends[i], corners[j], ends[j])
        for i in range(count)
        for j in range(i + 2, count)
        if (j + 1) % count != i
    )


def _cross(a: Floats, b: Floats, c: Floats, d: Floats) -> bool:
    def side(p: Floats, q: Floats, r: Floats) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0

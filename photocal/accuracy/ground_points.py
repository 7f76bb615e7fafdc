"""Mistakes in tables of ground points that an adjustment cannot tell from bad measurements.

Every function takes plain arrays and says in words what it found; none changes anything. They can be
used before an adjustment (against the positions of the exposures) and after it (against the
coordinates that the block gives the same points).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from photocal.accuracy.findings import Finding

FloatArray = NDArray[np.float64]

# One foot in metres: international; the U.S. survey foot differs in the sixth digit.
FOOT_M = 0.3048
# Ratios of distances are compared to this: control points agree far better, mistakes are far off.
_RATIO_TOLERANCE = 0.02
# A flight lies within this distance of its control, and one wrong UTM zone is some 600 km away.
_NEAR_M = 50_000.0
# Points closer than this are the same mark under two names.
_SAME_POINT_M = 0.005


@dataclass(frozen=True)
class GroundPoints:
    """Ground points of one role, in one coordinate system.

    Attributes
    ----------
    names : tuple of str
        Names.
    xyz_m : ndarray, shape (n, 3)
        Coordinates, m; NaN where not given.
    """

    names: tuple[str, ...]
    xyz_m: FloatArray


def check_points_used_as_control(control: GroundPoints, check: GroundPoints) -> tuple[Finding, ...]:
    """Find check points that are control points, by name or by place."""
    said = []
    both = sorted(set(control.names) & set(check.names))
    if both:
        said.append(
            Finding(
                "check-as-control",
                f"{name_list(both)} used both as control and as check: they were fitted, so they check "
                "nothing. Give each point one role.",
            )
        )
    for name, place in zip(check.names, check.xyz_m, strict=True):
        distance = np.sqrt(np.sum((control.xyz_m - place) ** 2, axis=1))
        said += [
            Finding(
                "check-at-control",
                f"check point {name} lies where control point {other} lies ({apart * 1000:.1f} mm apart): "
                "it is the same mark under two names and checks nothing.",
            )
            for other, apart in zip(control.names, distance.tolist(), strict=True)
            if apart <= _SAME_POINT_M and other != name and name not in both
        ]
    return tuple(said)


def heights_all_equal(points: GroundPoints) -> tuple[Finding, ...]:
    """Find a table whose heights are all zero, or all the same."""
    heights = points.xyz_m[:, 2]
    heights = heights[np.isfinite(heights)]
    if len(heights) < 3 or float(np.ptp(heights)) > 0.0:
        return ()
    value = float(heights[0])
    what = "Z = 0" if value == 0.0 else f"the same Z = {value:g} m"
    return (
        Finding(
            "heights-equal",
            f"all {len(heights)} points have {what}: the heights were not measured or not exported. Give "
            "the heights "
            "with their kind, or leave Z and its sigma free.",
        ),
    )


def latitude_longitude_swapped(
    latitude_deg: FloatArray, longitude_deg: FloatArray, exposures_deg: FloatArray | None
) -> tuple[Finding, ...]:
    """Find latitude and longitude that changed places."""
    worst = float(np.max(np.abs(latitude_deg)))
    if worst > 90.0:
        return (
            Finding(
                "latitude-longitude-swapped",
                f"a latitude of {worst:g} degrees does not exist: latitude and longitude are swapped.",
            ),
        )
    if exposures_deg is None or not len(exposures_deg):
        return ()
    flight = exposures_deg.mean(axis=0)
    as_given = geodesic_m(float(latitude_deg.mean()), float(longitude_deg.mean()), *flight.tolist())
    if as_given <= _NEAR_M or abs(float(longitude_deg.mean())) > 90.0:
        return ()
    swapped = geodesic_m(float(longitude_deg.mean()), float(latitude_deg.mean()), *flight.tolist())
    if swapped > _NEAR_M:
        return ()
    return (
        Finding(
            "latitude-longitude-swapped",
            f"the points lie {as_given / 1000:.0f} km from the flight, and {swapped / 1000:.1f} km when "
            "latitude and "
            "longitude change places: they are swapped.",
        ),
    )


def feet_for_metres(points: GroundPoints, block: GroundPoints) -> tuple[Finding, ...]:
    """Find coordinates or heights in feet among metres, or the reverse."""
    row = {name: index for index, name in enumerate(block.names)}
    common = [(index, row[name]) for index, name in enumerate(points.names) if name in row]
    if len(common) < 2:
        return ()
    ours, theirs = (np.array(column) for column in zip(*common, strict=True))
    said = []
    for code, what, columns in (("plane", "horizontal coordinates", [0, 1]), ("height", "heights", [2])):
        ratio = _distance_ratio(points.xyz_m[ours][:, columns], block.xyz_m[theirs][:, columns])
        if ratio is None:
            continue
        for factor, given, wanted in ((1.0 / FOOT_M, "feet", "metres"), (FOOT_M, "metres", "feet")):
            if abs(ratio / factor - 1.0) <= _RATIO_TOLERANCE:
                said.append(
                    Finding(
                        f"feet-for-metres-{code}",
                        f"the {what} are {ratio:.4f} times as far apart as in the block (a foot is "
                        f"{FOOT_M} m, its "
                        f"inverse {1 / FOOT_M:.4f}): they are in {given} where {wanted} are expected.",
                    )
                )
    return tuple(said)


def wrong_utm_zone(
    points: GroundPoints, zone: int, *, southern: bool, exposures_deg: FloatArray
) -> tuple[Finding, ...]:
    """Find coordinates that were given the wrong UTM zone or hemisphere."""
    centre = np.nanmean(points.xyz_m[:, :2], axis=0)
    first = float(exposures_deg[0, 1])
    latitude = float(np.mean(exposures_deg[:, 0]))
    # About the first one: a flight over the date line has longitudes near 180 and near -180.
    longitude = first + float(np.mean((exposures_deg[:, 1] - first + 180.0) % 360.0 - 180.0))
    stated = _utm_distance(centre, zone, southern, latitude, longitude)
    if stated <= _NEAR_M:
        return ()
    candidates = sorted(
        (_utm_distance(centre, other, south, latitude, longitude), other, south)
        for other in range(1, 61)
        for south in (False, True)
    )
    distance, other, south = candidates[0]
    if distance > _NEAR_M:
        return (
            Finding(
                "points-far-from-flight",
                f"the points lie {_kilometres(stated)} from the flight in UTM zone "
                f"{_zone(zone, southern)}, and no "
                "zone brings them near: look at the order of E and N and at the coordinate system.",
            ),
        )
    return (
        Finding(
            "wrong-utm-zone",
            f"in UTM zone {_zone(zone, southern)} the points lie {_kilometres(stated)} from the flight, "
            "in zone "
            f"{_zone(other, south)} {_kilometres(distance)}: the zone is wrong.",
        ),
    )


def geodesic_m(latitude_1: float, longitude_1: float, latitude_2: float, longitude_2: float) -> float:
    """Give the distance of two places on the ellipsoid."""
    from pyproj import Geod

    if not all(math.isfinite(value) for value in (latitude_1, longitude_1, latitude_2, longitude_2)):
        return math.inf
    return float(Geod(ellps="WGS84").inv(longitude_1, latitude_1, longitude_2, latitude_2)[2])


def _utm_distance(centre: FloatArray, zone: int, southern: bool, latitude: float, longitude: float) -> float:
    from pyproj import Proj

    projection = Proj(proj="utm", zone=zone, south=southern, ellps="WGS84")
    lon, lat = projection(float(centre[0]), float(centre[1]), inverse=True)
    return geodesic_m(float(lat), float(lon), latitude, longitude)


def _zone(zone: int, southern: bool) -> str:
    return f"{zone} {'south' if southern else 'north'}"


def _kilometres(distance_m: float) -> str:
    return f"{distance_m / 1000:.0f} km" if math.isfinite(distance_m) else "nowhere"


def _distance_ratio(a: FloatArray, b: FloatArray) -> float | None:
    """Ratio of the root mean square distances from the centre; None where it says nothing."""
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    if int(known.sum()) < 2:
        return None
    spread_a, spread_b = (float(np.sqrt(np.mean((v[known] - v[known].mean(axis=0)) ** 2))) for v in (a, b))
    # Heights of flat ground differ by their own errors only: a ratio of noise.
    if spread_b < 1.0 or spread_a < 0.1:
        return None
    return spread_a / spread_b


def name_list(names: list[str]) -> str:
    """Write names for a sentence."""
    shown = ", ".join(names[:8])
    return shown if len(names) <= 8 else f"{shown} and {len(names) - 8} more"

"""Mistakes in tables of ground points that an adjustment cannot tell from bad measurements.

Every function takes points or arrays and gives findings; none changes anything. They can be used before an
adjustment (against the positions of the exposures) and after it (against the coordinates that the block gives
the same points).
"""

import math
from collections import Counter

import numpy as np

from photocal.base.arrays import Floats
from photocal.block.model import ObjectPoints
from photocal.findings.finding import Figure, Finding

# One foot in metres: international; the U.S. survey foot differs in the sixth digit.
FOOT_M = 0.3048
# A flight lies within this distance of its control, and one wrong UTM zone is some 600 km away.
_NEAR_M = 50_000.0


def check_points_used_as_control(control: ObjectPoints, check: ObjectPoints) -> tuple[Finding, ...]:
    """Find check points that are control points, by name or by place."""
    listed = []
    both = sorted(set(control.names) & set(check.names))
    if both:
        listed.append(Finding("check-as-control", "doubtful", "check", {"points": tuple(both)}))
    # Points closer than this are the same mark under two names.
    same_point_m = 0.005
    for name, place in zip(check.names, check.values, strict=True):
        distance = np.sqrt(np.sum((control.values - place) ** 2, axis=1))
        listed += [
            Finding("check-at-control", "doubtful", name, {"other": other, "apart_mm": apart * 1000.0})
            for other, apart in zip(control.names, distance.tolist(), strict=True)
            if apart <= same_point_m and other != name and name not in both
        ]
    return tuple(listed)


def heights_all_equal(points: ObjectPoints, role: str) -> tuple[Finding, ...]:
    """Find a table whose heights are all zero, or all the same."""
    heights = points.values[:, 2]
    heights = heights[np.isfinite(heights)]
    if len(heights) < 3 or float(np.ptp(heights)) > 0.0:
        return ()
    figures = {"role": role, "n": float(len(heights)), "height_m": float(heights[0])}
    return (Finding("heights-equal", "doubtful", role, figures),)


def control_in_few_images(
    names: tuple[str, ...], observations: tuple[tuple[str, str], ...], role: str
) -> tuple[Finding, ...]:
    """Find ground points that are measured in one image only, or in none: too few to be control or check."""
    images = Counter(point for _, point in set(observations))
    single = tuple(name for name in names if images[name] == 1)
    none = tuple(name for name in names if images[name] == 0)
    listed = []
    if single:
        cause = "control-in-one-image" if role == "control" else "check-in-one-image"
        figures = {"role": role, "points": single}
        listed.append(Finding("one-image-only", "doubtful", role, figures, cause=cause))
    if none:
        listed.append(Finding("no-image", "doubtful", role, {"role": role, "points": none}))
    return tuple(listed)


def latitude_longitude_swapped(
    latitude_deg: Floats, longitude_deg: Floats, exposures_deg: Floats | None
) -> tuple[Finding, ...]:
    """Find latitude and longitude that changed places."""
    code, worst = "latitude-longitude-swapped", float(np.max(np.abs(latitude_deg)))
    if worst > 90.0:
        return (Finding(code, "grave", figures={"latitude": worst}, cause="latitude-impossible"),)
    if exposures_deg is None or not len(exposures_deg):
        return ()
    flight = exposures_deg.mean(axis=0)
    as_given = geodesic_m(float(latitude_deg.mean()), float(longitude_deg.mean()), *flight.tolist())
    if as_given <= _NEAR_M or abs(float(longitude_deg.mean())) > 90.0:
        return ()
    swapped = geodesic_m(float(longitude_deg.mean()), float(latitude_deg.mean()), *flight.tolist())
    if swapped > _NEAR_M:
        return ()
    figures = {"far_km": as_given / 1000.0, "near_km": swapped / 1000.0}
    return (Finding(code, "grave", figures=figures, cause="near-when-swapped"),)


def feet_for_metres(points: ObjectPoints, block: ObjectPoints) -> tuple[Finding, ...]:
    """Find coordinates or heights in feet among metres, or the reverse."""
    row = {name: index for index, name in enumerate(block.names)}
    common = [(index, row[name]) for index, name in enumerate(points.names) if name in row]
    if len(common) < 2:
        return ()
    ours, theirs = (np.array(column) for column in zip(*common, strict=True))
    listed = []
    # Ratios of distances are compared to this: control points agree far better, mistakes are far off.
    ratio_tolerance = 0.02
    for code, columns in (("feet-for-metres-plane", [0, 1]), ("feet-for-metres-height", [2])):
        ratio = _distance_ratio(points.values[ours][:, columns], block.values[theirs][:, columns])
        if ratio is None:
            continue
        for factor, cause in ((1.0 / FOOT_M, "distances-in-feet"), (FOOT_M, "distances-in-metres")):
            if abs(ratio / factor - 1.0) <= ratio_tolerance:
                listed.append(Finding(code, "grave", figures={"ratio": ratio}, cause=cause))
    return tuple(listed)


def wrong_utm_zone(
    points: ObjectPoints, zone: int, *, southern: bool, exposures_deg: Floats
) -> tuple[Finding, ...]:
    """Find coordinates that were given the wrong UTM zone or hemisphere."""
    centre = np.nanmean(points.values[:, :2], axis=0)
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
    figures: dict[str, Figure] = {"zone": _zone(zone, southern), "far_km": _kilometres(stated)}
    if distance > _NEAR_M:
        return (Finding("points-far-from-flight", "grave", figures=figures, cause="no-zone"),)
    figures |= {"other": _zone(other, south), "near_km": _kilometres(distance)}
    return (Finding("wrong-utm-zone", "grave", figures=figures),)


def geodesic_m(latitude_1: float, longitude_1: float, latitude_2: float, longitude_2: float) -> float:
    """Give the distance of two places on the ellipsoid."""
    from pyproj import Geod

    if not all(math.isfinite(value) for value in (latitude_1, longitude_1, latitude_2, longitude_2)):
        return math.inf
    return float(Geod(ellps="WGS84").inv(longitude_1, latitude_1, longitude_2, latitude_2)[2])


def _utm_distance(centre: Floats, zone: int, southern: bool, latitude: float, longitude: float) -> float:
    from pyproj import Proj

    projection = Proj(proj="utm", zone=zone, south=southern, ellps="WGS84")
    lon, lat = projection(float(centre[0]), float(centre[1]), inverse=True)
    return geodesic_m(float(lat), float(lon), latitude, longitude)


def _zone(zone: int, southern: bool) -> str:
    return f"{zone} {'S' if southern else 'N'}"


def _kilometres(distance_m: float) -> float:
    """Half way round the earth is far enough for what is nowhere."""
    # Half the way round the earth: nothing is farther apart.
    nowhere_m = 2.0e7
    return min(distance_m, nowhere_m) / 1000.0


def _distance_ratio(a: Floats, b: Floats) -> float | None:
    """Ratio of the root mean square distances from the centre; None where it says nothing."""
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    if int(known.sum()) < 2:
        return None
    spread_a, spread_b = (float(np.sqrt(np.mean((v[known] - v[known].mean(axis=0)) ** 2))) for v in (a, b))
    # Heights of flat ground differ by their own errors only: a ratio of noise.
    if spread_b < 1.0 or spread_a < 0.1:
        return None
    return spread_a / spread_b

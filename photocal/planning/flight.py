"""The whole plan of a flight: camera, heights, overlaps, strips, what they give, and places for control.

Flight geometry is that over level ground, from c and image size; precision is that to be expected.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats, spread
from photocal.base.errors import ConfigurationError
from photocal.geometry.camera import Camera, camera, pixel_to_plane
from photocal.planning.area import Area, LocalPlane, grid, inside, polygon_area

Side = Literal["columns", "rows"]
# Control points and check points, east and north in the plane of the flight, m.
Layout = tuple[Floats, Floats]
# Side of the grid of candidate places as a share of the root of the area.
_GRID_SHARE = 1.0 / 60.0


def planned_camera(
    focal_mm: float, pixel_um: float, size_px: tuple[int, int], estimate: tuple[str, ...] = ()
) -> Camera:
    """Give a camera without distortion, in mm.

    raises ConfigurationError: for a length that is not positive, or a name that is no parameter.
    """
    if not (focal_mm > 0.0 and pixel_um > 0.0 and min(size_px) > 0):
        raise ConfigurationError("focal length, pixel size and image size must be positive")
    pitch = pixel_um * 1e-3
    return camera("planned", "brown-ideal", "mm", size_px, (pitch, pitch), {"c": focal_mm}, estimate=estimate)


def flying_height(gsd_m: float, planned: Camera) -> float:
    """Give the height above ground of a ground sample distance (canon-elph study, equations 31 and 32).

    f GSD / pixel (Alves Junior et al. 2015, equation 1).
    """
    return gsd_m * planned.value("c") / planned.pitch[0]


def ground_sample_distance(height_m: float, planned: Camera) -> float:
    """Give the size of a pixel on level ground."""
    return height_m * planned.pitch[0] / planned.value("c")


def footprint(gsd_m: float, planned: Camera) -> tuple[float, float]:
    """Give the ground that a vertical photo shows."""
    columns, rows = planned.size_px
    return columns * gsd_m, rows * gsd_m


def air_base(overlap: float, ground_side_m: float) -> float:
    """Give the distance of neighbouring photos or strips (canon-elph study, equation 33)."""
    if not 0.0 <= overlap < 1.0:
        raise ConfigurationError(
            f"an overlap of {overlap:g} cannot be flown", remedy="give a fraction below 1, such as 0.8"
        )
    return (1.0 - overlap) * ground_side_m


def exposure_interval(base_m: float, ground_speed_m_s: float) -> float:
    """Give the time between exposures at a ground speed."""
    if not ground_speed_m_s > 0.0:
        raise ConfigurationError(f"a ground speed of {ground_speed_m_s:g} m/s allows no exposure interval")
    return base_m / ground_speed_m_s


def parallax_sigma(image_sigma: float) -> float:
    """Give the standard deviation of an x parallax, the difference of two measured coordinates."""
    return math.sqrt(2.0) * image_sigma


def stereo_precision(
    height_m: float, base_m: float, c: float, point: tuple[float, float], image_sigma: float
) -> dict[str, float]:
    """Expect the precision of a point intersected from one pair of vertical photos.

    c, point, image_sigma: in one unit; point: in the image plane.
    returns: standard deviations, m, "x" and "y" along the axes of the photo, "z" in height, and "plane" of
        both coordinates (canon-elph study, equation 39).
    """
    parallax = parallax_sigma(image_sigma)
    scale = height_m / c

    def plane(coordinate: float) -> float:
        """Standard deviation of a ground coordinate: of its parallax and of the image point itself."""
        return scale * math.hypot(coordinate / c * height_m / base_m * parallax, image_sigma)

    x, y = map(plane, point)
    height = normal_case_height_sigma(height_m, base_m, c, parallax)
    return {"x": x, "y": y, "z": height, "plane": math.hypot(x, y)}


def normal_case_height_sigma(height_m: float, base_m: float, c: float, parallax: float) -> float:
    """Expect the standard deviation of a height in the normal case; c and parallax in one unit."""
    return height_m**2 / (base_m * c) * parallax


def expected_altimetric_accuracy(height_m: float, base_m: float, c: float, pixel: float) -> float:
    """Give the dz of the calibration report form of the Brazilian ministry of defence."""
    return normal_case_height_sigma(height_m, base_m, c, parallax_sigma(pixel))


def corner_precision(
    planned: Camera, height_m: float, base_m: float, image_sigma_px: float
) -> dict[str, float]:
    """Expect the precision far out in the image, where it is worst."""
    share = 0.95
    x, y = pixel_to_plane(planned.size_px, planned.pitch, share * np.array(planned.size_px)).tolist()
    sigma = image_sigma_px * planned.pitch[0]
    return stereo_precision(height_m, base_m, planned.value("c"), (x, y), sigma)


@dataclass(frozen=True)
class Strip:
    """One straight line with exposures at equal distances.

    exposures_m (k, 2): east and north of the exposures in flying order, m.
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
    widths = [float(np.ptp(_turned(hull, float(azimuth))[:, 1])) for azimuth in azimuths]
    return float(azimuths[int(np.argmin(widths))])


def plan_strips(
    corners_m: Floats,
    azimuth_rad: float,
    spacing_m: float,
    base_m: float,
    run_out_m: float,
    height_m: float,
    border_m: float = 0.0,
) -> tuple[Strip, ...]:
    """Cover a polygon, and a border about it, with parallel strips, flown to and fro."""
    if not (spacing_m > 0.0 and base_m > 0.0 and run_out_m >= 0.0 and border_m >= 0.0):
        raise ConfigurationError("the distances of strips and exposures must be positive")
    rotated = _turned(corners_m, azimuth_rad)
    length, width = (np.ptp(rotated, axis=0) + np.array([0.0, 2.0 * border_m])).tolist()
    run_out_m += border_m
    count = max(1, math.ceil(width / spacing_m - 1e-9)) + 1
    # More than any aircraft can fly in one mission: a mistaken unit, not a plan.
    most_exposures = 50_000
    if count * ((length + 2.0 * run_out_m) / base_m + 2.0) > most_exposures:
        raise ConfigurationError(
            f"the plan would need more than {most_exposures} exposures",
            remedy="check height, overlap and area",
        )
    lines = np.linspace(rotated[:, 1].min() - border_m, rotated[:, 1].max() + border_m, count)
    half = (lines[1] - lines[0]) / 2.0 + border_m
    strips = []
    for number, line in enumerate(lines):
        first, last = _extent_in_band(rotated, float(line - half), float(line + half))
        exposures = math.ceil((last - first + 2.0 * run_out_m) / base_m - 1e-9) + 1
        middle = (first + last) / 2.0
        steps: Floats = middle + (np.arange(exposures, dtype=np.float64) - (exposures - 1) / 2.0) * base_m
        if number % 2:
            steps = steps[::-1]
        places = np.column_stack((steps, np.full(exposures, line)))
        strips.append(Strip(_turned(places, azimuth_rad), height_m))
    return tuple(strips)


def _turned(points: Floats, azimuth: float) -> Floats:
    """Turn east and north to along and across a flying direction, or back: it is its own inverse."""
    sine, cosine = math.sin(azimuth), math.cos(azimuth)
    return np.asarray(points @ np.array([[sine, cosine], [cosine, -sine]]))


def _extent_in_band(rotated: Floats, low: float, high: float) -> tuple[float, float]:
    """Extent along the strip of that part of the polygon which lies nearest to it."""
    ends = np.roll(rotated, -1, axis=0)
    along = [rotated[(rotated[:, 1] >= low) & (rotated[:, 1] <= high), 0]]
    for border in (low, high):
        crossing = (rotated[:, 1] > border) != (ends[:, 1] > border)
        a, b = rotated[crossing], ends[crossing]
        along.append(a[:, 0] + (border - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))
    values = np.concatenate(along)
    return float(values.min()), float(values.max())


@dataclass(frozen=True)
class FlightRequest:
    """Requirements of a flight.

    Attributes
    ----------
    camera
        Its image size, pitch and c, in mm.
    forward_overlap, side_overlap
        Shares of the footprint, 0 to below 1.
    along
        Side of the image that lies along the flight line: "rows" flies with the image width across.
    azimuth_rad
        Flying direction, clockwise from north, rad; None takes the one with the fewest strips.
    second_height_m
        Height above ground of the cross strips, m; it separates principal distance and flying height.
    border_m
        Width of a margin around the area that is covered, too: distortion and control are weakest at the
        edge.
    """

    camera: Camera
    height_m: float
    forward_overlap: float
    side_overlap: float
    along: Side = "rows"
    speed_m_s: float = 10.0
    azimuth_rad: float | None = None
    cross_strips: bool = False
    second_height_m: float | None = None
    border_m: float = 0.0


@dataclass(frozen=True)
class LevelGeometry:
    """Figures of one flying height over level ground, m and s."""

    height_m: float
    scale_denominator: float
    gsd_m: float
    footprint_m: tuple[float, float]
    base_m: float
    strip_spacing_m: float
    exposure_interval_s: float
    precision: dict[str, float]
    dz_m: float


@dataclass(frozen=True)
class PlannedFlight:
    """A planned flight.

    corners_m (n, 2): the polygon in that plane, m.
    azimuth_rad: flying direction of the main strips, rad.
    levels: the main height, and the second one where there is one.
    strips: in flying order; cross strips last.
    """

    plane: LocalPlane
    corners_m: Floats
    request: FlightRequest
    azimuth_rad: float
    levels: tuple[LevelGeometry, ...]
    strips: tuple[Strip, ...]

    @property
    def exposures(self) -> int:
        """Number of photos."""
        return sum(len(strip.exposures_m) for strip in self.strips)

    @property
    def distance_m(self) -> float:
        """Distance flown along strips and between them, m, without take-off and return."""
        turns = sum(
            math.dist(before.exposures_m[-1], after.exposures_m[0]) + abs(before.height_m - after.height_m)
            for before, after in zip(self.strips, self.strips[1:], strict=False)
        )
        return turns + sum(strip.length_m for strip in self.strips)

    @property
    def duration_s(self) -> float:
        """Time on strips and turns at the planned speed, s, without take-off and return."""
        return self.distance_m / self.request.speed_m_s

    @property
    def area_m2(self) -> float:
        """Area of the polygon, m^2."""
        return abs(polygon_area(self.corners_m))


def level_geometry(request: FlightRequest, height_m: float) -> LevelGeometry:
    """Compute the figures of one flying height."""
    # From a person's height to that of the highest survey aircraft: all else is a wrong unit.
    if not 1.0 <= height_m <= 20_000.0:
        raise ConfigurationError(
            f"a flying height of {height_m:g} m above ground is not possible",
            "check the units: focal length in mm, pixel in micrometres, GSD in cm, heights in m",
        )
    planned, c = request.camera, request.camera.value("c")
    gsd = ground_sample_distance(height_m, planned)
    ground = footprint(gsd, planned)
    along, across = ground if request.along == "columns" else ground[::-1]
    base = air_base(request.forward_overlap, along)
    # Half a pixel: what the canon-elph study takes for a tie point in one image.
    image_sigma_px = 0.5
    return LevelGeometry(
        height_m,
        height_m / (c * 1e-3),
        gsd,
        ground,
        base,
        air_base(request.side_overlap, across),
        exposure_interval(base, request.speed_m_s),
        corner_precision(planned, height_m, base, image_sigma_px),
        expected_altimetric_accuracy(height_m, base, c, planned.pitch[0]),
    )


def plan_flight(area: Area, request: FlightRequest) -> PlannedFlight:
    """Plan a flight over a polygon.

    raises ConfigurationError: for heights, overlaps or distances that cannot be flown.
    """
    plane = LocalPlane(*area.centre_deg)
    corners = plane.to_plane(area.latitude_deg, area.longitude_deg)
    azimuth = best_azimuth(corners) if request.azimuth_rad is None else request.azimuth_rad
    main = level_geometry(request, request.height_m)
    levels = [main]
    strips = _strips(corners, azimuth, main, request)
    if request.cross_strips or request.second_height_m is not None:
        cross = main
        if request.second_height_m is not None:
            cross = level_geometry(request, request.second_height_m)
            levels.append(cross)
        strips += _strips(corners, azimuth + math.pi / 2.0, cross, request)
    return PlannedFlight(plane, corners, request, azimuth, tuple(levels), strips)


def _strips(
    corners: Floats, azimuth: float, level: LevelGeometry, request: FlightRequest
) -> tuple[Strip, ...]:
    run_out = level.footprint_m[0 if request.along == "columns" else 1] / 2.0
    spacing, base = level.strip_spacing_m, level.base_m
    return plan_strips(corners, azimuth, spacing, base, run_out, level.height_m, request.border_m)


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
            f"{control} control points are too few to orient a block",
            remedy="plan at least 3, better 5 or more",
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
        corners = [corners[row] for row in spread(candidates[corners], control, [0])]
    chosen = spread(candidates, control + check, corners)
    return candidates[chosen[:control]], candidates[chosen[control:]]


def _candidates(corners: Floats, margin: float) -> Floats:
    step = max(1.0, _GRID_SHARE * math.sqrt(abs(polygon_area(corners))))
    places = grid(corners.min(axis=0), corners.max(axis=0), step)
    places = places[inside(places, corners)]
    return places[_distance_to_border(places, corners) >= margin]


def _corner_candidates(candidates: Floats, corners: Floats) -> list[int]:
    """Find the candidates farthest out in the four directions between the axes of the area."""
    azimuth = best_azimuth(corners)
    # In units of the extent, so that the corners of a long area are its four corners too.
    frame = _turned(candidates, azimuth) / np.ptp(_turned(corners, azimuth), axis=0)
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

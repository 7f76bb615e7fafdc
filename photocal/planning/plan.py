"""The step `plan`: from an area and what is asked of a flight to strips, ground points and precision.

A planned flight as text and as JSON.

Whether flights show the precision that a plan promises: simulated ones with random errors.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.analysis.accuracy.standard import ScaleStandard, Standard, load_standard, parse_scale
from photocal.base.arrays import Floats, picked
from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.geodesy import GeodeticPlace
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json, finding_text
from photocal.geometry.smear import SMEAR_LIMIT_PX, smear_px
from photocal.planning import simulated_adjustment
from photocal.planning.area import Area, read_area
from photocal.planning.flight import (
    FlightRequest,
    Layout,
    LevelGeometry,
    PlannedFlight,
    plan_flight,
    suggest_layout,
)
from photocal.planning.mission import at_speed, farthest_m, in_wind, write_plan
from photocal.planning.options import LimitOptions, MissionOptions, PrecisionOptions
from photocal.planning.simulated_adjustment import SimulatedPrecision, planned_network

SCHEMA = "photocal.plan/1"
STAGES = ("product", "triangulation", "control points")
# With a third, all earlier stages together add 5 % to the error of the last one.
EARLIER_SHARE = 1.0 / 3.0


@dataclass(frozen=True)
class Target:
    """A class that the product shall reach."""

    name: str
    component: str
    ep_m: float


def error_budget(product_m: float) -> dict[str, float]:
    """Divide the standard error of a product among the stages that lead to it, m."""
    if not product_m > 0.0:
        raise ConfigurationError("the standard error of a product must be positive")
    return {name: product_m * EARLIER_SHARE**back for back, name in enumerate(STAGES)}


def targets_of(standard: Standard, scale_denominator: float, class_name: str) -> tuple[Target, ...]:
    """Give what a class of a standard asks for at a scale.

    returns: planimetry, and heights where the standard lists a contour interval for the scale.
    raises ConfigurationError: when the standard has no such class.
    """
    tables = standard.tables if isinstance(standard, ScaleStandard) else ()
    targets = []
    for table in tables:
        size = scale_denominator if table.basis == "scale" else table.interval_at(scale_denominator)
        limits = () if size is None else table.limits_at(size)
        targets += [
            Target(
                f"{table.product}, class {limit.name}, 1:{scale_denominator:g}", table.component, limit.ep_m
            )
            for limit in limits
            if limit.name == class_name
        ]
    if not targets:
        raise ConfigurationError(
            f"{standard.id} has no class {class_name!r}", remedy="take pec-pcd with class A, B, C or D"
        )
    return tuple(targets)


def remarks(
    flight: PlannedFlight,
    targets: tuple[Target, ...],
    exposure_time_s: float | None,
    shortest_interval_s: float | None,
) -> tuple[Finding, ...]:
    """State the objections to a plan.

    shortest_interval_s: shortest time between two photos that the camera manages, s.
    """
    listed = []
    speed = flight.request.speed_m_s
    for level in flight.levels:
        height = f"{level.height_m:.0f} m"
        if shortest_interval_s is not None and level.exposure_interval_s < shortest_interval_s:
            figures = {
                "due_s": level.exposure_interval_s,
                "needed_s": shortest_interval_s,
                "speed_m_s": level.base_m / shortest_interval_s,
            }
            listed.append(Finding("interval-too-short", "doubtful", height, figures))
        smear = 0.0 if exposure_time_s is None else smear_px(exposure_time_s, speed, level.gsd_m)
        if smear > SMEAR_LIMIT_PX:
            longest_ms = SMEAR_LIMIT_PX * level.gsd_m / speed * 1e3
            figures = {"speed_m_s": speed, "smear_px": smear, "longest_ms": longest_ms}
            listed.append(Finding("smear", "doubtful", height, figures))
    precision = flight.levels[0].precision
    for target in targets:
        sigma = precision["plane" if target.component == "planimetry" else "z"]
        if sigma > target.ep_m:
            figures = {"sigma_m": sigma, "allowed_m": target.ep_m}
            listed.append(Finding("precision-above-target", "doubtful", target.name, figures))
    if len(flight.levels) == 1:
        listed.append(Finding("one-height", "note"))
    return tuple(listed)


def _level(level: LevelGeometry) -> dict[str, Any]:
    keys = ("height_m", "scale_denominator", "gsd_m", "footprint_m", "base_m", "strip_spacing_m", "dz_m")
    made = picked(level, *keys, "exposure_interval_s", sigma_m="precision")
    return made | {"height_by_c_m_um": height_by_c(level)}


def _level_text(level: LevelGeometry, say: Catalogue) -> str:
    width, height = level.footprint_m
    return say.told(
        "planned.level",
        **level.precision,
        height=level.height_m,
        scale=level.scale_denominator,
        gsd=level.gsd_m * 100.0,
        across=width,
        along=height,
        size=width * height / 1e4,
        base=level.base_m,
        apart=level.strip_spacing_m,
        interval=level.exposure_interval_s,
        dz=level.dz_m * 100.0,
        by_c=height_by_c(level),
    )


def height_by_c(level: LevelGeometry) -> float:
    """Give the error of all heights for each micrometre that a held c is wrong, m.

    H / c, where positions and straight-down pictures of this height alone tell the heights.
    """
    # The scale denominator is H / c.
    return level.scale_denominator * 1e-6


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A planned flight, where its ground points may lie, and the precision to expect.

    Attributes
    ----------
    flight
        Strips and their exposures, and the figures of each height.
    layout
        Control points and check points, east and north in the plane of the flight, m, shapes (n, 2).
    targets
        Classes that the product shall reach; empty without a map scale.
    findings
        Findings of the comparison with the limits of camera, class and radio.
    wind
        Effect of the wind on the strips, see `photocal.planning.mission.in_wind`; None without wind.
    takeoff
        Take-off place and mean height of the area above mean sea level, m; None without a mission.
    farthest_m
        Distance of the farthest photo from the take-off place, m; None without a mission.
    survey
        Precision of the observations in the adjustment of the planned flight.
    precision
        Standard deviations that this adjustment gives; None where it was not asked for.
    """

    flight: PlannedFlight
    layout: Layout
    targets: tuple[Target, ...]
    findings: tuple[Finding, ...]
    wind: dict[str, float] | None
    takeoff: tuple[GeodeticPlace, float] | None
    farthest_m: float | None
    survey: PrecisionOptions | None
    precision: SimulatedPrecision | None

    def figures(self) -> dict[str, Any]:
        """Give all figures as a JSON value."""
        flight = self.flight
        figures = {
            "schema": SCHEMA,
            "area_ha": flight.area_m2 / 1e4,
            "azimuth_deg": math.degrees(flight.azimuth_rad) % 180.0,
            "levels": [_level(level) for level in flight.levels],
            "along": flight.request.along,
            "strips": len(flight.strips),
            **picked(flight, "exposures", "distance_m", "duration_s"),
            "error_budget_m": {target.name: error_budget(target.ep_m) for target in self.targets},
            "findings": [finding_json(finding, catalogue("en")) for finding in self.findings],
            "farthest_m": self.farthest_m,
            "wind": self.wind,
        }
        if self.precision is not None and self.survey is not None:
            figures["simulated"] = simulated_adjustment.to_json(self.precision, self.survey)
        return figures

    def __repr__(self) -> str:
        """Say it for people."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """Give it as a text in a language."""
        flight, counts = self.flight, {"strips": len(self.flight.strips), "photos": self.flight.exposures}
        lines = [
            say.told(
                "planned.area",
                **counts,
                area=flight.area_m2 / 1e4,
                azimuth=math.degrees(flight.azimuth_rad) % 180.0,
                distance=flight.distance_m / 1e3,
                minutes=flight.duration_s / 60.0,
                speed=flight.request.speed_m_s,
            )
        ]
        lines += [_level_text(level, say) for level in flight.levels]
        for target in self.targets:
            stages = say("join.figures").join(
                f"{say.stored(name)} {say.row([allowed], '.3f')} m"
                for name, allowed in error_budget(target.ep_m).items()
            )
            lines.append(say("planned.budget", target=say.stored(target.name), stages=stages))
        named = (replace(finding, subject=say.stored(finding.subject)) for finding in self.findings)
        lines += [f"* {finding_text(finding, say)}" for finding in named]
        if self.wind is not None:
            lines.append(say.told("planned.wind", **self.wind))
        if self.farthest_m is not None:
            lines.append(say.told("planned.farthest", away=self.farthest_m))
        if self.precision is not None:
            lines.append(simulated_adjustment.to_text(self.precision, say))
        return "\n".join(lines)

    def write(self, folder: str | Path, mission: MissionOptions | None = None) -> list[str]:
        """Write the plan, and the mission where take-off and ground are known; give the names of the files.

        Parameters
        ----------
        folder
            Folder to write.
        mission
            Autopilot and vehicle; an ArduPilot quadrotor where not given.
        """
        of = mission or MissionOptions()
        names = write_plan(
            Path(folder), self.flight, self.layout, self.takeoff, of.autopilot, of.vehicle, self.figures()
        )
        return list(names)


def plan(
    area: str | Path | Area,
    request: FlightRequest,
    *,
    limits: LimitOptions | None = None,
    mission: MissionOptions | None = None,
    precision: PrecisionOptions | None = None,
) -> Plan:
    """Plan a photo flight over a polygon and predict its precision.

    The planned exposures, a net of tie points and the suggested ground points are adjusted as a network
    without errors: its covariance is that of the flight as planned.

    Parameters
    ----------
    area
        Polygon: a file (GeoJSON, KML, KMZ, or CSV with lat_deg and lon_deg), or an `Area`.
    request
        Camera, height (m), overlaps (shares), speed (m/s) and strips.
    limits
        Wind, range of the radio, class of the product and timing of the camera, with which the flight is
        checked.
    mission
        Take-off place and mean height of the area, for distances and the mission.
    precision
        Ground points to suggest, and sigmas of the observations; 8 control and 30 check points, 0.5 px and
        2 and 3 cm where not given.

    Returns
    -------
    Plan
        Flight, ground points, findings and expected precision; `write` makes the files of the mission.

    Raises
    ------
    ConfigurationError
        For heights, overlaps or distances that cannot be flown.
    InputNotFoundError, InputMalformedError
        When the area cannot be read.

    Examples
    --------
    >>> import photocal
    >>> corners = [(-51.41, -22.12), (-51.4085, -22.12), (-51.4085, -22.1212), (-51.41, -22.1212)]
    >>> camera = photocal.FlightOptions(focal_mm=8.8, pixel_um=2.41, image_px="5472x3648", height=100.0)
    >>> field = photocal.area_from_corners(corners, "field")
    >>> round(photocal.plan(field, camera.request()).flight.levels[0].gsd_m, 4)
    0.0274
    """
    limits, of_mission = limits or LimitOptions(), mission or MissionOptions()
    asked = precision or PrecisionOptions()
    flight = plan_flight(area if isinstance(area, Area) else read_area(Path(area)), request)
    targets: tuple[Target, ...] = ()
    if limits.scale is not None:
        targets = targets_of(load_standard(limits.standard), parse_scale(limits.scale), limits.map_class)
    takeoff = None
    if of_mission.home is not None and of_mission.ground_height is not None:
        takeoff = _home(of_mission.home), of_mission.ground_height
    if limits.radio_range is not None and takeoff is None:
        raise ConfigurationError("--radio-range needs --home and --ground-height")
    blown, fast = None, flight
    if limits.wind is not None:
        strength, direction = numbers_of(limits.wind, "--wind", "SPEED,FROM: m/s and degrees, such as 6,220")
        blown = in_wind(flight, strength, math.radians(direction), of_mission.vehicle)
        fast = at_speed(flight, blown["fastest_m_s"])
    exposure_s = None if limits.exposure_ms is None else limits.exposure_ms * 1e-3
    notes = remarks(fast, targets, exposure_s, limits.shortest_interval)
    away = None if takeoff is None else farthest_m(flight, *takeoff)
    # No aircraft with a mission file begins so far away: somewhere latitude and longitude are exchanged.
    if away is not None and away > 200e3:
        raise ConfigurationError(
            f"the area is {away / 1e3:.0f} km from the take-off place",
            "check latitude and longitude of both: --home takes LAT,LON,HEIGHT",
        )
    if away is not None and limits.radio_range is not None and away > limits.radio_range:
        figures = {"far_m": away, "range_m": limits.radio_range}
        notes = (*notes, Finding("radio-range", "doubtful", figures=figures))
    # Half a base keeps the points on several photos without leaving the corners.
    layout = suggest_layout(flight.corners_m, asked.control, asked.check, flight.levels[0].base_m / 2.0)
    survey = asked if asked.simulation else None
    return Plan(
        flight=flight,
        layout=layout,
        targets=targets,
        findings=notes,
        wind=blown,
        takeoff=takeoff,
        farthest_m=away,
        survey=survey,
        precision=None if survey is None else simulated_adjustment.simulate(flight, layout, survey),
    )


def _home(text: str) -> GeodeticPlace:
    form = "LAT,LON,HEIGHT: degrees, metres above mean sea level"
    latitude, longitude, height = numbers_of(text, "--home", form)
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise ConfigurationError(f"{text!r} is not a place on the earth", "latitude comes first")
    return GeodeticPlace(latitude, longitude, height)


@dataclass(frozen=True)
class FlightErrors:
    """Promised and found precision of the check points of a planned flight.

    Attributes
    ----------
    promised_m
        Root mean square of the standard deviations of X, Y, Z, m, shape (3,).
    errors_m
        Adjusted less true coordinates, m, shape (flights, points, 3).
    """

    promised_m: Floats
    errors_m: Floats

    def __repr__(self) -> str:
        """Set what was found beside what was promised."""
        found, promised = (
            " ".join(f"{1e3 * v:.1f}" for v in axes) for axes in (self.found_m, self.promised_m)
        )
        return f"{len(self.errors_m)} flights: errors of X, Y, Z {found} mm, predicted {promised} mm"

    @property
    def found_m(self) -> Floats:
        """Root mean square errors of X, Y, Z, m, shape (3,)."""
        return np.asarray(np.sqrt(np.mean(np.square(self.errors_m), axis=(0, 1))))


def simulate_flights(plan: Plan, flights: int = 20, *, seed: int = 0) -> FlightErrors:
    """Fly a plan several times with random errors of images and control, and adjust each flight.

    Parameters
    ----------
    plan
        A planned flight; the sigmas of its observations are those of its precision options.
    flights
        Number of simulated flights.
    seed
        Of the random errors: the same seed gives the same flights.

    Returns
    -------
    FlightErrors
        The errors that the covariance predicts, and those of the simulated flights.

    Raises
    ------
    IllPosedError
        When no check point is visible in two photos, or the flight does not determine its points.

    Examples
    --------
    >>> import photocal
    >>> corners = [(-51.41, -22.12), (-51.4085, -22.12), (-51.4085, -22.1212), (-51.41, -22.1212)]
    >>> camera = photocal.FlightOptions(focal_mm=8.8, pixel_um=2.41, image_px="5472x3648", height=100.0)
    >>> plan = photocal.plan(photocal.area_from_corners(corners, "field"), camera.request())
    >>> errors = photocal.simulate_flights(plan, 5)
    >>> bool((abs(errors.found_m / errors.promised_m - 1.0) < 0.5).all())
    True
    """
    network, check = planned_network(plan.flight, plan.layout, plan.survey or PrecisionOptions())
    if not len(check):
        raise IllPosedError("no check point is seen by two photos", "plan more overlap or more check points")
    variance = np.diagonal(adjust(network).point_covariance[check], axis1=1, axis2=2)
    rng, errors = np.random.default_rng(seed), []
    points, rays = network.points, network.rays
    weight = points.weight[:, range(3), range(3)]
    sigma = np.where(weight > 0, 1 / np.sqrt(np.maximum(weight, 1e-12)), 0.0)
    for _ in range(flights):
        surveyed = points.values + rng.normal(0, 1, sigma.shape) * sigma
        measured = rays.plane + rng.normal(0, 1, rays.plane.shape) * rays.sigma
        flown = replace(network, points=replace(points, values=surveyed), rays=replace(rays, plane=measured))
        errors.append(adjust(flown).points[check] - points.values[check])
    return FlightErrors(np.sqrt(variance.mean(axis=0)), np.array(errors))

"""The step `plan`: from an area and what is asked of a flight to strips, ground points and precision."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.accuracy.standard import load_standard, parse_scale
from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError
from photocal.findings.finding import Finding
from photocal.planning import simulated_adjustment
from photocal.planning.area import Area, read_area
from photocal.planning.flight import FlightRequest, Layout, PlannedFlight, plan_flight, suggest_layout
from photocal.planning.mission import Home, write_plan
from photocal.planning.options import LimitOptions, MissionOptions, PrecisionOptions
from photocal.planning.simulated_adjustment import PlannedSurvey, SimulatedPrecision
from photocal.planning.summary import Target, remarks, targets_of, to_json, to_text
from photocal.planning.wind import WIND_TEXT, at_speed, farthest_m, in_wind


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
        What the limits of camera, class and radio say of the flight.
    wind
        What a wind makes of the strips, see `photocal.planning.wind.in_wind`; None without wind.
    takeoff
        Take-off place and mean height of the area above mean sea level, m; None without a mission.
    farthest_m
        Distance of the farthest photo from the take-off place, m; None without a mission.
    survey
        Precision of the observations of which the flight was adjusted.
    precision
        Standard deviations that this adjustment gives; None where it was not asked for.
    """

    flight: PlannedFlight
    layout: Layout
    targets: tuple[Target, ...]
    findings: tuple[Finding, ...]
    wind: dict[str, float] | None
    takeoff: tuple[Home, float] | None
    farthest_m: float | None
    survey: PlannedSurvey | None
    precision: SimulatedPrecision | None

    def figures(self) -> dict[str, Any]:
        """Give all figures as a JSON value."""
        figures = to_json(self.flight, self.targets, self.findings)
        figures |= {"farthest_m": self.farthest_m, "wind": self.wind}
        if self.precision is not None and self.survey is not None:
            figures["simulated"] = simulated_adjustment.to_json(self.precision, self.survey)
        return figures

    def __str__(self) -> str:
        """Say it for people."""
        lines = [to_text(self.flight, self.targets, self.findings)]
        if self.wind is not None:
            lines.append(WIND_TEXT.format(**self.wind))
        if self.farthest_m is not None:
            lines.append(f"farthest photo {self.farthest_m:.0f} m from the take-off place")
        if self.precision is not None:
            lines.append(simulated_adjustment.to_text(self.precision))
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
    """Plan a photo flight over a polygon and expect its precision.

    The planned exposures, a net of tie points and the suggested ground points are adjusted as a network
    without errors: its covariance is that of the flight as planned.

    Parameters
    ----------
    area
        Polygon: a file (GeoJSON, KML, or CSV with lat_deg and lon_deg), or an `Area`.
    request
        Camera, height (m), overlaps (shares), speed (m/s) and strips.
    limits
        Wind, range of the radio, class of the product and times of the camera to hold the flight against.
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
    if away is not None and limits.radio_range is not None and away > limits.radio_range:
        figures = {"far_m": away, "range_m": limits.radio_range}
        notes = (*notes, Finding("radio-range", "doubtful", figures=figures))
    # Half a base keeps the points on several photos without leaving the corners.
    layout = suggest_layout(flight.corners_m, asked.control, asked.check, flight.levels[0].base_m / 2.0)
    survey = survey_of(asked) if asked.simulation else None
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


def survey_of(asked: PrecisionOptions) -> PlannedSurvey:
    """Give the precision of the observations in numbers; ConfigurationError for texts that are none."""
    positions = None if asked.gnss_sigma_m is None else _pair(asked.gnss_sigma_m)
    return PlannedSurvey(
        asked.image_sigma_px, _pair(asked.control_sigma_m), positions, asked.calibrate, asked.relief_m
    )


def _pair(text: str) -> tuple[float, float]:
    plane, height = numbers_of(text, "sigma", "PLANE,HEIGHT: metres, write 0.02,0.03")
    if not (plane > 0.0 and height > 0.0):
        raise ConfigurationError(f"a precision of {text} m is not positive", "write 0.02,0.03")
    return plane, height


def _home(text: str) -> Home:
    form = "LAT,LON,HEIGHT: degrees, metres above mean sea level"
    latitude, longitude, height = numbers_of(text, "--home", form)
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise ConfigurationError(f"{text!r} is no place on earth", "latitude comes first")
    return Home(latitude, longitude, height)

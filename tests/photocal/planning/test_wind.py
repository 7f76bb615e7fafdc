"""Strips in wind by the triangle of velocities, a covered border, the range of the radio link."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pyproj import Geod

from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import GeodeticPlace
from photocal.findings.texts import catalogue
from photocal.planning.area import Area
from photocal.planning.flight import FlightRequest, PlannedFlight, plan_flight, planned_camera
from photocal.planning.mission import at_speed, farthest_m, in_wind

AREA = Area(np.array([-28.853, -28.853, -28.849, -28.849]), np.array([-51.294, -51.290, -51.290, -51.294]))
FRAME = planned_camera(8.8, 2.41, (5472, 3648))


def flight_of(azimuth_deg: float, border: float = 0.0) -> PlannedFlight:
    return plan_flight(
        AREA,
        FlightRequest(
            FRAME, 100.0, 0.8, 0.7, speed_m_s=10.0, azimuth_rad=math.radians(azimuth_deg), border_m=border
        ),
    )


def test_fixed_wing_along_and_across_the_wind() -> None:
    """6 m/s along the strips: 16 and 4 m/s over ground; across: 8 m/s with a crab of asin 0.6."""
    along = in_wind(flight_of(0.0), 6.0, 0.0, "fixed-wing")
    assert (along["slowest_m_s"], along["fastest_m_s"]) == pytest.approx((4.0, 16.0))
    assert (along["air_m_s"], along["crab_deg"]) == pytest.approx((10.0, 0.0), abs=1e-6)
    assert (along["overlap_least"], along["overlap_most"]) == pytest.approx((1 - 0.2 * 1.6, 1 - 0.2 * 0.4))
    assert along["interval_s"] == pytest.approx(flight_of(0.0).levels[0].base_m / 16.0)
    across = in_wind(flight_of(90.0), 6.0, 0.0, "fixed-wing")
    assert (across["slowest_m_s"], across["fastest_m_s"]) == pytest.approx((8.0, 8.0))
    assert across["crab_deg"] == pytest.approx(36.8699, abs=1e-4)
    assert "crab up to 37 deg" in catalogue("en").told("planned.wind", **across)


def test_duration_against_every_strip_flown() -> None:
    flight, wind = flight_of(30.0), np.array([-3.0, -4.0])
    found = in_wind(flight, 5.0, math.atan2(3.0, 4.0), "fixed-wing")
    seconds = 0.0
    for strip in flight.strips:
        way = (strip.exposures_m[-1] - strip.exposures_m[0]) / strip.length_m
        # The heading whose velocity through the air, with the wind, follows the strip: by search.
        headings = np.linspace(0.0, 2 * np.pi, 200_001)
        velocity = 10.0 * np.column_stack([np.sin(headings), np.cos(headings)]) + wind
        aside = np.abs(velocity @ [way[1], -way[0]]) + 1e3 * (velocity @ way < 0)
        seconds += strip.length_m / float(velocity[np.argmin(aside)] @ way)
    turns = flight.duration_s - sum(strip.length_m for strip in flight.strips) / 10.0
    assert found["duration_s"] == pytest.approx(seconds + turns, rel=1e-4)


def test_a_multirotor_keeps_its_speed_over_ground() -> None:
    found = in_wind(flight_of(0.0), 6.0, 0.0, "quadrotor")
    assert (found["slowest_m_s"], found["fastest_m_s"]) == (10.0, 10.0)
    assert (found["air_m_s"], found["overlap_least"]) == pytest.approx((16.0, 0.8))
    assert found["duration_s"] == pytest.approx(flight_of(0.0).duration_s)


def test_what_limits_a_camera_is_the_fastest_strip() -> None:
    flight = flight_of(0.0)
    quick = at_speed(flight, in_wind(flight, 6.0, 0.0, "fixed-wing")["fastest_m_s"])
    assert quick.levels[0].exposure_interval_s == pytest.approx(flight.levels[0].base_m / 16.0)
    assert quick.request.speed_m_s == pytest.approx(16.0)


@pytest.mark.parametrize("azimuth", [0.0, 90.0])
def test_wind_that_no_strip_can_be_held_in(azimuth: float) -> None:
    with pytest.raises(ConfigurationError, match="no strip can be held"):
        in_wind(flight_of(azimuth), 12.0, 0.0, "fixed-wing")


def test_a_border_is_covered_like_the_area() -> None:
    """Every place within 80 m of the area is on as many photos as the overlaps promise."""
    flight = flight_of(20.0, border=80.0)
    low, high = flight.corners_m.min(axis=0), flight.corners_m.max(axis=0)
    grid = np.stack(np.meshgrid(*np.linspace(low - 80, high + 80, 60).T), axis=-1).reshape(-1, 2)
    # The area is a rectangle: outside it by no more than the border.
    outside = np.maximum(np.maximum(low - grid, grid - high), 0.0)
    grid = grid[np.hypot(*outside.T) <= 80.0]
    along, across = (
        np.array(v) for v in ((math.sin(0.34906585), math.cos(0.34906585)), (0.9396926, -0.3420201))
    )
    width, length = flight.levels[0].footprint_m

    def least(of: PlannedFlight) -> int:
        apart = grid[:, None] - np.vstack([strip.exposures_m for strip in of.strips])
        seen = (np.abs(apart @ along) <= length / 2 + 1e-6) & (np.abs(apart @ across) <= width / 2 + 1e-6)
        return int(seen.sum(axis=1).min())

    assert least(flight) >= 5
    assert least(flight_of(20.0)) < 5


def test_the_farthest_photo_from_the_take_off_place() -> None:
    flight, home = flight_of(0.0), GeodeticPlace(-28.853, -51.294, 690.0)
    lat, lon = flight.plane.to_degrees(np.vstack([strip.exposures_m for strip in flight.strips]))
    level = [
        Geod(ellps="WGS84").inv(home.longitude_deg, home.latitude_deg, x, y)[2]
        for x, y in zip(lon, lat, strict=True)
    ]
    assert farthest_m(flight, home, 700.0) == pytest.approx(math.hypot(max(level), 110.0), abs=0.01)

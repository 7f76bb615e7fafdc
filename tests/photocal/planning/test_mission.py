from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavwp
from pymavlink.dialects.v20 import ardupilotmega as dialect
from pyproj import Geod
from typer.testing import CliRunner

from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.base.geodesy import GeodeticPlace
from photocal.commands.cli import app
from photocal.planning.area import area_from_corners
from photocal.planning.flight import FlightRequest, PlannedFlight, plan_flight, planned_camera
from photocal.planning.mission import (
    mission_items,
    qgroundcontrol_plan,
    waypoint_file,
)

# Longitude and latitude: the hull of the target field of the Phantom 4 Pro study.
FIELD = [
    (-51.29483, -28.85172),
    (-51.29598, -28.85312),
    (-51.29575, -28.85586),
    (-51.29408, -28.8554),
    (-51.29339, -28.85368),
]
PHANTOM = planned_camera(8.8, 2.41, (5472, 3648))
HOME = GeodeticPlace(-28.8535, -51.2945, 700.0)


@pytest.fixture(scope="module")
def flight() -> PlannedFlight:
    request = FlightRequest(PHANTOM, 100.0, 0.7, 0.6, speed_m_s=8.0, second_height_m=140.0)
    return plan_flight(area_from_corners(list(FIELD), "field"), request)


def test_figures_of_both_heights(flight: PlannedFlight) -> None:
    low, high = flight.levels
    assert low.gsd_m * 100 == pytest.approx(2.7386, abs=5e-5)
    assert high.gsd_m / low.gsd_m == pytest.approx(1.4)
    # Forward overlap along the 3648 rows, side overlap along the 5472 columns.
    assert low.base_m == pytest.approx(0.3 * 3648 * low.gsd_m)
    assert low.strip_spacing_m == pytest.approx(0.4 * 5472 * low.gsd_m)
    assert low.exposure_interval_s == pytest.approx(low.base_m / 8.0)
    assert {strip.height_m for strip in flight.strips} == {100.0, 140.0}


def test_cross_strips_are_at_right_angles(flight: PlannedFlight) -> None:
    def direction(height: float) -> float:
        strip = next(s for s in flight.strips if s.height_m == height)
        east, north = strip.exposures_m[-1] - strip.exposures_m[0]
        return math.atan2(east, north)

    assert math.cos(direction(100.0) - direction(140.0)) == pytest.approx(0.0, abs=1e-9)


def test_strips_run_out_by_half_the_footprint_in_flying_direction(flight: PlannedFlight) -> None:
    """The rows lie along the flight: half of 3648 px, on every strip that touches the area's end."""
    direction = np.array([math.sin(flight.azimuth_rad), math.cos(flight.azimuth_rad)])
    along = flight.corners_m @ direction
    places = np.vstack([s.exposures_m for s in flight.strips if s.height_m == 100.0]) @ direction
    half = 3648 * flight.levels[0].gsd_m / 2.0
    for beyond in (along.min() - places.min(), places.max() - along.max()):
        assert half - 1e-6 <= beyond <= half + flight.levels[0].base_m


def test_text_mission_is_read_by_pymavlink(flight: PlannedFlight, tmp_path: Path) -> None:
    items = mission_items(flight, HOME, 705.0)
    path = tmp_path / "flight.waypoints"
    path.write_text(waypoint_file(items, HOME), encoding="utf-8")
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(path)) == len(items) + 1
    read = [loader.wp(number) for number in range(loader.count())]
    assert (read[0].x, read[0].y, read[0].z) == pytest.approx((HOME.latitude_deg, HOME.longitude_deg, 700.0))
    assert read[1].command == dialect.MAV_CMD_NAV_TAKEOFF
    assert read[-1].command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
    # Ground lies 5 m above the take-off place: 100 m above ground are 105 m above home.
    assert {wp.z for wp in read[1:] if wp.command == dialect.MAV_CMD_NAV_WAYPOINT} == {105.0, 145.0}
    triggers = [wp.param1 for wp in read if wp.command == dialect.MAV_CMD_DO_SET_CAM_TRIGG_DIST]
    assert triggers[0::2] == pytest.approx(
        [strip.length_m / (len(strip.exposures_m) - 1) for strip in flight.strips], rel=1e-6
    )
    assert set(triggers[1::2]) == {0.0}
    # The first photo is taken at once where a strip begins, and none when triggering is switched off.
    at_once = [wp.param3 for wp in read if wp.command == dialect.MAV_CMD_DO_SET_CAM_TRIGG_DIST]
    assert at_once == [1.0, 0.0] * len(flight.strips)


def test_waypoints_lie_where_the_strips_end(flight: PlannedFlight) -> None:
    items = [item for item in mission_items(flight, HOME, 705.0) if item[0] == dialect.MAV_CMD_NAV_WAYPOINT]
    geod = Geod(ellps="WGS84")
    for number, strip in enumerate(flight.strips):
        start, end = (items[2 * number + k][2] for k in range(2))
        assert geod.inv(start[5], start[4], end[5], end[4])[2] == pytest.approx(strip.length_m, abs=0.005)


def test_plan_file_has_the_form_that_qgroundcontrol_documents(flight: PlannedFlight) -> None:
    items = mission_items(flight, HOME, 705.0)
    plan = json.loads(json.dumps(qgroundcontrol_plan(items, HOME, 8.0, "px4", "quadrotor"), allow_nan=False))
    assert (plan["fileType"], plan["version"], plan["groundStation"]) == ("Plan", 1, "QGroundControl")
    mission = plan["mission"]
    assert mission["version"] == 2
    assert (mission["firmwareType"], mission["vehicleType"]) == (12, 2)
    assert mission["plannedHomePosition"] == [HOME.latitude_deg, HOME.longitude_deg, HOME.height_m]
    assert {"cruiseSpeed", "hoverSpeed", "globalPlanAltitudeMode", "items"} <= mission.keys()
    assert [item["doJumpId"] for item in mission["items"]] == list(range(1, len(items) + 1))
    for item in mission["items"]:
        assert item["type"] == "SimpleItem"
        assert len(item["params"]) == 7
        assert item["autoContinue"] is True
        if item["frame"] == 3:
            assert item["Altitude"] == item["params"][6]
            assert item["AltitudeMode"] == 1


def test_missions_that_cannot_be_flown(flight: PlannedFlight) -> None:
    with pytest.raises(ConfigurationError, match="above the take-off place"):
        mission_items(flight, HOME, 580.0)
    items = mission_items(flight, HOME, 705.0)
    with pytest.raises(ConfigurationError, match="autopilot"):
        qgroundcontrol_plan(items, HOME, 8.0, "dji", "quadrotor")


@pytest.fixture
def area(tmp_path: Path) -> Path:
    path = tmp_path / "area.csv"
    path.write_text("lat_deg,lon_deg\n" + "".join(f"{lat},{lon}\n" for lon, lat in FIELD), encoding="utf-8")
    return path


CAMERA = ["--focal-mm", "8.8", "--pixel-um", "2.41", "--image-px", "5472x3648"]


def test_plan_command_writes_everything(area: Path, tmp_path: Path) -> None:
    output = tmp_path / "plan"
    options = [
        "--gsd-cm",
        "2.74",
        "--second-height",
        "130",
        "--exposure-ms",
        "10",
        "--shortest-interval",
        "5",
    ]
    takeoff = ["--home", "-28.8535,-51.2945,700", "--ground-height", "705", "--scale", "1:1000"]
    result = CliRunner().invoke(
        app, ["plan", str(area), "-o", str(output), *CAMERA, *options, *takeoff, "--json"]
    )
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["schema"] == "photocal.plan/1"
    assert figures["levels"][0]["height_m"] == pytest.approx(100.05, abs=0.005)
    assert {finding["code"] for finding in figures["findings"]} == {"smear", "interval-too-short"}
    budget = figures["error_budget_m"]["planimetry, class A, 1:1000"]
    assert budget["control points"] == pytest.approx(0.17 / 9)
    assert {path.name for path in output.iterdir()} == {
        "plan.json",
        "exposures.csv",
        "plan.geojson",
        "flight.plan",
        "flight.waypoints",
    }
    exposures = list(csv.DictReader(io.StringIO((output / "exposures.csv").read_text(encoding="utf-8"))))
    assert len(exposures) == figures["exposures"]
    kinds = [
        feature["properties"]["kind"]
        for feature in json.loads((output / "plan.geojson").read_text(encoding="utf-8"))["features"]
    ]
    assert kinds.count("strip") == figures["strips"]
    assert (kinds.count("control"), kinds.count("check")) == (8, 30)


def test_plan_command_says_that_no_mission_was_written(area: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app, ["plan", str(area), "-o", str(tmp_path / "p"), *CAMERA, "--height", "100"]
    )
    assert result.exit_code == 0, result.output
    assert "no mission written" in result.output
    assert "does not separate the principal distance" in result.output
    assert not (tmp_path / "p" / "flight.plan").exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--height", "100", "--gsd-cm", "3"],
        [],
        ["--height", "-5"],
        ["--height", "nan"],
        # A pixel in millimetres, a focal length in metres; latitude and longitude of the home exchanged.
        ["--gsd-cm", "3", "--pixel-um", "0.00241"],
        ["--gsd-cm", "3", "--focal-mm", "0.0088"],
        ["--height", "100", "--home", "-51.2945,-28.8535,700", "--ground-height", "705"],
        ["--gsd-cm", "0"],
        ["--height", "100", "--forward", "80"],
        ["--height", "100", "--speed", "0"],
        ["--height", "100", "--home", "-28,-51,700"],
        ["--height", "100", "--home", "x", "--ground-height", "1"],
        ["--height", "100", "--home", "-151,-28,700", "--ground-height", "700"],
        ["--height", "100", "--image-px", "5472"],
        ["--height", "100", "--control", "2"],
        ["--height", "100", "--scale", "1:1000", "--class", "Z"],
        ["--height", "100", "--scale", "1:1000", "--standard", "asprs-2024"],
    ],
)
def test_wrong_options_leave_nothing_behind(area: Path, tmp_path: Path, options: list[str]) -> None:
    output = tmp_path / "plan"
    result = CliRunner().invoke(app, ["plan", str(area), "-o", str(output), *CAMERA, *options])
    assert isinstance(result.exception, PhotocalError), result.output
    assert "\n" not in str(result.exception)
    assert not output.exists()


def test_positions_of_exposures_keep_their_distance(flight: PlannedFlight) -> None:
    strip = flight.strips[0]
    latitude, longitude = flight.plane.to_degrees(strip.exposures_m)
    steps = Geod(ellps="WGS84").inv(longitude[:-1], latitude[:-1], longitude[1:], latitude[1:])[2]
    assert np.asarray(steps) == pytest.approx(np.full(len(steps), flight.levels[0].base_m), abs=1e-4)

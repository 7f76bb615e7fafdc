"""The planned line: places of a mission as ground stations write it, and none of what is no place."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquire.monitor.planned import covered, planned_footprint, planned_line
from acquire.monitor.state import RecordingState, Track
from acquire.monitor.view_model import layers
from photocal.base.errors import InputMalformedError, InputNotFoundError

# As the definition of the format has it: index, current, frame, command, four parameters, place, on.
HOME = "0\t1\t0\t16\t0\t0\t0\t0\t-22.7\t-43.2\t30.0\t1"
MISSION = [
    HOME,
    "1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t60.000\t1",
    "2\t0\t3\t16\t0\t0\t0\t0\t-22.70100000\t-43.20200000\t60.000\t1",
    "3\t0\t2\t206\t12.5\t0\t1\t0\t0\t0\t0\t1",
    "4\t0\t3\t16\t0\t0\t0\t0\t-22.70300000\t-43.20200000\t60.000\t1",
    "5\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1",
]


def test_places_are_read_and_home_orders_and_return_are_not(tmp_path: Path) -> None:
    path = tmp_path / "flight.waypoints"
    path.write_text("\n".join(["QGC WPL 110", *MISSION]) + "\n")
    np.testing.assert_array_equal(planned_line(path), [[-22.701, -43.202], [-22.703, -43.202]])


@pytest.mark.parametrize(
    "text", ["", "QGC WPL 120\n", "QGC WPL 110\n1\t0\n", "QGC WPL 110\na b c d e f g h i j\n"]
)
def test_what_is_no_mission_is_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / "flight.waypoints"
    path.write_text(text)
    with pytest.raises(InputMalformedError):
        planned_line(path)
    with pytest.raises(InputNotFoundError):
        planned_line(tmp_path / "none.waypoints")


def flown(bearing_deg: float, seconds: int) -> Track:
    """A straight flight of 10 m/s from the equator: a degree is 111 319.5 m to the east, 110 574 m north."""
    along = 10.0 * np.arange(seconds)
    course = np.radians(bearing_deg)
    places = np.column_stack([along * np.cos(course) / 110574.0, along * np.sin(course) / 111319.5])
    return Track(places, 10**9 * np.arange(seconds))


@pytest.mark.parametrize(("bearing_deg", "east_m", "north_m"), [(0, 50, 30), (90, 30, 50), (180, 50, 30)])
def test_pictures_cover_their_footprint_along_the_course(
    bearing_deg: float, east_m: float, north_m: float
) -> None:
    track = flown(bearing_deg, 60)
    rows = np.array([0, 20, 40])
    pictures = Track(track.points[rows], track.times_ns[rows])
    corners = covered(pictures, track, (30.0, 50.0)).reshape(-1, 4, 2)
    # The first was taken before the vehicle had gone anywhere.
    assert len(corners) == 2
    for ring, place in zip(corners, pictures.points[1:], strict=True):
        offsets = (ring - place) * [110574.0, 111319.5]
        assert np.ptp(offsets, axis=0) == pytest.approx([north_m, east_m], rel=0.01)
        assert offsets.mean(axis=0) == pytest.approx([0.0, 0.0], abs=0.01)


def test_coverage_is_drawn_where_a_plan_tells_what_a_picture_covers(tmp_path: Path) -> None:
    mission, plan = tmp_path / "flight.waypoints", tmp_path / "plan.json"
    assert planned_footprint(mission) is None
    level = {"height_m": 80.0, "footprint_m": [120.0, 80.0]}
    other = {"height_m": 120.0, "footprint_m": [180.0, 120.0]}
    plan.write_text(json.dumps({"levels": [other, level], "along": "rows"}))
    footprint = planned_footprint(mission)
    assert footprint == (80.0, 120.0)
    plan.write_text(json.dumps({"levels": [level], "along": "columns"}))
    assert planned_footprint(mission) == (120.0, 80.0)
    track = flown(90, 30)
    pictures = {("vehicle", "feedback"): Track(track.points[10:], track.times_ns[10:])}
    state = RecordingState(tracks={"vehicle/position": track}, pictures=pictures)
    assert [layer.kind for layer in layers(state)] == ["track", "picture"]
    (cover,) = [layer for layer in layers(state, footprint) if layer.kind == "coverage"]
    assert (cover.name, len(cover.points)) == ("vehicle", 4 * 20)

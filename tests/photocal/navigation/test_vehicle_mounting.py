"""The project's rig against the parameters of the vehicle: agreement, contradiction, and what is offered."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquire.channels.layouts import PARAMETER
from acquire.channels.mounting import AutopilotMounting
from acquire.log.chunk import Channel
from acquire.log.writer import LogWriter
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.rig import CameraOnBody, camera_axes, check_mounting
from photocal.navigation.vehicle import read_vehicle
from tests.photocal.findings.english import english

ANTENNA = (0.10, -0.05, -0.30)
SIGMAS = np.radians([0.5, 0.5, 1.0])


def rig(*lever: float, axes: tuple[str, ...] = ("right", "forward", "up")) -> CameraOnBody:
    return CameraOnBody(np.array(lever), np.full(3, 0.01), SIGMAS, axes=camera_axes(axes))


def test_a_camera_near_the_origin_agrees() -> None:
    (check,) = check_mounting(rig(0.06, -0.05, -0.42), AutopilotMounting((), ANTENNA))
    assert check.severity == "passed"
    assert "the camera is at (+0.040, +0.000, +0.120) m" in english(check)


@pytest.mark.parametrize("lever", [(0.10, -0.05, 0.70), (0.60, -0.05, -0.30), (-0.30, -0.05, -1.30)])
def test_a_contradiction_is_told(lever: tuple[float, float, float]) -> None:
    (check,) = check_mounting(rig(*lever), AutopilotMounting((), ANTENNA))
    assert check.severity == "doubtful"
    assert "(+0.100, -0.050, -0.300) m forward, right, down of the body's origin" in english(check)
    assert "other sign" not in english(check)


def test_a_lever_arm_the_other_way_round_is_named() -> None:
    (check,) = check_mounting(rig(-0.10, 0.05, 0.40), AutopilotMounting((), ANTENNA))
    assert check.severity == "doubtful"
    assert "with the other sign they agree" in english(check)


def test_an_antenna_is_offered_where_the_project_has_none() -> None:
    (check,) = check_mounting(CameraOnBody(), AutopilotMounting((), ANTENNA))
    assert check.severity == "note"
    assert "camera_to_antenna_m of [rig], with a sigma of 0.1 m" in english(check)
    assert check_mounting(CameraOnBody(), AutopilotMounting(())) == []


def test_a_mount_that_looks_elsewhere_is_told() -> None:
    down, oblique = (
        AutopilotMounting((), None, (0.0, -90.0, 0.0)),
        AutopilotMounting((), None, (0.0, -45.0, 0.0)),
    )
    nadir, ahead = rig(0, 0, 0), rig(0, 0, 0, axes=("right", "up", "backward"))
    assert [check_mounting(nadir, mount)[0].severity for mount in (down, oblique)] == ["passed", "doubtful"]
    assert check_mounting(ahead, down)[0].figures["apart_deg"] == pytest.approx(90.0)
    assert check_mounting(ahead, AutopilotMounting((), None, (5.0, 1.0, 0.0)))[0].severity == "passed"


def test_parameters_come_from_the_log(tmp_path: Path) -> None:
    """The last value of a parameter stands."""
    log = tmp_path / "flight.mcap"
    told = [("GPS1_POS_X", 9.0), ("GPS1_POS_X", 0.1), ("GPS1_POS_Y", -0.05), ("GPS1_POS_Z", -0.3)]
    rows = [json.dumps({"name": name, "value": value}).encode() for name, value in told]
    times = np.arange(len(rows), dtype=np.int64)
    with log.open("xb") as file:
        writer = LogWriter(file)
        channel = Channel("/vehicle/parameter", "json", PARAMETER.schema())
        writer.messages(channel, rows, times, times, times)
        writer.close()
    mounting = read_vehicle(FlightLog((log,))).mounting
    assert mounting.camera_to_antenna_m == ANTENNA
    (check,) = check_mounting(rig(0.10, -0.05, 0.5), mounting)
    assert check.severity == "doubtful"

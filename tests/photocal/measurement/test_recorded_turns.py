"""Records of a gyroscope in pictures: read, turned into motion, and what they do for a shaken flight."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.adjustment.adjust import adjust
from photocal.geometry.camera import MOTION, PARAMETERS, SHAKE
from photocal.measurement.image_facts import recorded_turns, turns_while_read
from tests.photocal import flights

Floats = NDArray[np.float64]


def packet(rate: Floats, step_us: int = 1000) -> str:
    """XMP with a record of rates about the axes of the unit: ahead, right, down."""
    rows = np.zeros(len(rate), [("time", "<u8"), ("rate", "<f4", 3), ("rest", "<u4")])
    rows["time"], rows["rate"] = 5_000_000 + step_us * np.arange(len(rate)), rate
    return f'<x Camera:IMUAngularVelocity="&#xA;{base64.b64encode(rows.tobytes()).decode()}"/>'


def test_axes_and_times_are_those_of_the_camera() -> None:
    """A roll to the right turns a camera that looks down about the axis that points ahead in its picture."""
    roll, yaw = recorded_turns(packet(np.tile([0.3, 0.0, -0.2], (50, 1))), 1e7)[0, [2, 3]]
    assert (roll, yaw) == (pytest.approx(0.3), pytest.approx(0.2))
    later, earlier = (recorded_turns(packet(np.zeros((50, 3))), offset)[:, 0] for offset in (0.0, 1e7))
    assert np.diff(earlier) == pytest.approx(np.full(49, 1e-3))
    assert later - earlier == pytest.approx(np.full(50, 0.01))


@pytest.mark.parametrize(
    "text",
    ["", '<x Camera:IMUAngularVelocity="###"/>', '<x Camera:IMUAngularVelocity="AAAA"/>'],
    ids=["none", "no base64", "no record"],
)
def test_what_is_no_record_gives_none(text: str) -> None:
    assert recorded_turns(text, 0.0).shape == (0, 4)


def test_damaged_records_give_none() -> None:
    assert not len(recorded_turns(packet(np.full((20, 3), np.nan)), 0.0))
    assert not len(recorded_turns(packet(np.full((20, 3), 1e9)), 0.0))
    assert not len(recorded_turns(packet(np.zeros((20, 3)), step_us=0), 0.0))
    assert not len(recorded_turns(packet(np.zeros((20, 3))), np.nan))


def test_a_rate_that_grows_is_a_straight_turn_and_a_parabola() -> None:
    """A rate a + b t/T gives T (a s + b s^2 / 2), and s^2 = (2 P2(2s) + 1) / 12."""
    readout, mean, growth = 0.16, np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.4, -0.6])
    time = np.linspace(-0.05, 0.25, 301)
    record = np.column_stack([time, mean + growth * (time / readout - 0.5)[:, None]])
    turns = turns_while_read(record, readout).reshape(-1, 3)
    assert turns[0] == pytest.approx(-mean, abs=1e-6)
    assert turns[1] == pytest.approx(-growth / 12, abs=1e-4)
    assert turns[2:] == pytest.approx(np.zeros((len(turns) - 2, 3)), abs=1e-6)


def test_recorded_vibration_explains_what_the_lines_show() -> None:
    """The simulated flight that spoils a camera where images may not shake, with what its gyroscope says."""
    readout_s, seed = 0.03, 1
    truth, network = flights.case(
        "attitudes", seed, readout_s=readout_s, sigma_px=0.1, vibration_deg=0.01, images=20, points=300
    )
    assert truth.vibration is not None
    record = np.linspace(0.0, readout_s, 61)
    motion = []
    for k, taken in enumerate(truth.time):
        moment, step = taken - readout_s / 2 + record, 1e-6
        change = truth.vibration.at(moment + step) - truth.vibration.at(moment - step)
        # What is seen turns against the camera.
        rate = -(truth.rate[k] + change / (2 * step))
        motion.append(turns_while_read(np.column_stack([record, rate]), readout_s))
    given = network.exposures.motion
    assert given is not None
    rolling = replace(network.cameras[0].changed(readout=readout_s), shutter="rolling")
    network = replace(network, cameras=(replace(rolling, estimated=_with_readout(rolling.estimated)),))
    steady = adjust(network)
    recorded = np.hstack([given[:, :3], np.array(motion)])
    assert recorded.shape[1] == len(MOTION + SHAKE)
    network = replace(network, exposures=replace(network.exposures, motion=recorded))
    solution = adjust(network)
    assert steady.variance_factor > 2.0
    assert 0.9 < solution.variance_factor < 1.1
    errors = flights.standardised(truth, network, solution)
    assert "readout" in errors
    assert max(abs(error) for error in errors.values()) < 3.3, errors


def _with_readout(estimated: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(estimated | (np.array(PARAMETERS) == "readout"))

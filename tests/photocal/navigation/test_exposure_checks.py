"""Checks in the summary of exposures: each mistake is caught where it can be, and only then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from photocal.base.geodesy import enu_axes, geocentric, geodetic
from photocal.findings.finding import Finding
from photocal.navigation.attitude import from_angles
from photocal.navigation.events import Events
from photocal.navigation.exposure_checks import Evidence, check_exposures
from photocal.navigation.exposures import Exposures, at_camera, at_events
from photocal.navigation.position_comparison import judge_positions
from photocal.navigation.ppk_result import BaseFigures, PpkFigures
from photocal.navigation.receiver_recording import ReceiverRecording
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.time import GpsTime, HostTime
from photocal.navigation.trajectory import Trajectory, interpolate
from photocal.navigation.vehicle import VehicleTrack, path_of
from tests.photocal.findings.english import english

Floats = NDArray[np.float64]
ORIGIN = np.array([-25.45, -49.23, 950.0])
AXES = enu_axes(ORIGIN[0], ORIGIN[1])
CENTRE = geocentric(ORIGIN[None, 0], ORIGIN[None, 1], ORIGIN[None, 2])[0]
LEVER = np.array([0.10, 0.0, 0.35])
SIGMAS = np.radians([0.5, 0.5, 1.0])
SPEED, GEOID = 7.0, 25.0


def flight() -> tuple[Floats, Floats, Floats]:
    """Times, antenna (east, north, up) and headings of six strips to and fro, two of them across."""
    times, places, headings = [], [], []
    t = 0.0
    for strip in range(6):
        across = strip >= 4
        heading = (0.0 if strip % 2 == 0 else np.pi) + (np.pi / 2 if across else 0.0)
        ahead = np.array([np.sin(heading), np.cos(heading), 0.0])
        side = np.array([np.cos(heading), -np.sin(heading), 0.0])
        for k in range(101):
            along = SPEED * (k / 5 - 10)
            bend = 2.0 * np.sin(k / 9) * np.array([0.0, 0.0, 1.0])
            places.append(along * ahead + 12.0 * (strip - 2.5) * side * (1 if strip % 2 == 0 else -1) + bend)
            times.append(t + k / 5)
            headings.append(heading)
        t += 40.0
    return np.array(times), np.array(places), np.array(headings)


def trajectory(up_m: float = 0.0) -> Trajectory:
    times, places, _ = flight()
    n = len(times)
    velocity = np.zeros((n, 3))
    for strip in range(6):
        rows = slice(101 * strip, 101 * (strip + 1))
        velocity[rows] = np.gradient(places[rows], times[rows], axis=0)
    lat, lon, height = geodetic((places + np.array([0.0, 0.0, up_m])) @ AXES + CENTRE)
    covariance = np.broadcast_to(np.eye(3) * 1e-4, (n, 3, 3))
    time = GpsTime.from_week(np.full(n, 2370), 1000 + times)
    return Trajectory(time, lat, lon, height, np.full(n, "fixed"), covariance, velocity, 0.05)


def shots(path: Trajectory, late_s: float = 0.0) -> tuple[Exposures, Events]:
    """Exposures at the antenna, each two seconds, whose stamps are too early by `late_s`."""
    times, _, headings = flight()
    chosen = np.arange(3, len(times) - 3)
    chosen = chosen[(chosen % 101 > 2) & (chosen % 101 < 98) & (chosen % 10 == 3)]
    n = len(chosen)
    stamp = GpsTime.from_week(np.full(n, 2370), 1000 + times[chosen] + 0.08 - late_s)
    rng = np.random.default_rng(4)
    angles = np.column_stack([rng.normal(0, np.radians(2), (n, 2)), headings[chosen]])
    events = Events("TIM-TM2 rising of rover", stamp, np.arange(n), np.zeros(n))
    placed = interpolate(path, stamp, np.zeros(n))
    made = at_events(events, placed, from_angles(angles, SIGMAS), np.zeros(n), [()] * n, "ellipsoidal")
    return made, events


def seen_by_images(noise_m: float = 0.02) -> Floats:
    """Projection centres in a frame of their own: turned, scaled, shifted, with noise."""
    camera = at_camera(shots(trajectory())[0], CameraOnBody(LEVER, np.zeros(3), SIGMAS)).placed
    place = (camera.xyz_m - CENTRE) @ AXES.T
    place = place + np.random.default_rng(5).normal(0, noise_m, place.shape)
    turn = enu_axes(40.0, 130.0)
    return np.asarray(1.003 * place @ turn.T + [500.0, -200.0, 30.0])


def judged(late_s: float = 0.0, lever: Floats = LEVER) -> Finding:
    rig = CameraOnBody(lever, np.full(3, 0.01), SIGMAS)
    ours = at_camera(shots(trajectory(), late_s)[0], rig)
    return judge_positions("positions of the adjusted images", ours, seen_by_images(), rig, "similarity")


def test_a_right_flight_passes() -> None:
    check = judged()
    assert check.severity == "passed", english(check)
    # The lever arm's centimetre is 1.4 ms of flight.
    assert check.figures["detectable_time_offset_s"] < 0.017 / 2
    assert max(check.figures["rms_enu_m"]) < 0.03


def test_17_ms_at_7_m_s() -> None:
    check = judged(late_s=0.017)
    assert (check.severity, check.code) == ("grave", "time-offset")
    assert check.figures["value"][0] == pytest.approx(0.017, abs=0.003)
    assert "later than stamped" in english(check)


def test_swapped_axes_of_the_lever_arm() -> None:
    # Forward and down exchanged: 0.35 m ahead instead of 0.10 m.
    check = judged(lever=LEVER[[2, 1, 0]])
    assert check.severity == "grave"
    assert "lever-arm-axes" in (check.code, *check.figures["as_good"])
    assert "lever arm" in english(check)
    # The lever arm itself is known to some centimetres only: named all the same.
    check = judged(lever=LEVER[[2, 1, 0]] + [0.02, -0.03, 0.02])
    assert check.severity == "grave"
    assert "Axes" in english(check)


def test_a_wrong_sign_of_the_lever_arm_across() -> None:
    # Across the flight no time offset can stand for it.
    lever = np.array([0.1, 0.3, 0.35])
    rig = CameraOnBody(lever * [1, -1, 1], np.full(3, 0.01), SIGMAS)
    ours = at_camera(shots(trajectory())[0], rig)
    truth = at_camera(shots(trajectory())[0], CameraOnBody(lever, np.zeros(3), SIGMAS)).placed
    place = (truth.xyz_m - CENTRE) @ AXES.T
    place = place + np.random.default_rng(6).normal(0, 0.02, place.shape)
    check = judge_positions("images", ours, np.asarray(place), rig, "similarity")
    assert (check.severity, check.code) == ("grave", "lever-arm-axes")
    assert "+0.100 forward, +0.300 right, +0.350 down" in english(check)


def test_false_alarms_are_rare() -> None:
    rig = CameraOnBody(LEVER, np.full(3, 0.01), SIGMAS)
    ours = at_camera(shots(trajectory())[0], rig)
    p = ours.placed
    place = (p.xyz_m - CENTRE) @ AXES.T
    rng = np.random.default_rng(7)
    failed = sum(
        judge_positions("x", ours, place + rng.normal(0, 0.02, place.shape), rig, "similarity").severity
        == "grave"
        for _ in range(100)
    )
    assert failed <= 1


def test_positions_that_wander_are_no_lever_arm() -> None:
    """A receiver's own solution is off by a metre that comes and goes in half a minute."""
    rig = CameraOnBody(LEVER, np.full(3, 0.01), SIGMAS)
    ours = at_camera(shots(trajectory())[0], rig)
    p = ours.placed
    there = np.column_stack([p.lat_deg, p.lon_deg, p.height_m])
    seconds = np.diff(ours.time.ns.astype(float), prepend=0.0) / 1e9
    keep = np.exp(-seconds / 30.0)[:, None]
    metre_in_deg = np.array([1 / 110_900.0, 1 / 100_600.0, 1.0])
    rng = np.random.default_rng(8)
    failed = 0
    for _ in range(100):
        kicks = rng.normal(0.0, [1.0, 1.0, 2.0], there.shape) * np.sqrt(1 - keep**2)
        wander = np.zeros_like(there)
        for k in range(len(there)):
            wander[k] = keep[k] * wander[k - 1] + kicks[k]
        check = judge_positions("x", ours, there + wander * metre_in_deg, rig, "shift")
        failed += check.severity == "grave"
    assert failed <= 2


def evidence(path: Trajectory, late_s: float = 0.0, **changed: object) -> Evidence:
    """A flight with an autopilot that knows its height above sea level to a metre or two."""
    exposures, events = shots(path)
    truth = trajectory()
    rng = np.random.default_rng(8)
    n = len(truth)
    late = GpsTime(truth.time.ns - round(late_s * 1e9))
    place = rng.normal(0, 0.3, (n, 2)) / 1.1e5
    height = truth.height_m - GEOID + rng.normal(1.5, 0.5, n)
    path_of_vehicle = path_of(late, (truth.lat_deg + place[:, 0], truth.lon_deg + place[:, 1], height))
    vehicle = VehicleTrack(path_of_vehicle, HostTime(late.ns), None)
    rover = ReceiverRecording("rover", geoid_m=[GEOID + 0.7])
    ppk = PpkFigures(100.0, BaseFigures(1.0))
    made = Evidence(CameraOnBody(), events, exposures, path, rover, vehicle, None, [], ppk)
    return replace(made, **changed)  # type: ignore[arg-type]


def verdict(made: Evidence, code: str) -> Finding:
    return next(check for check in check_exposures(made) if check.code == code)


def test_orthometric_heights_declared_ellipsoidal() -> None:
    assert verdict(evidence(trajectory()), "height-kind").severity == "passed"
    # The base's height given above sea level: the whole trajectory is lower by the geoid's height.
    low = evidence(trajectory(-GEOID), ppk=PpkFigures(100.0, BaseFigures(1.0 - GEOID)))
    check = verdict(low, "height-kind")
    assert check.severity == "grave"
    assert "orthometric, not ellipsoidal" in english(check)
    flat = evidence(trajectory(), rover=ReceiverRecording("rover", geoid_m=[2.0]))
    assert verdict(flat, "height-kind").severity == "untested"


def test_clock_of_the_autopilot() -> None:
    assert verdict(evidence(trajectory()), "autopilot-clock").severity == "passed"
    check = verdict(evidence(trajectory(), late_s=0.2), "autopilot-clock")
    assert check.severity == "grave"
    assert check.figures["late_s"] == pytest.approx(0.2, abs=0.03)


def test_no_clock_is_blamed_for_positions_that_wander() -> None:
    """What is less than would surely show proves nothing: 2.5 m of error that last for 20 s."""
    made = evidence(trajectory())
    path, keep = trajectory(), 0.99
    spared = 0
    for seed in range(20):
        steps = np.random.default_rng(seed).normal(0, np.sqrt(1 - keep**2), (len(path) + 500, 2))
        wander = lfilter([1.0], [1.0, -keep], steps, axis=0)[500:] * 2.5 / 1.1e5
        lat, lon = path.lat_deg + wander[:, 0], path.lon_deg + wander[:, 1]
        assert made.vehicle is not None
        vehicle = replace(made.vehicle, path=replace(made.vehicle.path, lat_deg=lat, lon_deg=lon))
        check = verdict(replace(made, vehicle=vehicle), "autopilot-clock")
        surely = abs(check.figures["late_s"]) > check.figures["detectable_s"]
        assert (check.severity == "grave") == surely
        spared += not surely and abs(check.figures["late_s"]) > 0.05
    assert spared >= 1


@pytest.mark.parametrize(("off_s", "expected"), [(0.0, "passed"), (-18.0, "grave"), (18.0, "grave")])
def test_time_base_of_the_marks(off_s: float, expected: str) -> None:
    path = trajectory()
    _, events = shots(path)
    stream = events.time.ns - 150_000_000 - round(off_s * 1e9)
    marked = replace(events, stream_ns=stream).delayed(0.004)
    check = verdict(evidence(path, events=marked), "event-time-base")
    assert check.severity == expected
    assert ("leap seconds" in english(check)) == (expected == "grave")


def test_what_cannot_be_seen_is_said() -> None:
    made = evidence(trajectory(), trajectory=None, rig=CameraOnBody(LEVER, np.zeros(3), SIGMAS))
    said = {check.code: check for check in check_exposures(made)}
    assert said["antenna-height"].severity == "untested"
    assert "control points" in english(said["antenna-height"])
    assert said["boresight"].severity == "untested"
    assert english(said["height-kind"]) == "No PPK trajectory."

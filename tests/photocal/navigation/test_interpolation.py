"""Positions between epochs: exact where they must be, and as uncertain as they claim."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.base.geodesy import enu_axes, enu_offsets, geocentric, geodetic
from photocal.navigation.events import RISING, time_marks
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.receiver_recording import read_receivers
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import Trajectory, interpolate, left_out, roughness
from tests.photocal.navigation.conftest import Run

ORIGIN = np.array([53.28, -8.98, 90.0])
Floats = NDArray[np.float64]


def covariance_of_cells(cells: list[float]) -> Floats:
    """Return the covariance matrix, the inverse of `covariance_cells`."""
    se, sn, su, sen, seu, snu = cells
    en, eu, nu = (np.sign(v) * v**2 for v in (sen, seu, snu))
    return np.array([[se**2, en, eu], [en, sn**2, nu], [eu, nu, su**2]])


def path_of(local: Floats, velocity: Floats, seconds: Floats, sigma: float = 0.01) -> Trajectory:
    centre = geocentric(ORIGIN[None, 0], ORIGIN[None, 1], ORIGIN[None, 2])
    lat, lon, height = geodetic(local @ enu_axes(ORIGIN[0], ORIGIN[1]) + centre)
    n = len(local)
    time = GpsTime.from_week(np.full(n, 2022), 1000.0 + seconds)
    covariance = np.broadcast_to(np.eye(3) * sigma**2, (n, 3, 3))
    return Trajectory(time, lat, lon, height, np.full(n, "fixed"), covariance, velocity, 0.05)


def test_a_cubic_path_is_met_exactly() -> None:
    t = np.arange(30.0)
    local = np.stack([5 * t, 0.3 * t**2, 0.01 * t**3 - 2 * t], axis=1)
    velocity = np.stack([np.full(30, 5.0), 0.6 * t, 0.03 * t**2 - 2], axis=1)
    path = path_of(local, velocity, t)
    s = np.array([3.3, 11.75, 28.999])
    found = interpolate(path, GpsTime.from_week(np.full(3, 2022), 1000 + s), np.zeros(3), np.zeros((3, 3)))
    expected = np.stack([5 * s, 0.3 * s**2, 0.01 * s**3 - 2 * s], axis=1)
    met = enu_offsets(found.lat_deg, found.lon_deg, found.height_m, ORIGIN)
    assert np.abs(met - expected).max() < 1e-4
    assert np.abs(found.velocity_m_s[:, 1] - 0.6 * s).max() < 1e-3


def test_gaps_and_ends_are_not_placed() -> None:
    t = np.array([0.0, 1.0, 2.0, 5.0, 6.0])
    path = path_of(np.zeros((5, 3)), np.zeros((5, 3)), t)
    at = GpsTime.from_week(np.full(4, 2022), 1000 + np.array([-0.5, 1.5, 3.0, 6.5]))
    found = interpolate(path, at, np.zeros(4), np.zeros((4, 3)))
    assert found.placed.tolist() == [False, True, False, False]
    assert found.gap_s[2] == pytest.approx(3.0)
    assert np.isinf(found.gap_s[0])


def test_time_errors_lie_along_the_path() -> None:
    t = np.arange(10.0)
    path = path_of(np.outer(t, [7.0, 0, 0]), np.tile([7.0, 0, 0], (10, 1)), t)
    at = GpsTime.from_week([2022], [1004.5])
    found = interpolate(path, at, np.array([0.017]), np.zeros((1, 3)))
    # 17 ms at 7 m/s are 119 mm.
    assert np.sqrt(found.covariance_m2[0, 0, 0]) == pytest.approx(np.hypot(0.119, 0.01), rel=1e-3)
    assert found.covariance_m2[0, 1, 1] == pytest.approx(1e-4, rel=1e-3)


def test_claimed_sigma_on_a_simulated_path() -> None:
    # Acceleration as white noise between the epochs; the sigma is learnt at 2 s and judged at 1 s.
    rng = np.random.default_rng(3)
    step, n = 0.01, 60_000
    speed = np.cumsum(rng.normal(0, 0.4 * np.sqrt(step), (n, 3)), axis=0)
    place = np.cumsum(speed, axis=0) * step
    epochs = np.arange(0, n, 100)
    path = path_of(place[epochs], speed[epochs], np.asarray(epochs * step, np.float64))
    path = path.rows(np.arange(len(path)))
    middle = epochs[:-1] + 50
    at = GpsTime.from_week(np.full(len(middle), 2022), 1000 + middle * step)
    found = interpolate(path, at, np.zeros(len(middle)))
    met = enu_offsets(found.lat_deg, found.lon_deg, found.height_m, ORIGIN)
    own = np.sqrt(found.covariance_m2[:, 0, 0] - 1e-4)
    assert 0.8 < np.std((met - place[middle])[:, 0] / own) < 1.25


@pytest.mark.shared
def test_left_out_epochs_of_the_moving_rover(moving_run: Run) -> None:
    trials = left_out(recorded(moving_run))
    assert len(trials[2]) > 200
    # Learnt on every other epoch, judged on the rest.
    time, error_m, gap_s = trials
    sigma = roughness((time[::2], error_m[::2], gap_s[::2]), time[1::2]) * gap_s[1::2, None] ** 1.5
    normalised = error_m[1::2] / sigma
    assert (np.abs(np.sqrt(np.mean(normalised**2, axis=0)) - 1) < 0.3).all()


@pytest.mark.shared
def test_every_edge_is_placed_or_named(moving_run: Run) -> None:
    rising = time_marks(read_receivers(FlightLog((moving_run.log,)))["rover"].marks(), RISING, "rover")
    found = interpolate(recorded(moving_run), rising.time, rising.accuracy_s)
    assert found.placed.sum() >= 530
    assert (found.gap_s[found.placed] <= 1.5).all()
    # 18 s off, as with the wrong time base, the rover is elsewhere: the mistake would show.
    wrong = interpolate(recorded(moving_run), GpsTime(rising.time.ns - 18_000_000_000), rising.accuracy_s)
    both = found.placed & wrong.placed
    apart = enu_offsets(found.lat_deg[both], found.lon_deg[both], found.height_m[both], ORIGIN)
    apart = apart - enu_offsets(wrong.lat_deg[both], wrong.lon_deg[both], wrong.height_m[both], ORIGIN)
    assert np.percentile(np.hypot(apart[:, 0], apart[:, 1]), 75) > 1.0


def recorded(run: Run) -> Trajectory:
    """The trajectory as written, without velocities."""
    time = np.array([int(row["time_gps_ns"]) for row in run.rows], np.int64)
    cells = [[float(row[name]) for name in ("se", "sn", "su", "sen", "seu", "snu")] for row in run.rows]
    return Trajectory(
        GpsTime(time),
        run.column("lat_deg"),
        run.column("lon_deg"),
        run.column("height_m"),
        np.array([row["status"] for row in run.rows]),
        np.array([covariance_of_cells(c) for c in cells]),
        np.full((len(time), 3), np.nan),
        0.1,
    )

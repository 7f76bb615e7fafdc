"""Covariances of exposures against a Monte Carlo simulation that goes another way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from photocal.exchange.ground_points import read_geo
from photocal.geometry.rotation import NADIR, angles_from_matrix, matrix_from_angles
from photocal.navigation.attitude import (
    AttitudeTrack,
    at_instants,
    left_out_turns,
    no_attitudes,
    rotations_of_quaternions,
)
from photocal.navigation.events import Events
from photocal.navigation.exposure_files import write_block_images, write_geo_txt
from photocal.navigation.exposures import Exposures, at_camera, at_events, orientations, orientations_in_frame
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import interpolate
from tests.photocal.navigation.test_interpolation import path_of

Floats = NDArray[np.float64]
# Intrinsic yaw, pitch, roll from body to north, east, down, in scipy's own words; to east, north, up.
NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
LEVER, LEVER_SIGMA = np.array([0.6, -0.3, 0.4]), np.array([0.02, 0.03, 0.01])
ANGLE_SIGMA = np.radians([1.0, 1.5, 2.0])
BORESIGHT, BORESIGHT_SIGMA = np.radians([2.0, -3.0, 10.0]), np.radians([0.3, 0.2, 0.4])
TIME_SIGMA, POSITION_SIGMA = 0.02, 0.015
VELOCITY = np.array([6.0, -3.0, 1.0])
START, END = np.radians([8.0, -12.0, 130.0]), np.radians([11.0, -6.0, 150.0])


def body_to_enu(angles: Floats) -> Rotation:
    return Rotation.from_matrix(NED_TO_ENU) * Rotation.from_euler("ZYX", angles[..., ::-1])


def exposure() -> tuple[Exposures, CameraOnBody]:
    """One exposure a quarter of a second after an epoch, at the camera."""
    t = np.arange(40.0)
    path = path_of(np.outer(t, VELOCITY), np.tile(VELOCITY, (40, 1)), t, POSITION_SIGMA)
    # An attitude that turns evenly: the interpolation itself has nothing to add.
    turns = Slerp([0.0, 1.0], body_to_enu(np.stack([START, END])))
    steps = Rotation.concatenate([body_to_enu(START), turns(0.5), body_to_enu(END)])
    stamp = GpsTime.from_week(np.full(3, 2022), 1020.0 + np.array([0.0, 0.5, 1.0]))
    track = AttitudeTrack(stamp, steps.inv().as_matrix())
    event = GpsTime.from_week([2022], [1020.25])
    sigma = np.array([TIME_SIGMA])
    attitude = at_instants(track, event, ANGLE_SIGMA)
    own = attitude.covariance[0] - at_instants(track, event, np.zeros(3)).covariance[0]
    attitude.covariance[0] = own
    placed = interpolate(path, event, sigma, np.zeros((1, 3)))
    rig = CameraOnBody(LEVER, LEVER_SIGMA, ANGLE_SIGMA, BORESIGHT, BORESIGHT_SIGMA)
    events = Events("test", event, np.arange(1), sigma)
    return at_camera(at_events(events, placed, attitude, sigma, [("a",)], "ellipsoidal"), rig), rig


def claimed() -> tuple[Floats, Floats]:
    """Its angles and covariance (6, 6)."""
    found, rig = exposure()
    angles, covariance = orientations_in_frame(*orientations(found, rig), np.eye(3)[None])
    return angles[0], covariance[0]


def test_joint_covariance_against_simulation() -> None:
    angles, covariance = claimed()
    rng, n = np.random.default_rng(11), 200_000
    late = rng.normal(0, TIME_SIGMA, n)
    turns = Slerp([0.0, 1.0], body_to_enu(np.stack([START, END])))
    at = turns(np.clip(0.25 + late, 0, 1)).as_matrix()
    euler = Rotation.from_matrix(NED_TO_ENU.T @ at).as_euler("ZYX")[:, ::-1]
    body = body_to_enu(euler + rng.normal(0, 1, (n, 3)) * ANGLE_SIGMA)
    place = late[:, None] * VELOCITY + rng.normal(0, POSITION_SIGMA, (n, 3))
    place = place - body.apply(LEVER + rng.normal(0, 1, (n, 3)) * LEVER_SIGMA)
    boresight = Rotation.from_rotvec(BORESIGHT + rng.normal(0, 1, (n, 3)) * BORESIGHT_SIGMA)
    camera = boresight.as_matrix() @ NADIR @ body.inv().as_matrix()
    drawn = np.hstack([place, angles_from_matrix(camera)])
    simulated = np.cov(drawn.T)
    sigma = np.sqrt(np.diag(covariance))
    assert np.sqrt(np.diag(simulated)) == pytest.approx(sigma, rel=0.05)
    assert np.abs((simulated - covariance) / np.outer(sigma, sigma)).max() < 0.05
    assert drawn[:, 3:].mean(axis=0) == pytest.approx(angles, abs=1e-3)


def test_the_covariance_is_written_as_a_run_has_it(tmp_path: Path) -> None:
    angles, covariance = claimed()
    found, rig = exposure()
    write_block_images(tmp_path / "images.csv", found, "C", rig, None)
    table = pyarrow.parquet.read_table(tmp_path / "covariance.parquet").to_pylist()
    assert table[0]["id"] == "a"
    assert table[0]["names"] == ["X", "Y", "Z", "omega", "phi", "kappa"]
    unit = np.array([1, 1, 1, *[180 / np.pi] * 3])
    expected = (covariance * unit[:, None] * unit)[np.tril_indices(6)]
    assert np.array(table[0]["lower"]) == pytest.approx(expected, rel=1e-6, abs=1e-12)
    row = (tmp_path / "images.csv").read_text().splitlines()[1].split(",")
    assert [float(v) for v in row[5:8]] == pytest.approx(np.degrees(angles), abs=1e-5)
    assert [float(v) for v in row[8:]] == pytest.approx(np.sqrt(np.diag(covariance)) * unit, abs=1e-5)


def test_interpolated_attitudes_are_as_uncertain_as_claimed() -> None:
    """Rates that wander: the sigma is learnt by leaving out and judged at the instants between."""
    rng = np.random.default_rng(2)
    n, step = 6000, 0.01
    wander = np.cumsum(rng.normal(0, 0.02 * np.sqrt(step), (n, 3)), axis=0)
    truth = body_to_enu(wander + np.array([0.1, -0.2, 1.0]))
    stamp = GpsTime.from_week(np.full(n, 2022), 1000 + np.arange(n) * step)
    recorded = np.arange(0, n, 20)
    track = AttitudeTrack(stamp[recorded], truth[recorded].inv().as_matrix())
    between = recorded[:-1] + 10
    found = at_instants(track, stamp[between], np.zeros(3))
    error = Rotation.from_matrix(
        truth[between].inv().as_matrix() @ np.swapaxes(found.rotation, 1, 2)
    ).as_rotvec()
    sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert 0.9 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.1
    _, left_out, _ = left_out_turns(track)
    assert len(left_out) == len(recorded) - 2


def test_quaternions_and_gaps() -> None:
    # A quarter turn to the right: forward is east.
    half = np.sqrt(0.5)
    rotation = rotations_of_quaternions(np.array([[half, 0.0, 0.0, half], [1.0, 0.0, 0.0, 0.0]]))
    assert rotation[0] @ [1.0, 0.0, 0.0] == pytest.approx([1.0, 0.0, 0.0])
    assert rotation[1] @ [0.0, 1.0, 0.0] == pytest.approx([1.0, 0.0, 0.0])
    track = AttitudeTrack(GpsTime.from_week([2022, 2022], [1.0, 3.0]), rotation)
    assert not at_instants(track, GpsTime.from_week([2022], [2.0]), None).known.any()


def test_geo_txt_has_the_cameras_angles_and_accuracies(tmp_path: Path) -> None:
    found, rig = exposure()
    write_geo_txt(tmp_path / "geo.txt", found, rig)
    crs, images = read_geo(tmp_path / "geo.txt")
    assert (crs, *images) == ("EPSG:4326", "a")
    told = images["a"]
    p = found.placed
    assert told[:3] == pytest.approx((p.lon_deg[0], p.lat_deg[0], p.height_m[0]), abs=1e-4)
    # omega, phi, kappa and yaw, pitch, roll of the same camera.
    angles, covariance = claimed()
    body = Rotation.from_euler("ZYX", told[3:6], degrees=True).as_matrix()
    camera = (NED_TO_ENU @ body).T
    assert camera == pytest.approx(NADIR.T @ matrix_from_angles(angles), abs=1e-5)
    assert told[6] == pytest.approx(np.sqrt(covariance[0, 0] + covariance[1, 1]), abs=1e-4)
    assert told[7] == pytest.approx(np.sqrt(covariance[2, 2]), abs=1e-4)
    unknown = replace(found, attitude=no_attitudes(1))
    write_geo_txt(tmp_path / "geo.txt", unknown, rig)
    assert len((tmp_path / "geo.txt").read_text().splitlines()[1].split()) == 4

"""Recorded attitudes against images that an adjustment oriented: boresight, stored turns, a real flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.base.geodesy import enu_axes, geocentric, geodetic
from photocal.findings.finding import Finding
from photocal.geometry.oriented_images import OrientedImages
from photocal.geometry.oriented_images import oriented_images as as_images
from photocal.geometry.rotation import angles_from_matrix
from photocal.navigation.attitude import from_angles
from photocal.navigation.events import Events
from photocal.navigation.exposure_run import ExposureChoices, place_exposures
from photocal.navigation.exposures import Exposures, at_events, orientations
from photocal.navigation.image_checks import (
    boresight_check,
    compare_with_oriented,
    oriented_images,
    rotation_check,
)
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import InterpolatedPositions
from tests.photocal.findings.english import english

Floats = NDArray[np.float64]
ORIGIN = np.array([-25.45, -49.23, 950.0])
SIGMAS = np.radians([0.3, 0.3, 0.6])
TURN = np.radians([1.5, -0.8, 2.0])
# Of the recorded flight by COLMAP 4.2.1 (its own features and adjustment; principal distance of the EXIF, no
# distortion, no positions): a frame of its own.
PEER = """
image,X,Y,Z,omega,phi,kappa
DJI_0018.JPG,-3.25073,3.68604,-0.05760,178.7872,0.7695,-1.8828
DJI_0019.JPG,-3.09348,2.11152,-0.07381,179.5939,0.8198,2.3802
DJI_0020.JPG,-3.00955,0.52584,0.00063,179.8170,0.6383,0.1583
DJI_0021.JPG,-2.96723,-1.05205,0.04082,179.9395,0.4759,-0.9719
DJI_0022.JPG,-2.85036,-2.61217,0.08176,-179.9563,0.3802,-0.9725
DJI_0023.JPG,-2.74326,-4.22656,0.16271,179.7700,0.1966,0.5785
DJI_0024.JPG,0.34721,-3.80111,0.13148,-179.8908,-1.5829,3.7726
DJI_0025.JPG,0.26966,-2.13051,0.08258,177.9793,-1.2591,-8.5001
DJI_0026.JPG,0.12978,-0.57933,0.02607,177.1523,-1.1661,-9.6014
DJI_0027.JPG,0.00142,0.99968,-0.00791,176.8180,-1.2079,-9.4864
DJI_0028.JPG,-0.10136,2.55097,-0.06204,176.7486,-1.2544,-6.7219
DJI_0029.JPG,-0.18974,4.10780,-0.09322,176.7013,-1.3575,-8.3613
DJI_0030.JPG,2.63748,4.01251,-0.13997,176.6994,-0.0680,-4.8599
DJI_0031.JPG,2.76883,2.39117,-0.12496,178.7954,0.1422,2.5558
DJI_0032.JPG,2.83376,0.82584,-0.05743,179.5910,0.1520,3.2241
DJI_0033.JPG,2.94678,-0.72226,-0.01464,179.9231,0.1961,2.1201
DJI_0034.JPG,3.02008,-2.30925,0.04131,179.8441,0.2281,0.0492
DJI_0035.JPG,3.10270,-3.89690,0.08696,179.9412,0.1879,-0.7399
"""


def flight(noise: Floats) -> tuple[Exposures, Floats]:
    """Four strips of six images to and fro, recorded with noise; their true rotations to camera axes."""
    rng = np.random.default_rng(11)
    strip, step = np.divmod(np.arange(24), 6)
    north = np.where(strip % 2 == 0, step, 5 - step) * 10.0
    place = np.stack([strip * 15.0, north, rng.normal(0, 0.3, 24)], axis=1)
    heading = np.where(strip % 2 == 0, 0.0, np.pi)
    angles = np.column_stack([rng.normal(0, np.radians(3), (24, 2)), heading])
    true = from_angles(angles, SIGMAS)
    recorded = from_angles(angles + rng.normal(0, 1, (24, 3)) * noise, SIGMAS)
    centre = geocentric(ORIGIN[None, 0], ORIGIN[None, 1], ORIGIN[None, 2])
    lat, lon, height = geodetic(place @ enu_axes(ORIGIN[0], ORIGIN[1]) + centre)
    n, zero = 24, np.zeros(24)
    covariance = np.tile(np.eye(3) * 1e-4, (n, 1, 1))
    placed = InterpolatedPositions(
        np.ones(n, bool), zero, lat, lon, height, np.zeros((n, 3)), covariance, np.full(n, "fixed")
    )
    time = GpsTime.from_week(np.full(n, 2370), 1000 + 2.0 * np.arange(n))
    events = Events("test", time, np.arange(n), zero)
    names = [(f"{k:02d}.JPG",) for k in range(n)]
    made = at_events(events, placed, recorded, zero, names, "ellipsoidal")
    rotation = Rotation.from_rotvec(TURN).as_matrix() @ CameraOnBody().axes @ true.rotation
    return made, rotation


def block(exposures: Exposures, rotation: Floats, stored: dict[int, int]) -> OrientedImages:
    """The images in a frame turned, scaled and shifted, some stored turned by quarters."""
    p = exposures.placed
    centre = geocentric(ORIGIN[None, 0], ORIGIN[None, 1], ORIGIN[None, 2])
    place = (p.xyz_m - centre) @ enu_axes(ORIGIN[0], ORIGIN[1]).T
    turn = enu_axes(40.0, 130.0)
    quarters = Rotation.from_rotvec([[0, 0, -np.pi / 2 * stored.get(k, 0)] for k in range(24)]).as_matrix()
    unknown = np.full(len(place), -1)
    return as_images((), unknown, quarters @ rotation @ turn.T, 1.7 * place @ turn.T + [500.0, -20.0, 3.0])


def test_a_boresight_is_found_whatever_the_frame_and_the_way_images_are_stored() -> None:
    noise = np.radians([0.3, 0.3, 0.6])
    exposures, rotation = flight(noise)
    stored = {**dict.fromkeys(range(12, 18), 2), 3: 1}
    oriented = block(exposures, rotation, stored)
    pairs = compare_with_oriented(exposures, oriented, CameraOnBody(angle_sigma=SIGMAS))
    check = rotation_check(exposures, pairs, "the adjustment")
    assert [(entry["image"], entry["degrees"]) for entry in check.figures["stored_turned"]] == [
        (f"{k:02d}.JPG", 90 * turn) for k, turn in sorted(stored.items())
    ]
    # Relative rotations contain the noise of two attitudes, and little of the boresight.
    assert check.figures["median_deg"] < 1.5
    found = boresight_check(exposures, oriented, CameraOnBody(angle_sigma=SIGMAS))
    assert found.severity == "grave"
    value, sigma = np.array(found.figures["turn_deg"]), np.array(found.figures["sigma_deg"])
    assert (sigma < 0.4).all()
    assert (np.abs(value - np.degrees(TURN)) < 4 * np.maximum(sigma, 0.05)).all()
    # Once it is given nothing is left.
    right = CameraOnBody(angle_sigma=SIGMAS, boresight=TURN, boresight_sigma=np.radians([0.1, 0.1, 0.1]))
    again = boresight_check(exposures, oriented, right)
    assert again.severity == "passed", english(again)


def test_rotations_without_noise_agree(tmp_path: Path) -> None:
    exposures, rotation = flight(np.zeros(3))
    own = block(exposures, rotation, {})
    table = tmp_path / "images.csv"
    rows = [
        f"{name},{','.join(f'{v:.6f}' for v in (*place, *angles))}"
        for name, place, angles in zip(
            exposures.first_images, own.station, np.degrees(angles_from_matrix(own.rotation)), strict=True
        )
    ]
    table.write_text("\n".join(["image,X,Y,Z,omega,phi,kappa", *rows]) + "\n")
    oriented = oriented_images(tmp_path, [*exposures.first_images, "missing.JPG"])
    assert np.isnan(oriented.rotation[-1]).all()
    read = oriented.only(range(len(oriented) - 1))
    rig = CameraOnBody(angle_sigma=SIGMAS, boresight=TURN)
    for pair in compare_with_oriented(exposures, read, rig):
        assert pair.quarter_turns == 0
        assert pair.angle_deg == pytest.approx(0.0, abs=1e-4)
        assert pair.along == pytest.approx(1.0, abs=1e-6)
    assert np.isfinite(orientations(exposures, rig)[0]).all()


@pytest.mark.shared
def test_gimbal_angles_of_a_recorded_flight(shared: Path, tmp_path: Path) -> None:
    table = tmp_path / "images.csv"
    table.write_text(PEER.lstrip())
    rig = CameraOnBody(angle_sigma=np.radians([1.0, 1.0, 2.0]))
    images = shared / "data/uav-brighton-beach/images"
    run = place_exposures(ExposureChoices(Sources(), images, rig=rig, oriented=table), None, None)
    found: dict[str, Finding] = {check.code: check for check in run.checks}
    rotations, boresight = found["image-rotations"], found["boresight"]
    assert len(rotations.figures["pairs"]) == 17
    assert rotations.figures["median_deg"] < 1.0
    assert rotations.figures["median_same_way_deg"] < 0.7
    # README of the data: stored turned by 180 degrees against their gimbal yaw.
    turned = rotations.figures["stored_turned"]
    assert [entry["image"] for entry in turned] == [f"DJI_{n:04d}.JPG" for n in range(24, 30)]
    assert {entry["degrees"] for entry in turned} == {180}
    assert boresight.severity == "passed"
    assert max(np.abs(boresight.figures["turn_deg"][:2])) < 2.0

"""Rendered pictures: targets where the truth has them, ground where it belongs, EXIF for Pillow."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2 as opencv
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from acquire.simulate.world.exposures import Pose
from acquire.simulate.world.observations import seen, seen_rolling
from acquire.simulate.world.render import dictionary_of, make_scene, render
from acquire.simulate.world.world import picture_stamps
from tests.acquire.simulate.world.conftest import Flight

Floats = NDArray[np.float64]
# Its type hints lack much of what it has.
cv2: Any = opencv
SIDES = ("queryIdx", "trainIdx")
CODES = "apriltag_36h11"


def found_by_opencv(grey: NDArray[np.uint8]) -> dict[int, Floats]:
    """Find markers with cv2.aruco, and their centres by aligning the marker's picture (ECC)."""
    codes = dictionary_of(CODES)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, identities, _ = cv2.aruco.ArucoDetector(codes, parameters).detectMarkers(grey)
    side, margin = 64, 8
    ideal = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) + margin - 0.5
    found = {}
    for identity, quadrilateral in zip(map(int, np.ravel(identities)), corners, strict=True):
        rough = cv2.getPerspectiveTransform(ideal, quadrilateral.reshape(4, 2).astype(np.float32))
        marker = np.pad(codes.generateImageMarker(identity, side), margin, constant_values=255)
        smooth = cv2.GaussianBlur(marker, (0, 0), 1.5)
        steps = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
        _, fine = cv2.findTransformECC(
            smooth, grey, rough.astype(np.float32), cv2.MOTION_HOMOGRAPHY, steps, None, 3
        )
        middle = np.array([[[margin + side / 2 - 0.5] * 2]], np.float32)
        found[identity] = cv2.perspectiveTransform(middle, fine).reshape(2).astype(float)
    return found


def test_targets_are_where_the_truth_has_them(small: Flight) -> None:
    world, wanted = small.world, 0
    errors: list[Floats] = []
    for number, name in enumerate(world.exposures.names):
        grey = cv2.imread(str(small.folder / "site/images" / name), cv2.IMREAD_GRAYSCALE)
        assert grey is not None
        pose = Pose(world.exposures.pose.centre_m[number], world.exposures.pose.rotation[number])
        truth = seen(world.targets.centre_m, pose, world.camera)
        whole = world.camera.sees(truth, 45)
        found = found_by_opencv(np.asarray(grey, np.uint8))
        wanted += int(whole.sum())
        there = [k for k in np.flatnonzero(whole).tolist() if int(world.targets.codes[k]) in found]
        errors += [found[int(world.targets.codes[k])] - truth[k] for k in there]
    # The detector overlooks a plate now and then.
    assert len(errors) > max(20, 0.9 * wanted)
    assert np.abs(errors).max() < 0.1
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02


def test_a_rolling_shutter_moves_targets_as_the_forward_model_says(small: Flight) -> None:
    world = small.world
    camera = world.configuration.camera.model_copy(update={"readout_s": 0.03})
    rolling = replace(world, configuration=world.configuration.model_copy(update={"camera": camera}))
    number = 3
    grey = cv2.cvtColor(render(make_scene(rolling), number), cv2.COLOR_BGR2GRAY)
    found = found_by_opencv(np.asarray(grey, np.uint8))
    truth = seen_rolling(world.targets.centre_m, world.exposures, number, world.motion, world.rig, 0.03)
    still = seen_rolling(world.targets.centre_m, world.exposures, number, world.motion, world.rig, 0.0)
    rows = np.flatnonzero(world.camera.sees(truth, 45)).tolist()
    assert len(rows) >= 2
    for row in rows:
        assert found[int(world.targets.codes[row])] == pytest.approx(truth[row], abs=0.1)
    assert np.abs(truth - still)[rows].max() > 0.3


def test_two_pictures_show_the_same_ground(small: Flight) -> None:
    """Matches of SIFT between two pictures meet on the ground to a fraction of a pixel."""
    world = small.world
    pair = (1, 2)
    sift, places = cv2.SIFT_create(nfeatures=1500), []
    greys = [
        cv2.imread(str(small.folder / "site/images" / world.exposures.names[k]), cv2.IMREAD_GRAYSCALE)
        for k in pair
    ]
    points, features = zip(*(sift.detectAndCompute(grey, None) for grey in greys), strict=True)
    matches = cv2.BFMatcher().knnMatch(features[0], features[1], k=2)
    good = [a for a, b in matches if a.distance < 0.7 * b.distance]
    ends = [np.array([points[k][getattr(m, side)].pt for m in good]) for k, side in enumerate(SIDES)]
    for k, pixels in zip(pair, ends, strict=True):
        rays = world.camera.directions(pixels) @ np.diag([1.0, -1.0, -1.0]) @ world.exposures.pose.rotation[k]
        centre = np.broadcast_to(world.exposures.pose.centre_m[k], rays.shape)
        places.append(world.terrain.intersect(centre, rays))
    # Plates lie above the ground, by as much as it slopes beneath them.
    beside = np.abs(places[0][:, None, :2] - world.targets.centre_m[:, :2]).max(axis=2).min(axis=1) > 1.5
    assert beside.sum() > 300
    apart = np.linalg.norm(places[0] - places[1], axis=1)[beside]
    pixel_m = 28 * 0.0117 / 8.8
    assert np.median(apart) < 0.25 * pixel_m
    assert (apart < 2 * pixel_m).mean() > 0.98


def test_exif_and_xmp_are_read_by_pillow(small: Flight) -> None:
    world = small.world
    stamps = picture_stamps(world)
    for name, stamp in zip(world.exposures.names, stamps, strict=True):
        with Image.open(small.folder / "site/images" / name) as image:
            assert image.size == (1024, 768)
            exif = image.getexif()
            own, gps = exif.get_ifd(0x8769), exif.get_ifd(0x8825)
            told = f"{stamp:%Y:%m:%d %H:%M:%S}", f"{stamp.microsecond // 1000:03d}"
            assert (own[0x9003], own[0x9291]) == told
            assert float(own[0x920A]) == pytest.approx(8.8)
            assert (own[0xA002], own[0xA003]) == image.size
            assert exif[0x0110] == "SIM-0"
            degrees, minutes, seconds = (float(part) for part in gps[2])
            assert gps[1] == "S"
            assert degrees + minutes / 60 + seconds / 3600 == pytest.approx(25.4483, abs=5e-4)
            assert b'GimbalPitchDegree="-' in image.info["xmp"]
    late = (stamps[0].timestamp() - stamps[-1].timestamp()) + np.ptp(world.exposures.event_s)
    # The camera's clock runs 8 ppm fast, with jitter.
    assert abs(late) < 0.02


def test_pictures_are_the_same_each_time(small: Flight) -> None:
    first, second = (render(make_scene(small.world), 2) for _ in range(2))
    assert np.array_equal(first, second)

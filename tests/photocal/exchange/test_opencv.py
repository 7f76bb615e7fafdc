"""OpenCV itself as the judge of its format."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.opencv import read_opencv, write_opencv
from photocal.exchange.pinhole import to_vision
from tests.photocal.exchange.conftest import residuals_of


@pytest.mark.parametrize("suffix", [".yml", ".json"])
def test_opencv_projects_with_our_file(tmp_path: Path, vision: Block, suffix: str) -> None:
    exact = vision.observations.values + residuals_of(vision)
    rotation, translation = to_vision(vision.images.values)
    for k, own in enumerate(vision.cameras):
        path = tmp_path / f"camera{suffix}"
        assert write_opencv(path, own).largest_px == 0
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        matrix = storage.getNode("camera_matrix").mat()
        coefficients = storage.getNode("distortion_coefficients").mat()
        storage.release()
        for j in np.flatnonzero(vision.images.camera == k):
            rays = vision.observations.image == j
            xyz = vision.points.values[vision.observations.point[rays]]
            turn = cv2.Rodrigues(rotation[j])[0]
            found = cv2.projectPoints(xyz, turn, translation[j], matrix, coefficients)[0][:, 0]
            assert np.abs(found - exact[rays]).max() < 1e-6


@pytest.mark.parametrize("suffix", [".yml", ".json"])
def test_round_trip(tmp_path: Path, vision: Block, suffix: str) -> None:
    for own in vision.cameras:
        path = tmp_path / f"camera{suffix}"
        write_opencv(path, own)
        np.testing.assert_allclose(read_opencv(path).values, own.values, rtol=1e-9, atol=1e-15)


def test_photogrammetric_camera_states_its_residual(tmp_path: Path, photogrammetric: Block) -> None:
    conversion = write_opencv(tmp_path / "camera.yml", photogrammetric.cameras[0])
    assert 0 < conversion.rms_px < 0.1
    storage = cv2.FileStorage(str(tmp_path / "camera.yml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("conversion_rms_px").real() == conversion.rms_px
    storage.release()


HEAD = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
MATRIX = (
    "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    "   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]\n"
)
COEFFICIENTS = (
    "distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: {}\n   dt: d\n   data: [ {} ]\n"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x: 1\n", "not a YAML file of OpenCV"),
        (HEAD, "has no camera_matrix"),
        (HEAD + MATRIX.replace("500.", ".Nan", 1) + COEFFICIENTS.format(4, "0., 0., 0., 0."), "not a number"),
        (HEAD + MATRIX + COEFFICIENTS.format(14, "0.1, " + "0., " * 11 + "0.5, 0."), "beyond"),
        (HEAD + MATRIX.replace("rows: 3", "rows: 100000000"), "not a matrix"),
        # OpenCV's own reader writes beyond its memory here.
        (HEAD + MATRIX.replace("cols", "colc") + COEFFICIENTS.format(4, "0., 0., 0., 0."), "not a matrix"),
        (
            HEAD.replace("640", "99999999999") + MATRIX + COEFFICIENTS.format(4, "0., 0., 0., 0."),
            "impossible",
        ),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "camera.yml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputMalformedError, match=message):
        read_opencv(path)

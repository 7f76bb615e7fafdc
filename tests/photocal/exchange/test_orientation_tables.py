"""Tables of exterior orientations: PATB style and Inpho."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.orientation_tables import (
    read_inpho,
    read_matrices,
    write_angles,
    write_inpho,
    write_matrices,
)
from photocal.exchange.pinhole import to_vision
from photocal.geometry.distortion import undistorted


@pytest.mark.parametrize("unit", ["deg", "gon"])
def test_angles_are_in_their_unit(tmp_path: Path, vision: Block, unit: Literal["deg", "gon"]) -> None:
    path = tmp_path / "ori.txt"
    write_angles(path, vision.images.names, vision.images.values, unit)
    rows = [line.split() for line in path.read_text().splitlines()[1:]]
    assert tuple(row[0] for row in rows) == vision.images.names
    values, circle = np.array([row[1:] for row in rows], float), 360 if unit == "deg" else 400
    np.testing.assert_allclose(values[:, :3], vision.images.values[:, 3:], rtol=1e-12)
    np.testing.assert_allclose(values[:, 3:] / circle, vision.images.values[:, :3] / (2 * np.pi), rtol=1e-12)


def test_matrices_round_trip(tmp_path: Path, vision: Block) -> None:
    write_matrices(tmp_path / "ori.txt", vision.images.names, vision.images.values)
    np.testing.assert_allclose(read_matrices(tmp_path / "ori.txt")[1], vision.images.values, rtol=1e-9)
    # Camera to object is the inverse of object to vision axes, with y and z turned back.
    cells = (tmp_path / "ori.txt").read_text().splitlines()[1].split()[4:]
    rotation, _ = to_vision(vision.images.values[0])
    np.testing.assert_allclose(
        np.array(cells, float).reshape(3, 3), rotation.T @ np.diag([1, -1, -1]), atol=1e-12
    )


def test_inpho_round_trip(tmp_path: Path, photogrammetric: Block) -> None:
    path = tmp_path / "a.prj"
    (made,) = write_inpho(path, photogrammetric)
    found = read_inpho(path).block.images
    names, poses = found.names, found.values
    assert names == photogrammetric.images.names
    np.testing.assert_allclose(poses, photogrammetric.images.values, rtol=1e-9)
    # The file has no distortion: what is lost is the distortion itself, largest in a corner.
    own = photogrammetric.cameras[0]
    corner = np.array([[0.5, 0.5], [-0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]) * own.size_px * own.pitch
    apart = undistorted(own, corner) - (corner - [own.value("x0"), own.value("y0")])
    assert made.largest_px == pytest.approx(np.hypot(*(apart / own.pitch).T).max(), rel=1e-6)


def test_inpho_project_of_another_hand(tmp_path: Path) -> None:
    """Rows of the matrix from object to camera: first where the camera's x axis points.

    This camera looks straight down and its x axis points north: kappa is 90 degrees, and the first row, the x
    axis in object coordinates, is (0, 1, 0).
    """
    path = tmp_path / "a.prj"
    path.write_text(
        "$PROJECT 15.0.0\n$END\n$PHOTO\n  $PHOTO_NUM : 7\n  $CAMERA_ID : c\n"
        "  $EXT_ORI : 12:00:00 01/01/2026\n"
        "    124 380000 5680000 1000\n    0 1 0\n    -1 0 0\n    0 0 1\n$END\n"
    )
    found = read_inpho(path).block.images
    names, poses = found.names, found.values
    assert names == ("7",)
    np.testing.assert_allclose(np.degrees(poses[0, :3]), [0, 0, 90], atol=1e-12)
    assert poses[0, 3:].tolist() == [380000, 5680000, 1000]


def test_bad_tables(tmp_path: Path) -> None:
    path = tmp_path / "ori.txt"
    for text, message in (
        ("a 1 2 3 0 0\n", "5 values where 12"),
        ("a 1 2 3 1 0 0 0 1 0 0 0 1\na 1 2 3 1 0 0 0 1 0 0 0 1\n", "listed twice"),
        ("a 1 2 3 1 0 0,5 0 1 0 0 0 1\n", "decimal comma"),
        ("# nothing\n", "no exterior orientation"),
    ):
        path.write_text(text)
        with pytest.raises(InputMalformedError, match=message):
            read_matrices(path)
    path.write_text("a 0 0 0 1 0 0 0 1 0 0 0 2\n")
    with pytest.raises(InputMalformedError, match="not a rotation"):
        read_matrices(path)
    path.write_text("$PHOTO\n $PHOTO_NUM : 1\n $EXT_ORI :\n 100 1 2 3\n 1 0 0\n")
    with pytest.raises(InputMalformedError, match="ends inside"):
        read_inpho(path)

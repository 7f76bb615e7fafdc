"""Pix4D's .cam files against their documented equations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.pix4d_project import read_cam, read_external, write_pix4d
from photocal.geometry.camera import among, plane_to_pixel
from photocal.geometry.distortion import projected
from tests.photocal.exchange.pix4d_folder import write_params


def test_pix4d_example() -> None:
    """The file printed in EasyIDP's documentation: its numbers by OpenCV's equations."""
    text = (
        "Pix4D camera calibration file 0\n"
        "#Focal Length mm assuming a sensor width of 17.49998592000000030566x13.12498944000000200560mm\n"
        "F 15.01175404934517487732\n#Principal Point mm\n"
        "Px 8.48210511970419922534\nPy 6.33434629978042273990\n"
        "#Symmetrical Lens Distortion Coeffs\nK1 0.03833474118270804865\nK2 -0.01750917966495743258\n"
        "K3 0.02049798716391852335\n#Tangential Lens Distortion Coeffs\nT1 0.00240851666319534747\n"
        "T2 0.00292562392135245920\n"
    )
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "maize.cam"
        path.write_text(text.replace("\n", "\r\n"))
        (own,) = read_cam(path, [(4608, 3456)])
        write_pix4d(Path(folder) / "again.cam", own)
        (again,) = read_cam(Path(folder) / "again.cam", [(4000, 4000), (4608, 3456)])
    np.testing.assert_allclose(again.values, own.values, rtol=1e-9, atol=1e-20)
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = 1 + 0.03833474118270805 * r2 - 0.017509179664957433 * r2**2 + 0.020497987163918523 * r2**3
    t1, t2 = 0.0024085166631953475, 0.002925623921352459
    u = 8.4821051197042 + 15.011754049345175 * (x * radial + 2 * t1 * x * y + t2 * (r2 + 2 * x * x))
    v = 6.334346299780423 + 15.011754049345175 * (y * radial + 2 * t2 * x * y + t1 * (r2 + 2 * y * y))
    pixel = plane_to_pixel(own.size_px, own.pitch, projected(own, np.array([[x, -y, -1.0]])))[0]
    np.testing.assert_allclose((pixel + 0.5) * 17.49998592 / 4608, [u, v], atol=1e-9)


def test_pix4d_wants_the_right_image_size(tmp_path: Path, photogrammetric: Block) -> None:
    write_pix4d(tmp_path / "a.cam", photogrammetric.cameras[0])
    with pytest.raises(InputMalformedError, match="does not have the shape of a picture"):
        read_cam(tmp_path / "a.cam", [(4000, 4000)])


def test_orientations_alone_are_those_of_the_block(tmp_path: Path, vision: Block) -> None:
    # A .cam has one focal length.
    square = [own.with_values(np.where(among("B1", "B2"), 0.0, own.values)) for own in vision.cameras]
    write_params(tmp_path, replace(vision, cameras=tuple(square)))
    given = read_external(tmp_path / "field 3_calibrated_external_camera_parameters.txt").block
    assert given.images.names == vision.images.names
    np.testing.assert_allclose(given.images.values, vision.images.values, atol=1e-9)
    cameras = read_cam(
        tmp_path / "field 3_pix4d_calibrated_internal_camera_parameters.cam",
        [camera.size_px for camera in vision.cameras],
    )
    for own, theirs in zip(square, cameras, strict=True):
        rays = np.column_stack([np.linspace(-0.3, 0.3, 7), np.linspace(0.2, -0.2, 7), np.full(7, -1.0)])
        expected, seen = (plane_to_pixel(c.size_px, c.pitch, projected(c, rays)) for c in (own, theirs))
        np.testing.assert_allclose(seen, expected, atol=1e-6)

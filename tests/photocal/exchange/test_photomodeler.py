"""PhotoModeler's export written and read, with several cameras; its tables of points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.photomodeler import read as read_photomodeler
from photocal.exchange.photomodeler import write as write_photomodeler
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal.exchange.conftest import observed_camera, reconstruction_of, residuals_of


def two_cameras() -> Block:
    first = observed_camera()
    other = replace(first.with_values(first.values * 1.01), id="other")
    return reconstruction_of((first, other))


def test_round_trip_with_two_cameras(tmp_path: Path) -> None:
    given = two_cameras()
    path = tmp_path / "export.txt"
    assert [made.largest_px for made in write_photomodeler(path, given)] == [0, 0]
    block = read_photomodeler(path).block
    assert block.images.names == given.images.names
    np.testing.assert_allclose(block.images.values, given.images.values, rtol=1e-12, atol=1e-12)
    assert np.array_equal(block.images.camera, given.images.camera)
    for own, again in zip(given.cameras, block.cameras, strict=True):
        np.testing.assert_allclose(again.values, own.values, rtol=1e-9, atol=1e-14)
    order = [block.points.names.index(name) for name in given.points.names]
    np.testing.assert_allclose(block.points.values[order], given.points.values, rtol=1e-12)
    assert block.points.sigma[order[0]].tolist() == [0.002] * 3
    rays = np.argsort(given.observations.image, kind="stable")
    np.testing.assert_allclose(block.observations.values, given.observations.values[rays], atol=1e-9)


def test_affinity_goes_into_the_width_of_a_pixel(tmp_path: Path) -> None:
    own = replace(observed_camera(), affinity="before").changed(B1=2e-4, B2=0.0)
    given = reconstruction_of((own,))
    write_photomodeler(tmp_path / "e.txt", given)
    block = read_photomodeler(tmp_path / "e.txt").block
    again = block.cameras[0]
    assert again.pitch[0] / again.pitch[1] == pytest.approx(1.0002, rel=1e-12)
    assert again.value("B1") == 0
    q = (given.points.values[given.observations.point] - given.images.values[given.observations.image, 3:])[
        :, None
    ]
    q = (q @ np.swapaxes(matrix_from_angles(given.images.values[given.observations.image, :3]), 1, 2))[:, 0]
    found = plane_to_pixel(again.size_px, again.pitch, projected(again, q))
    np.testing.assert_allclose(found - residuals_of(given), given.observations.values, atol=1e-9)


def test_what_has_no_place(tmp_path: Path, vision: Block) -> None:
    skewed, two = observed_camera().changed(B2=1e-4), two_cameras()
    for given, message in (
        (vision, "in mm"),
        (reconstruction_of((skewed,)), "skew"),
        (replace(two, images=replace(two.images, names=("../a", *"bcdef"))), "cannot be a file name"),
    ):
        with pytest.raises(InputMalformedError, match=message):
            write_photomodeler(tmp_path / "e.txt", given)
        assert not list(tmp_path.iterdir())

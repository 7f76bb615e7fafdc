"""JAICOV's files written and read, with one camera and several."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.model import Block
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import in_pixels
from photocal.exchange.jaicov import read_jaicov
from photocal.exchange.jaicov import write as write_jaicov
from photocal.geometry.camera import camera, pixel_to_plane
from tests.photocal.exchange.conftest import reconstruction_of


def test_jaicov_round_trip(tmp_path: Path, vision: Block) -> None:
    values = {"c": 28.7, "x0": 0.017, "y0": 0.057, "K1": -1.1e-4, "K2": 1.5e-7, "P1": 5.8e-6, "P2": -8.6e-6}
    own = camera(
        "1",
        "brown-ideal",
        "mm",
        (4608, 3456),
        (0.004, 0.004),
        values | {"B1": -7e-5, "B2": -3e-5},
        affinity="additive",
    )
    images = replace(vision.images, camera=np.zeros(6, dtype=np.int64))
    single = replace(vision, cameras=(own,), images=images)
    assert [made.largest_px for made in write_jaicov(tmp_path / "block", single, Choices())] == [0]
    block = read_jaicov(tmp_path / "block.ior", sigma_mm=0.0005)
    np.testing.assert_allclose(block.cameras[0].values, own.values, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(block.images.values, vision.images.values, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(block.points.values, vision.points.values, rtol=1e-9, atol=1e-9)
    plane = pixel_to_plane(own.size_px, own.pitch, vision.observations.values)
    np.testing.assert_allclose(block.observations.values, plane, rtol=1e-9, atol=1e-12)
    with pytest.raises(ConfigurationError, match="a priori"):
        read_jaicov(tmp_path / "block.ior")


def test_two_cameras(tmp_path: Path) -> None:
    first = camera("3", "brown-ideal", "mm", (4608, 3456), (0.004, 0.004), {"c": 28.7, "K1": -1e-4})
    other = camera("8", "brown-ideal", "mm", (4000, 3000), (0.005, 0.005), {"c": 21.0, "x0": 0.1})
    given = reconstruction_of((first, other))
    write_jaicov(tmp_path / "block", given, Choices())
    block = read_jaicov(tmp_path / "block.eor", sigma_mm=0.0005)
    assert [own.id for own in block.cameras] == ["3", "8"]
    assert [own.size_px for own in block.cameras] == [first.size_px, other.size_px]
    assert np.array_equal(block.images.camera, given.images.camera)
    np.testing.assert_allclose(
        in_pixels(block).observations.values, given.observations.values, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize(
    ("suffix", "old", "new", "message"),
    [
        (".ior", "-28.7", "28.7", "not negative"),
        (".ior", "4608", "46080000", "impossible"),
        (".ior", "4608", "4608\n1", "6 lines"),
        (".eor", " 1 ", " 2 ", "not in the .ior"),
        (".eor", "\n2 ", "\n1 ", "listed twice"),
        (".obc", "100 ", "100 x", "not a number|values where"),
        (".phc", " 1 1 1\n", " 1 1\n", "10 values where"),
    ],
)
def test_bad_jaicov(tmp_path: Path, vision: Block, suffix: str, old: str, new: str, message: str) -> None:
    own = camera("1", "brown-ideal", "mm", (4608, 3456), (0.004, 0.004), {"c": 28.7})
    images = replace(vision.images, camera=np.zeros(6, dtype=np.int64))
    single = replace(vision, cameras=(own,), images=images)
    write_jaicov(tmp_path / "block", single, Choices())
    path = tmp_path / f"block{suffix}"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputMalformedError, match=message):
        read_jaicov(tmp_path / "block.phc", sigma_mm=0.001)

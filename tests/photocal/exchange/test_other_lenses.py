"""Lens models beside Brown's in the formats of others: written and read again, converted, refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.colmap import read_colmap, write_colmap
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import named
from photocal.exchange.metashape import write as write_metashape
from photocal.exchange.opencv import read_opencv, write_opencv
from photocal.exchange.opensfm import read_reconstruction
from photocal.exchange.opensfm import write as write_opensfm
from photocal.geometry.camera import Camera, Model, camera, plane_to_pixel
from photocal.geometry.conversion import apart_px, converted, in_pixels
from photocal.geometry.distortion import projected

SIZE = (4608, 3456)
VALUES: dict[Model, dict[str, float]] = {
    "rational": {"K1": 0.31, "K2": -0.05, "K3": 0.01, "K4": 0.35, "K5": -0.08, "K6": 0.02, "P1": 1e-3},
    "equidistant": {"K1": -0.03, "K2": 0.01, "K3": -0.004, "K4": 0.0006},
    "pix4d-fisheye": {"K1": 0.02, "K2": -0.15, "K3": 0.01},
}


def lens(model: Model, **more: float) -> Camera:
    values = {"c": 2300.0, "x0": 12.0, "y0": -7.0, "B1": 1e-3} | VALUES[model] | more
    return camera("1", model, "px", SIZE, (1.0, 1.0), values)


@pytest.mark.parametrize("model", ["rational", "equidistant"])
@pytest.mark.parametrize("binary", [False, True])
def test_colmap_holds_them(tmp_path: Path, vision: Block, model: Model, binary: bool) -> None:
    own = lens(model)
    given = replace(vision, cameras=(own,) * len(vision.cameras))
    assert all(made.largest_px == 0 for made in write_colmap(tmp_path, given, Choices(), binary=binary))
    again = read_colmap(tmp_path).cameras[0]
    assert again.model == model
    assert again.values == pytest.approx(own.values, rel=1e-12, abs=1e-12)
    assert {"c", "x0", "y0", "K1", "K4"} <= set(again.free) <= set(again.lens.names)


def test_opensfm_holds_a_fisheye(tmp_path: Path, vision: Block) -> None:
    given = replace(vision, cameras=(lens("equidistant"),) * len(vision.cameras))
    assert all(made.largest_px == 0 for made in write_opensfm(tmp_path, given))
    again = read_reconstruction(tmp_path / "reconstruction.json").cameras[0]
    assert again.model == "equidistant"
    assert again.values == pytest.approx(lens("equidistant").values, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("model", ["rational", "equidistant"])
@pytest.mark.parametrize("suffix", [".yml", ".json"])
def test_opencv_holds_them(tmp_path: Path, model: Model, suffix: str) -> None:
    own = lens(model, S1=5e-4, S4=-2e-4) if model == "rational" else lens(model)
    path = tmp_path / f"1{suffix}"
    assert write_opencv(path, own).largest_px == 0
    again = read_opencv(path)
    assert (again.model, again.values.tolist()) == (model, pytest.approx(own.values.tolist(), rel=1e-12))


def test_a_thin_prism_has_no_place_in_colmap(tmp_path: Path, vision: Block) -> None:
    own = lens("rational", S1=5e-4, S2=3e-4)
    given = replace(vision, cameras=(own,) * len(vision.cameras))
    assert all(0.01 < made.largest_px < 10 for made in write_colmap(tmp_path, given, Choices()))


def test_conversions_state_what_they_miss() -> None:
    """One fisheye by the polynomial of the other, and a narrow one by Brown's."""
    own = lens("pix4d-fisheye")
    conversion = converted(own, "equidistant")
    assert conversion.largest_px == pytest.approx(apart_px(own, conversion.camera)[1])
    assert 0 < conversion.rms_px < conversion.largest_px < 0.5
    narrow = replace(lens("equidistant"), size_px=(1600, 1200)).changed(c=4000.0)
    assert converted(narrow, "brown-ideal").largest_px < 0.01


def test_who_has_no_fisheye_refuses(tmp_path: Path, vision: Block) -> None:
    given = replace(vision, cameras=(lens("equidistant"),) * len(vision.cameras))
    with pytest.raises(InputMalformedError, match=r"equidistant lens, which Brown's .* miss by up to"):
        write_metashape(tmp_path / "out.xml", given)
    for name in ("pix4d", "micmac"):
        with pytest.raises(InputMalformedError, match="equidistant lens"):
            named(name).write(tmp_path, given, Choices("gon"))
    assert not list(tmp_path.iterdir())


def test_pixels_that_are_not_square() -> None:
    own = replace(lens("equidistant").changed(c=9.2, x0=0.05, y0=-0.03), unit="mm", pitch=(0.0042, 0.004))
    flat, q = in_pixels(own), np.array([[0.3, -0.2, -1.0], [-2.0, 1.0, -1.0], [0.0, 0.5, -1.0]])
    mm, px = (plane_to_pixel(SIZE, one.pitch, projected(one, q)) for one in (own, flat))
    assert mm == pytest.approx(px, abs=1e-8)

"""Refraction and earth curvature: traced through layers of air, text-book formulas, a block."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

import photocal
from photocal.base.arrays import Floats
from photocal.base.errors import PhotocalError
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.writer import write_block
from photocal.geometry.refraction import RADIUS_M, apparent_rise


def seen_at(height: float, level: float, refraction: float, *, curved: bool = False) -> float:
    """Tangent of the nadir angle at which a point is seen, by the rise."""
    rise = apparent_rise(np.array([[level, 0.0, -height]]), refraction, curved=curved)[0]
    return level / (height - float(rise))


@pytest.mark.parametrize("nadir_deg", [10.0, 35.0, 55.0])
def test_a_ray_through_layers_of_air(nadir_deg: float) -> None:
    """n sin(angle) is constant; n falls by k/R per metre of height: it ends nearer than a straight one."""
    k, height, at_camera = 0.17, 3000.0, math.radians(nadir_deg)
    product = (1.00027 - k / RADIUS_M * height) * math.sin(at_camera)

    def sideways(z: float) -> float:
        sine = product / (1.00027 - k / RADIUS_M * z)
        return sine / math.sqrt(1.0 - sine**2)

    level = quad(sideways, 0.0, height, epsabs=1e-12, epsrel=1e-13)[0]
    bent = math.tan(at_camera) - level / height
    assert bent > 1e-6
    assert seen_at(height, level, k) - level / height == pytest.approx(bent, rel=2e-3)


def test_text_book_formulas() -> None:
    """ARDC standard atmosphere at 3 km: K = 2410 H / (H^2 - 6 H + 250) urad, dr = K (r + r^3 / c^2).

    Earth curvature: dr = H r^3 / (2 R c^2) (Manual of Photogrammetry).
    """
    constant = 2410.0 * 3.0 / (9.0 - 18.0 + 250.0) * 1e-6
    k, c, height = 2.0 * RADIUS_M * constant / 3000.0, 152.0, 3000.0
    assert k == pytest.approx(0.13, abs=0.005)
    for r in (20.0, 80.0, 150.0):
        straight = r / c
        found = c * (seen_at(height, straight * height, k) - straight)
        assert found == pytest.approx(constant * (r + r**3 / c**2), rel=1e-3)
        found = c * (straight - seen_at(height, straight * height, 0.0, curved=True))
        assert found == pytest.approx(height * r**3 / (2.0 * RADIUS_M * c**2), rel=2e-3)


def bent_block(k: float, *, curved: bool) -> tuple[Block, Floats]:
    """Nine vertical images from 2000 m of hills, c = 3000 px, as bent rays show them; and their centres."""
    rng = np.random.default_rng(7)
    ground = np.column_stack([rng.uniform(-1500, 1500, (60, 2)), rng.uniform(0, 300, 60)])
    centres = np.array([[x, y, 2000.0 + 150 * (x > 0)] for x in (-600.0, 0, 600) for y in (-600.0, 0, 600)])
    apart = ground - centres[:, None]
    down = -apart[..., 2] - apparent_rise(apart.reshape(-1, 3), k, curved=curved).reshape(9, 60)
    pixels = np.stack([1999.5 + 3000 * apart[..., 0] / down, 1499.5 - 3000 * apart[..., 1] / down], axis=-1)
    pixels[(np.abs(pixels - [1999.5, 1499.5]) > [2000, 1500]).any(axis=-1)] = np.nan
    block = photocal.block_of_arrays(ground, pixels, (4000, 3000), sigma_px=0.1, sigma_m=0.001)
    camera = block.cameras[0].changed(c=3000.0)
    return replace(block, cameras=(replace(camera, estimated=np.zeros_like(camera.estimated)),)), centres


@pytest.mark.parametrize(("k", "curved"), [(0.13, False), (0.0, True), (0.17, True)])
def test_a_block_of_bent_rays(k: float, curved: bool) -> None:
    """Stated, rays fit to a thousandth of a pixel and centres to 2 mm; unstated they are centimetres off."""
    block, centres = bent_block(k, curved=curved)
    stated = photocal.adjust(replace(block, refraction=k, curvature=curved))
    unstated = photocal.adjust(block)
    assert stated.sigma0_squared is not None
    assert math.sqrt(stated.sigma0_squared) * 0.1 < 1e-3
    assert np.abs(stated.images.station - centres).max() < 2e-3
    assert np.abs(unstated.images.station - centres).max() > 0.015
    assert (stated.block.refraction, stated.block.curvature) == (k, curved)


def test_the_choice_is_kept_in_the_folder(tmp_path: Path) -> None:
    block = replace(bent_block(0.13, curved=True)[0], refraction=0.13, curvature=True)
    write_block(tmp_path, block)
    again = read_block(tmp_path)
    assert (again.refraction, again.curvature) == (0.13, True)
    setup = tmp_path / "block.toml"
    text = setup.read_text(encoding="utf-8").replace('frame = "local"', 'frame = "EPSG:31982"')
    setup.write_text(text.replace('height = ""', 'height = "ellipsoidal"'), encoding="utf-8")
    with pytest.raises(PhotocalError, match="leave curvature out"):
        read_block(tmp_path)

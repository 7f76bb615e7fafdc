"""DBAT set-ups written by us, read again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.exchange.dbat import lens_model, read_dbat, write_dbat
from photocal.geometry.camera import PARAMETERS, camera

pytestmark = pytest.mark.shared


def same(again: Block, block: Block) -> None:
    assert again.name == block.name
    assert again.images.names == block.images.names
    assert again.points.names == block.points.names
    assert np.array_equal(again.points.role, block.points.role)
    for own, other in ((again.points, block.points), (again.observations, block.observations)):
        np.testing.assert_allclose(own.values, other.values, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(own.sigma, other.sigma, rtol=1e-12)
    np.testing.assert_allclose(again.cameras[0].values, block.cameras[0].values, rtol=1e-9, atol=1e-15)
    assert np.array_equal(again.cameras[0].estimated, block.cameras[0].estimated)


@pytest.mark.parametrize("name", ["dbat-sxb/script/sxb.xml", "dbat-camcal/script/camcaldemo.xml"])
def test_round_trip_of_the_published_set_ups(shared: Path, tmp_path: Path, name: str) -> None:
    block = read_dbat(shared / "data" / name)
    same(read_dbat(write_dbat(tmp_path, block)), block)


@pytest.mark.parametrize("number", [-1, 3, 4])
def test_round_trip_of_adjusted_cameras(shared: Path, tmp_path: Path, number: int) -> None:
    """With distortion and affinity at their adjusted values, for each way of placing them."""
    block = read_dbat(shared / "data" / "dbat-camcal" / "script" / "camcaldemo.xml")
    solution = adjust(assemble(block).network)
    own = block.cameras[0].with_values(solution.cameras[0])
    if number == -1:
        free = own.estimated & (np.array(PARAMETERS) != "B1")
        values = np.where(np.array(PARAMETERS) == "B1", 0.0, own.values)
        own = replace(own, model="brown-ideal", affinity="additive", values=values, estimated=free)
    elif number == 4:
        own = replace(own, affinity="after")
    assert lens_model(own) == number
    block = replace(block, cameras=(own,))
    same(read_dbat(write_dbat(tmp_path, block)), block)


def test_what_has_no_place(shared: Path, tmp_path: Path) -> None:
    block = read_dbat(shared / "data" / "dbat-sxb" / "script" / "sxb.xml")
    own = block.cameras[0]
    in_px = camera("a", "brown-observed", "px", own.size_px, (1, 1), {"c": 20000.0})
    additive = replace(own, affinity="additive").changed(B1=1e-4)
    half = replace(own, estimated=np.array([name == "x0" for name in PARAMETERS]))
    weighted = replace(block.images, sigma=np.full(block.images.sigma.shape, 0.1))
    named = replace(block.points, names=("A", *block.points.names[1:]))
    for changed, message in (
        (replace(block, cameras=(in_px,)), "in mm"),
        (replace(block, cameras=(additive,)), "no equivalent"),
        (replace(block, cameras=(half,)), "together"),
        (replace(block, images=weighted), "orientations"),
        (replace(block, points=named), "not a number"),
    ):
        with pytest.raises(InputMalformedError, match=message):
            write_dbat(tmp_path, changed)

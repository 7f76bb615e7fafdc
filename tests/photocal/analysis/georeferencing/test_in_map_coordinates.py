"""A block in map coordinates gives what the same block gives in local ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import Proj, Transformer

import photocal
from photocal.analysis.accuracy.standard import Question
from photocal.analysis.georeferencing.comparison import check_block
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from tests.photocal.analysis.georeferencing.flights import Plan, fly

ORIGIN = (-51.41, -22.12, 400.0)


def in_utm(block: Block) -> Block:
    """The block at a place of zone 22 S, its local axes those of the topocentric frame there."""
    pipeline = Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=topocentric +ellps=GRS80 "
        f"+lon_0={ORIGIN[0]} +lat_0={ORIGIN[1]} +h_0={ORIGIN[2]} "
        "+step +inv +proj=cart +ellps=GRS80 +step +proj=utm +zone=22 +south +ellps=GRS80"
    )

    def moved(xyz: np.ndarray) -> np.ndarray:
        return np.column_stack(pipeline.transform(*xyz.T))

    grid = Proj("+proj=utm +zone=22 +south +ellps=GRS80")
    kappa = np.radians(grid.get_factors(ORIGIN[0], ORIGIN[1]).meridian_convergence)
    values = block.images.values.copy()
    values[:, 3:] = moved(values[:, 3:])
    values[:, 2] += kappa
    positions = replace(block.positions, values=moved(block.positions.values))
    points = replace(block.points, values=moved(block.points.values))
    images = replace(block.images, values=values)
    return replace(
        block,
        frame="EPSG:31982",
        height="ellipsoidal",
        images=images,
        points=points,
        positions=positions,
    )


def test_map_coordinates_and_local_ones_agree(tmp_path: Path) -> None:
    block = read_block(fly(tmp_path / "flight", np.random.default_rng(8), plan=Plan(tie=50)))
    local = check_block(block, (), Question())
    mapped = check_block(in_utm(block), (), Question())
    assert [one.result.method for one in mapped.judged] == ["direct", "integrated", "indirect"]
    indirect = [one.of("indirect") for one in (local, mapped)]
    assert indirect[0] is not None
    assert indirect[1] is not None
    # The axes differ by the convergence of the grid and by the scale of the map, not the lengths.
    lengths = [np.linalg.norm(one.check.d, axis=1) for one in indirect if one is not None]
    np.testing.assert_allclose(lengths[1], lengths[0], atol=2e-4)
    np.testing.assert_allclose(indirect[1].check.distance, indirect[0].check.distance, rtol=5e-3, atol=5e-3)
    # Maps are drawn in the given coordinates.
    assert np.all(indirect[1].check.xyz[:, 1] > 7e6)


def test_control_without_heights_holds_the_plane_alone(tmp_path: Path) -> None:
    """Three of nine points have no height; map coordinates are inclined to the object system."""
    block = read_block(fly(tmp_path / "flight", np.random.default_rng(8), plan=Plan(tie=50)))
    sigma, values = block.points.sigma.copy(), block.points.values.copy()
    level = np.flatnonzero(block.points.of_role("control"))[::3]
    sigma[level, 2] = np.inf
    # Nobody has measured it: some height near that of the others.
    values[level, 2] += 5.0
    local = replace(block, points=replace(block.points, values=values, sigma=sigma))
    mapped = in_utm(local)
    results = [photocal.adjust(one) for one in (local, mapped)]
    assert results[0].degrees_of_freedom == results[1].degrees_of_freedom
    assert results[1].degrees_of_freedom == photocal.adjust(in_utm(block)).degrees_of_freedom - len(level)
    assert results[1].chi_squared == pytest.approx(results[0].chi_squared, rel=1e-3)
    for one, result in zip((local, mapped), results, strict=True):
        points = assemble(one).network.points
        assert (points.observed.sum(axis=1) == 2).sum() == len(level)
        # Neither command blames a height that nobody has stated.
        assert "control" not in {one.code.split("-")[0] for one in photocal.analyse(one, result).findings}
        assert {judged.result.method for judged in photocal.check(one).judged} >= {"integrated", "indirect"}

"""Cameras on one frame in a block folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.adjustment.adjust import adjust
from photocal.adjustment.readout import with_lags
from photocal.adjustment.rig import OF_HEAD
from photocal.analysis.georeferencing.prepared import with_shutters
from photocal.base.errors import ConfigurationError
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.block.results.adjusted import adjusted, network_of, result_of
from photocal.block.results.folder import read_covariances, read_result, write_result
from photocal.block.writer import write_block
from tests.photocal import blocks, rigs


def test_a_block_keeps_its_rig(tmp_path: Path) -> None:
    flown, network = rigs.flight(np.random.default_rng(5), exposures=12, points=400, times=False)
    write_block(tmp_path, rigs.block_of(network))
    read = assemble(read_block(tmp_path)).network
    assert np.allclose(read.rig.rotation, network.rig.rotation, atol=1e-9)
    assert np.allclose(read.rig.values, network.rig.values, atol=1e-9)
    assert set(zip(read.rig.first, read.rig.second, strict=True)) == set(
        zip(network.rig.first, network.rig.second, strict=True)
    )
    solution = adjust(read)
    assert np.nanmax(np.abs(rigs.standardised(flown, read, solution))) < 3.5


def test_what_nothing_is_known_of_begins_as_the_images_lie() -> None:
    flown, network = rigs.flight(np.random.default_rng(6), exposures=12, points=400, times=False)
    block = rigs.block_of(network)
    free = np.array([np.inf] * 6 + [0.0])
    heads = tuple(
        replace(one, rotation=None, values=np.zeros(7), sigma=free) if one.camera != one.of else one
        for one in block.heads
    )
    solution = adjust(assemble(replace(block, heads=heads)).network)
    rig = assemble(replace(block, heads=heads)).network.rig
    found = solution.state.common[-35:].reshape(5, 7)
    true = Rotation.from_rotvec(flown.heads[:, :3]) * Rotation.from_rotvec(rigs.NOMINAL)
    off = (Rotation.from_rotvec(found[:, :3]) * Rotation.from_matrix(rig.rotation) * true.inv()).as_rotvec()
    sigma = np.sqrt(np.diag(solution.common_covariance)[-35:].reshape(5, 7))
    assert np.abs(off[1:] / sigma[1:, :3]).max() < 4.0
    assert np.abs((found - flown.heads)[1:, 3:6] / sigma[1:, 3:6]).max() < 4.0


def test_gusts_between_the_exposures_of_two_heads_are_none_of_their_errors() -> None:
    """One head exposes 0.15 s after the others; velocity and rates are known but for gusts."""
    rng = np.random.default_rng(8)
    flown, network = rigs.flight(rng, exposures=40, points=1000, aft_later_s=0.15)
    read = assemble(rigs.in_gusts(network, rng)).network
    solution = adjust(read)
    assert np.nanmax(np.abs(rigs.standardised(flown, read, solution))) < 3.5
    assert abs(solution.variance_factor - 1) < 4 * np.sqrt(2 / solution.degrees_of_freedom)


@pytest.mark.parametrize("later_s", [0.0, 0.01])
def test_gusts_count_for_the_time_between_heads_that_is_found(later_s: float) -> None:
    """How much later they expose is stated within 20 ms only."""
    rng = np.random.default_rng(9)
    flown, network = rigs.flight(rng, exposures=25, points=700, times=False, aft_later_s=later_s)
    block = rigs.in_gusts(network, rng, 0.02)
    stated = assemble(block)
    before = adjust(stated.network)
    settled, solution = adjusted(stated)
    rig = settled.network.rig
    assert np.nanmax(np.abs(rigs.standardised(flown, settled.network, solution))) < 3.5
    assert abs(solution.variance_factor - 1) < 4 * np.sqrt(2 / solution.degrees_of_freedom)
    assert np.abs(rig.lag[1:, 0] - flown.heads[1:, 6]).max() < 0.001
    assert rig.lag[:, 1].max() < 0.001
    # As the prior of the time itself, what is stated stays.
    assert np.array_equal(rig.sigma, stated.network.rig.sigma)
    turn, loosely = (
        np.sqrt(np.diag(s.common_covariance)[-35:].reshape(5, 7)[1:4, :3]) for s in (solution, before)
    )
    assert (turn < 0.9 * loosely).all()
    # Who adjusts the result anew has the network that it ended with.
    result = result_of(block, settled, solution)
    assert np.allclose(network_of(block, result).network.rig.lag, rig.lag)
    assert np.allclose(assemble(with_shutters(block)).network.rig.lag, rig.lag)
    assert with_lags(settled.network, solution) == (settled.network, solution)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ('camera = "other"\nof = "main"', "camera other"),
        ('camera = "main"\nof = "other"', "camera other"),
        ('camera = "main"\nof = "main"\nrotation_sigma_deg = 0.1', ""),
    ],
)
def test_what_is_wrong_with_a_head_is_said(tmp_path: Path, entry: str, said: str) -> None:
    folder = blocks.small(tmp_path / "block")
    setup = folder / "block.toml"
    setup.write_text(setup.read_text() + "\n[[head]]\n" + entry + "\n")
    if not said:
        assert [head.camera for head in read_block(folder).heads] == ["main"]
        return
    with pytest.raises(ConfigurationError, match=said):
        read_block(folder)


def test_the_run_folder_has_the_heads_with_their_covariance(tmp_path: Path) -> None:
    _, network = rigs.flight(np.random.default_rng(7), exposures=8, points=300)
    block = rigs.block_of(network)
    assembly = assemble(block)
    solution = adjust(assembly.network)
    result = result_of(block, assembly, solution)
    write_result(tmp_path, result)
    again = read_result(tmp_path).heads
    assert [one.camera for one in again] == list(rigs.HEADS[1:])
    for k, one in enumerate(again, start=1):
        assert one.of == "down"
        assert one.exposures == 8
        at = len(solution.state.common) - 35 + 7 * k
        own = solution.common_covariance[at : at + 7, at : at + 7]
        scale = np.array([np.degrees(1.0)] * 3 + [1.0] * 4)
        assert np.allclose(one.covariance(OF_HEAD), own * np.outer(scale, scale), rtol=1e-9, atol=1e-30)
        true = Rotation.from_rotvec(solution.state.common[at : at + 3]) * Rotation.from_rotvec(
            rigs.NOMINAL[k]
        )
        assert np.allclose(one.rotation_deg, np.degrees(true.as_rotvec()))
        known = read_covariances(tmp_path / "covariance.parquet", "head", (one.camera,), one.free)[0]
        assert np.allclose(known, one.covariance(), rtol=1e-9)

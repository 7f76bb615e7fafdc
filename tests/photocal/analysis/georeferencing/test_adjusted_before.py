"""The check of a block that was adjusted before is that of the block alone, with fewer adjustments."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.ledger import ledger
from photocal.analysis.accuracy.standard import Question
from photocal.analysis.georeferencing.comparison import BlockCheck, check_block
from photocal.analysis.searched_block import SearchedBlock
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.results.adjusted import adjustment_of
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly
from tests.photocal.analysis.georeferencing.test_in_map_coordinates import in_utm

PLAN = Plan(tie=40, estimate=("c", "x0", "y0", "K1"), mounting="lever_arm_sigma_m = 0.02")


def flown(folder: Path, *, mapped: bool) -> Block:
    """A flight with a time offset, in its local frame or on a map."""
    block = read_block(fly(folder, np.random.default_rng(8), Errors(time_offset_s=0.05), PLAN))
    return in_utm(block) if mapped else block


def same(one: BlockCheck, other: BlockCheck) -> None:
    """Compare the methods' errors at all ground points, images and causes of two checks, to a micrometre."""
    assert [judged.result.method for judged in one.judged] == ["direct", "integrated", "indirect"]
    assert one.refused == other.refused == ()
    for first, second in zip(one.judged, other.judged, strict=True):
        for group, again in zip(first.differences, second.differences, strict=True):
            np.testing.assert_allclose(group.d, again.d, atol=1e-6)
            np.testing.assert_allclose(group.product_sigma, again.product_sigma, rtol=1e-5)
        np.testing.assert_allclose(first.result.exposures[:, 3:], second.result.exposures[:, 3:], atol=1e-6)
    causes = (check.systematic for check in (one, other))
    first_causes, second_causes = (
        [error.hypothesis.name for error in found.errors] for found in causes if found
    )
    assert first_causes == second_causes
    assert "time-offset" in first_causes


@pytest.mark.parametrize("mapped", [False, True])
def test_the_same_as_without(tmp_path: Path, *, mapped: bool) -> None:
    block = flown(tmp_path / "block", mapped=mapped)
    known = SearchedBlock(adjustment_of(block))
    with ledger() as alone:
        without = check_block(block, (), Question(), on_the_job=True)
    with ledger() as shared:
        beside = check_block(block, (), Question(), on_the_job=True, known=known)
    same(without, beside)
    assert [entry.reason for entry in alone if entry not in shared] == ["integrated georeferencing"]


def test_an_adjustment_with_other_observations_is_not_taken(tmp_path: Path) -> None:
    """An image with three rays is adjusted with its position, but no method takes it."""
    block = flown(tmp_path / "block", mapped=False)
    rows = np.flatnonzero(block.observations.image == 0)
    kept = np.setdiff1d(np.arange(len(block.observations.image)), rows[3:])
    block = replace(block, observations=block.observations.rows(kept))
    known = SearchedBlock(adjustment_of(block))
    with ledger() as made:
        beside = check_block(block, (), Question(), on_the_job=True, known=known)
    assert "integrated georeferencing" in {entry.reason for entry in made}
    same(check_block(block, (), Question(), on_the_job=True), beside)

"""The condensed equations against the adjustments that they stand for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import fit
from photocal.adjustment.condensed import observed
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.hypotheses.causes import Candidates, Cause, candidates, freed
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.table import Fault
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

ESTIMATED = Plan(
    estimate=("c", "x0", "y0", "K1"), camera_sigma={"c": 0.003, "x0": 0.003, "y0": 0.003}, mounting=""
)
WRONG = Errors(lever_arm_m=(0.0, 0.04, 0.06), boresight_deg=(0.0, 0.1, 0.0), time_offset_s=0.01)
TESTED = tuple(fault for fault in FAULTS if fault.frees and fault.each in ("block", "strip"))


@pytest.fixture(scope="module", params=[Plan(), ESTIMATED], ids=["held camera", "observed camera"])
def block(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Block:
    folder = tmp_path_factory.mktemp("condensed") / "block"
    return read_block(fly(folder, np.random.default_rng(3), WRONG, request.param))


def opened(block: Block) -> Candidates:
    """Everything that may be freed, at the minimum of the block as it is."""
    return candidates(fit(assemble(block).network))


@pytest.mark.parametrize("fault", TESTED, ids=lambda fault: fault.code)
def test_freeing_is_predicted(block: Block, fault: Fault) -> None:
    """To second order: figures of a full adjustment of the freed block, from its own start values."""
    given = opened(block)
    network = assemble(block).network
    cameras, mounting = freed(network, (Cause(fault),))
    predicted = given.whole.solved(observed(given.whole.shared, cameras, mounting))[0]
    adjusted = adjust(replace(network, cameras=cameras, mounting=mounting))
    assert predicted.degrees_of_freedom == adjusted.degrees_of_freedom
    first = given.adjusted.solution
    fall = first.chi_squared - adjusted.chi_squared
    assert first.chi_squared - predicted.chi_squared == pytest.approx(fall, rel=0.005, abs=0.02)
    sigma = np.sqrt(np.diag(adjusted.common_covariance))
    assert np.abs(predicted.common - adjusted.state.common) == pytest.approx(0.0, abs=0.05 * sigma.max())
    np.testing.assert_allclose(np.sqrt(np.diag(predicted.common_covariance)), sigma, rtol=0.005)
    spread = np.sqrt(np.diagonal(adjusted.camera_covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(predicted.camera_covariance, axis1=1, axis2=2)), spread, rtol=0.005
    )
    assert (np.abs(predicted.cameras - adjusted.cameras) <= 0.05 * spread + 1e-15).all()


def test_nothing_freed_is_the_block_itself(block: Block) -> None:
    given = opened(block)
    first = given.adjusted.solution
    same = given.whole.solved(given.given)[0]
    assert same.chi_squared == pytest.approx(first.chi_squared, rel=1e-9)
    assert same.degrees_of_freedom == first.degrees_of_freedom
    # Beside the freed values, given a trillion times more weakly, digits are lost.
    np.testing.assert_allclose(same.camera_covariance, first.camera_covariance, rtol=1e-4, atol=1e-18)


def test_what_an_observed_value_tells(block: Block) -> None:
    """Held, observed and free in one: a lever arm of 2 cm sigma beside a free time offset."""
    sigma = block.mounting.sigma.copy()
    sigma[:3], sigma[6] = 0.02, np.inf
    other = replace(block, mounting=replace(block.mounting, sigma=sigma))
    whole = opened(block).whole
    predicted = whole.solved(observed(whole.shared, other.cameras, other.mounting))[0]
    adjusted = adjust(assemble(other).network)
    assert predicted.degrees_of_freedom == adjusted.degrees_of_freedom
    assert predicted.chi_squared == pytest.approx(adjusted.chi_squared, rel=1e-4)
    deviation = np.sqrt(np.diag(adjusted.common_covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(predicted.common_covariance)), deviation, rtol=0.005)


@pytest.mark.parametrize("kind", ["position", "control"])
def test_a_wrong_observation_is_predicted(block: Block, kind: str) -> None:
    """Its error beside all else, and beside a free lever arm, against adjustments without it."""
    given = opened(block)
    each = "image" if kind == "position" else "point"
    cause = next(cause for cause in given.causes if cause.fault.each == each)
    lever = next(cause for cause in given.causes if cause.fault.code == "lever-arm")
    network = assemble(block).network
    for beside in ((), (lever,)):
        chi_squared, freedom = given.fall(given.beyond(beside), beside, cause)
        cameras, mounting = freed(network, beside)
        without = replace(network, cameras=cameras, mounting=mounting)
        if kind == "position":
            without = replace(
                without, positions=without.positions.rows(without.positions.image != cause.members[0])
            )
        else:
            weight = without.points.weight.copy()
            weight[cause.members[0]] = 0.0
            without = replace(without, points=replace(without.points, weight=weight))
        alone = adjust(without)
        assert freedom == alone.degrees_of_freedom
        assert chi_squared == pytest.approx(alone.chi_squared, rel=1e-4)

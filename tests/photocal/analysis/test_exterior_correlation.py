"""Correlation of the camera with the exterior orientation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjusted import AdjustedNetwork, fit, lowest
from photocal.analysis.correlation import cause, correlation_with, exterior_correlations
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import angles_from_matrix


@pytest.fixture(scope="module")
def published(dcs460_block: Path) -> AdjustedNetwork:
    return fit(assemble(read_block(dcs460_block)).network)


@pytest.mark.parametrize("name", ["c", "x0", "K1"])
def test_an_adjustment_with_the_parameter_held_elsewhere_follows(
    published: AdjustedNetwork, name: str
) -> None:
    """Held a standard deviation away, everything else moves by its covariance with it."""
    at, own = PARAMETERS.index(name), published.network.cameras[0]
    sigma = float(np.sqrt(published.solution.camera_covariance[0, at, at]))
    estimated, values, start = own.estimated.copy(), own.values.copy(), published.state.cameras.copy()
    estimated[at], values[at], start[0, at] = False, start[0, at] + sigma, start[0, at] + sigma
    held = replace(published.network, cameras=(replace(own, estimated=estimated, values=values),))
    moved = lowest(held, replace(published.state, cameras=start)).state
    change = np.hstack(
        [
            angles_from_matrix(moved.rotation) - angles_from_matrix(published.state.rotation),
            moved.centre - published.state.centre,
        ]
    )
    spread = np.sqrt(np.diagonal(published.solution.exposure_covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(correlation_with(published, 0, at), change / spread, atol=0.01)


def test_no_correlation_leaves_its_bounds(published: AdjustedNetwork) -> None:
    for name in ("c", "x0", "K1"):
        r = correlation_with(published, 0, PARAMETERS.index(name))
        assert r.shape == (12, 6)
        assert np.all(np.abs(r) <= 1.0)


def test_strong_ones_are_listed_with_their_cause(published: AdjustedNetwork) -> None:
    found = exterior_correlations(published, 0, 0.5)
    assert found
    values = [abs(one.value) for one in found]
    assert values == sorted(values, reverse=True)
    assert all(0.5 <= value <= 1.0 for value in values)
    for one in found:
        assert one.cause == cause(one.parameter, one.element)
        assert 1 <= one.images <= 12


def test_nothing_is_over_one(published: AdjustedNetwork) -> None:
    assert exterior_correlations(published, 0, 1.01) == ()

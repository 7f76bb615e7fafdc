"""Correlation of the camera with the exterior orientation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.correlation import cause
from photocal.analysis.exterior_correlation import correlation_with, exterior_correlations, moved_by_one_sigma
from photocal.analysis.systematic_errors.refit import Fit, fit
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS


@pytest.fixture(scope="module")
def published(dcs460_block: Path) -> Fit:
    return fit(assemble(read_block(dcs460_block)).network)


def test_what_follows_a_parameter_is_its_covariance(published: Fit) -> None:
    """The other camera parameters, whose covariance the adjustment gives directly, as second method."""
    covariance = published.solution.camera_covariance[0]
    estimated = np.flatnonzero(published.network.cameras[0].estimated)
    for at in estimated:
        moved = moved_by_one_sigma(published, 0, int(at)).cameras[0] - published.state.cameras[0]
        expected = covariance[at] / np.sqrt(covariance[at, at])
        scale = np.sqrt(np.diag(covariance))[estimated]
        np.testing.assert_allclose(moved[estimated] / scale, expected[estimated] / scale, atol=0.01)


def test_no_correlation_leaves_its_bounds(published: Fit) -> None:
    for name in ("c", "x0", "K1"):
        r = correlation_with(published, 0, PARAMETERS.index(name))
        assert r.shape == (12, 6)
        assert np.all(np.abs(r) <= 1.0)


def test_strong_ones_are_listed_with_their_cause(published: Fit) -> None:
    found = exterior_correlations(published, 0, 0.5)
    assert found
    values = [abs(one.value) for one in found]
    assert values == sorted(values, reverse=True)
    assert all(0.5 <= value <= 1.0 for value in values)
    for one in found:
        assert one.cause == cause(one.parameter, one.element)
        assert 1 <= one.images <= 12


def test_nothing_is_over_one(published: Fit) -> None:
    assert exterior_correlations(published, 0, 1.01) == ()

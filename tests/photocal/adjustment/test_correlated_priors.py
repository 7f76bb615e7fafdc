"""Interior orientation observed with correlations, against the combination of two estimates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS

DEMO = Path(__file__).parents[3] / "photocal/demo/dcs460"


@pytest.mark.parametrize("r", [0.0, 0.9])
def test_a_correlated_prior_is_combined_with_the_observations(r: float) -> None:
    """x = C (C_a^-1 x_a + C_p^-1 x_p) with C = (C_a^-1 + C_p^-1)^-1, exact for a linear model."""
    network = assemble(read_block(DEMO)).network
    (own,) = network.cameras
    alone = adjust(network)
    at = np.flatnonzero(own.estimated)
    observed = np.flatnonzero(np.isin(at, [PARAMETERS.index(name) for name in ("c", "x0", "y0")]))
    c_a, x_a = alone.camera_covariance[0][np.ix_(at, at)], alone.cameras[0][at]
    formal = np.sqrt(np.diag(c_a))[observed]
    x_p = x_a[observed] + formal * np.array([1.0, -0.5, 0.3])
    correlation = np.full((3, 3), r) + (1.0 - r) * np.eye(3)
    c_p = np.outer(formal, formal) * correlation
    weight = np.zeros_like(c_a)
    weight[np.ix_(observed, observed)] = np.linalg.inv(c_p)
    expected = np.linalg.inv(np.linalg.inv(c_a) + weight)
    shifted = np.zeros(len(at))
    shifted[observed] = x_p
    x = expected @ (np.linalg.inv(c_a) @ x_a + weight @ shifted)

    values, sigma, whole = own.values.copy(), own.prior_sigma.copy(), np.eye(len(PARAMETERS))
    values[at[observed]], sigma[at[observed]] = x_p, formal
    whole[np.ix_(at[observed], at[observed])] = correlation
    camera = replace(own, values=values, prior_sigma=sigma, prior_correlation=whole)
    found = adjust(replace(network, cameras=(camera,)))
    spread = np.sqrt(np.diag(expected))
    np.testing.assert_allclose((found.cameras[0][at] - x) / spread, 0.0, atol=0.02)
    ratio = found.camera_covariance[0][np.ix_(at, at)] / np.outer(spread, spread)
    np.testing.assert_allclose(ratio, expected / np.outer(spread, spread), atol=0.02)

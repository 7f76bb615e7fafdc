"""Small blocks whose positions are off by much of the block's own width."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network
from photocal.geometry.camera import PARAMETERS
from tests.photocal import networks
from tests.photocal.networks import Scene


def narrow_block(seed: int) -> Network:
    """Two strips 4 m apart and 60 m long, positions said to be good to 1.5 m and wrong by 5 m."""
    rng = np.random.default_rng(seed)
    places = np.array([[x, y, 60.0 + x / 20] for y in (-2.0, 2.0) for x in np.linspace(-30, 30, 6)])
    points = np.column_stack([rng.uniform(-50, 50, 120), rng.uniform(-25, 25, 120), rng.uniform(-6, 6, 120)])
    own = networks.lens(estimate=("c", "K1"), K2=0.0, K3=0.0, P1=0.0, P2=0.0, B1=0.0, B2=0.0)
    known = np.array([name == "c" for name in PARAMETERS])
    own = replace(own, prior_sigma=np.where(known, 0.03 * own.value("c"), np.inf))
    scene = Scene((own,), np.zeros(12, np.int64), np.hstack([np.zeros((12, 3)), places]), points)
    sigma = np.full((12, 6), np.inf)
    sigma[:, 3:] = 1.5
    network = networks.observe(scene, rng, point_sigma=np.inf, exposure_sigma=sigma)
    values = network.exposures.values.copy()
    values[:, 3:] = places + rng.normal(0, 5.0, places.shape)
    return replace(network, exposures=replace(network.exposures, values=values))


def pull_of_positions(network: Network, centre: np.ndarray) -> float:
    observed, sigma = network.exposures.values[:, 3:], network.exposures.sigma[:, 3:]
    return float(np.sum(((centre - observed) / sigma) ** 2))


@pytest.mark.parametrize("seed", range(6))
def test_the_block_comes_to_rest_in_few_steps(seed: int) -> None:
    """No turn, shift or scale of the whole, which no ray resists, brings it nearer to its positions."""
    network = narrow_block(seed)
    solution = adjust(network)
    assert len(solution.iterations) <= 25
    centre = solution.exposures[:, 3:]
    middle, least = centre.mean(axis=0), pull_of_positions(network, centre)
    for amount in (-1e-3, 1e-3):
        for axis in np.eye(3):
            turned = (centre - middle) @ Rotation.from_rotvec(amount * axis).as_matrix().T + middle
            assert pull_of_positions(network, turned) > least
            assert pull_of_positions(network, centre + 10 * amount * axis) > least
        assert pull_of_positions(network, middle + (1 + amount) * (centre - middle)) > least

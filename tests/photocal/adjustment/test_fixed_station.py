"""Any station may carry the datum: residuals and what does not depend on the datum stay the same.

The tank study fixes station 1, 6 or 7 of its network, one of them near phi = 90 degrees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network
from photocal.adjustment.solution import Solution
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from tests.photocal import networks


def with_fixed(network: Network, station: int) -> Network:
    """The network with one exposure held and no other datum."""
    sigma = np.full_like(network.exposures.sigma, np.inf)
    sigma[station] = 0.0
    return replace(network, exposures=replace(network.exposures, sigma=sigma))


def distances(solution: Solution) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(solution.points[1:] - solution.points[:-1], axis=1))


@pytest.fixture(scope="module")
def network() -> Network:
    scene = networks.convergent()
    points = np.full((len(scene.points), 3), np.inf)
    free = networks.observe(scene, np.random.default_rng(11), point_sigma=points, disturb=0.0)
    first, second = np.zeros(1, np.int64), np.full(1, len(scene.points) - 1)
    length = np.linalg.norm(scene.points[-1:] - scene.points[:1], axis=1)
    relations = replace(
        free.relations, kind=first.copy(), first=first, second=second, values=length, sigma=np.full(1, 0.001)
    )
    # The object is turned so that the first camera looks along the horizon: phi = 89.6 degrees.
    matrix = matrix_from_angles(free.exposures.values[:, :3])
    wanted = matrix_from_angles(np.radians([[10.0, 89.6, 20.0]]))[0]
    turn = wanted.T @ matrix[0]
    values = free.exposures.values.copy()
    values[:, :3] = angles_from_matrix(matrix @ turn.T)
    values[:, 3:] = values[:, 3:] @ turn.T
    turned = replace(free.points, values=free.points.values @ turn.T)
    return replace(free, relations=relations, points=turned, exposures=replace(free.exposures, values=values))


def test_any_station_may_be_fixed(network: Network) -> None:
    solutions = [adjust(with_fixed(network, station)) for station in (0, 2, 3)]
    assert abs(np.degrees(network.exposures.values[0, 1])) == pytest.approx(89.6, abs=1e-6)
    for other in solutions[1:]:
        one = solutions[0]
        assert np.abs(other.residuals - one.residuals).max() < 1e-9
        assert np.abs(other.redundancy - one.redundancy).max() < 1e-7
        assert np.abs(distances(other) - distances(one)).max() < 1e-9
        assert other.chi_squared == pytest.approx(one.chi_squared, rel=1e-9)
        sigmas = [np.sqrt(np.diag(s.camera_covariance[0])) for s in (one, other)]
        assert np.abs(other.cameras - one.cameras).max() < 1e-9
        assert np.allclose(sigmas[0], sigmas[1], rtol=1e-6)

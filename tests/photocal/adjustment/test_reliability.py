"""Reliability against dense linear algebra, against re-adjusted networks, and against published figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network, Relations
from photocal.adjustment.reliability import (
    Reliability,
    external_reliability,
    minimal_detectable_bias,
    reliability,
)
from photocal.adjustment.solution import Solution
from photocal.base.chi_square import noncentrality
from tests.photocal import networks, oracle


@pytest.mark.parametrize(
    ("significance", "power", "published"),
    [(0.001, 0.80, 4.13), (0.05, 0.80, 2.80), (0.01, 0.80, 3.42), (0.001, 0.90, 4.57), (0.01, 0.90, 3.86)],
)
def test_noncentrality_of_the_textbooks(significance: float, power: float, published: float) -> None:
    """Nomograms of Baarda (1968)."""
    assert noncentrality(significance, power) == pytest.approx(published, abs=0.005)


def test_lambda0_for_two_dimensions() -> None:
    """The power of the chi-squared test with that non-centrality is the one asked for."""
    delta0 = noncentrality(0.001, 0.8, 2)
    assert stats.ncx2(2, delta0**2).sf(stats.chi2(2).isf(0.001)) == pytest.approx(0.8, abs=1e-9)


def test_values_by_hand() -> None:
    """r = 0.25: twice delta0 sigma, and delta0 sqrt(3)."""
    r = np.array([0.25, 1.0, 0.0])
    with np.errstate(divide="ignore"):
        assert minimal_detectable_bias(np.array([2.0, 2.0, 2.0]), r, 4.13) == pytest.approx(
            [16.52, 8.26, np.inf]
        )
        assert external_reliability(r, 4.13) == pytest.approx([4.13 * 3**0.5, 0.0, np.inf])


@pytest.fixture(scope="module")
def network() -> Network:
    first = networks.lens("one", estimate=("c", "x0", "y0", "K1"))
    second = networks.lens("two", estimate=("c",), c=24.0)
    sigma = np.full((14, 3), np.inf)
    sigma[:5] = 0.01
    sigma[5] = [0.02, 0.0, np.inf]
    scene = networks.convergent((first, second), points=14)
    made = networks.observe(scene, np.random.default_rng(3), point_sigma=sigma, missing=0.2)
    # One control point with correlated coordinates.
    weight = made.points.weight.copy()
    spread = np.array([[2.0, 0.8, 0.3], [0.8, 1.0, -0.2], [0.3, -0.2, 3.0]]) * 1e-4
    weight[2] = np.linalg.inv(spread)
    return replace(made, points=replace(made.points, weight=weight))


@pytest.fixture(scope="module")
def dense(network: Network) -> oracle.Result:
    return oracle.adjust_densely(network)


@pytest.fixture(scope="module")
def solution(network: Network) -> Solution:
    return adjust(network)


@pytest.fixture(scope="module")
def found(network: Network, solution: Solution) -> Reliability:
    return reliability(network, solution)


@pytest.fixture(scope="module")
def gain(dense: oracle.Result) -> np.ndarray:
    """Q A' P^(1/2): unknowns per whitened observation, by dense linear algebra."""
    return np.asarray(dense.covariance @ dense.design.T)


def test_rays_against_dense(network: Network, dense: oracle.Result, found: Reliability) -> None:
    delta0 = stats.norm.isf(0.0005) + stats.norm.ppf(0.8)
    assert found.noncentrality == pytest.approx(delta0, abs=1e-6)
    expected = delta0 * network.rays.sigma / np.sqrt(dense.redundancy)
    assert found.ray_bias == pytest.approx(expected, rel=1e-5)
    expected = delta0 * np.sqrt((1 - dense.redundancy) / dense.redundancy)
    assert found.ray_external == pytest.approx(expected, rel=1e-5)


def test_effect_on_c_against_dense(
    network: Network, dense: oracle.Result, gain: np.ndarray, found: Reliability
) -> None:
    rays = 2 * len(network.rays.image)
    camera = network.exposures.camera[network.rays.image]
    rows = np.array([gain[dense.column["camera", k, 0], :rays].reshape(-1, 2) for k in range(2)])
    own = rows[camera, np.arange(len(camera))]
    expected = own * found.ray_bias / network.rays.sigma
    assert found.ray_on_c == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_effect_on_points_against_dense(
    network: Network, dense: oracle.Result, gain: np.ndarray, found: Reliability
) -> None:
    for r in range(len(network.rays.image)):
        j = int(network.rays.point[r])
        for a in range(2):
            moved = np.array(
                [
                    gain[dense.column["point", j, n], 2 * r + a] if ("point", j, n) in dense.column else 0.0
                    for n in range(3)
                ]
            )
            moved *= found.ray_bias[r, a] / network.rays.sigma[r, a]
            assert found.ray_on_point[r, a] == pytest.approx(np.linalg.norm(moved), rel=1e-5)


def test_control_by_adjusting_with_the_bias(network: Network) -> None:
    """In a network without errors a bias of the stated size gives v'Pv = lambda0 (2 % of it: linear)."""
    j, n = 2, 1
    first = networks.lens("one", estimate=("c", "x0", "y0", "K1"))
    second = networks.lens("two", estimate=("c",), c=24.0)
    scene = networks.convergent((first, second), points=14)
    exact = networks.observe(scene, None, missing=0.2)
    exact = replace(
        exact,
        points=replace(network.points, values=scene.points),
        exposures=replace(exact.exposures, values=scene.exposures),
        cameras=scene.cameras,
    )
    again = adjust(exact)
    own = reliability(exact, again)
    biased = scene.points.copy()
    biased[j, n] += 0.02 * own.control_bias[j, n]
    moved = adjust(replace(exact, points=replace(exact.points, values=biased)))
    assert again.chi_squared < 1e-9
    assert 50 * np.sqrt(moved.chi_squared) == pytest.approx(4.132, abs=0.005)
    change = 50 * np.abs(moved.cameras[:, 0] - again.cameras[:, 0]).max()
    assert change == pytest.approx(own.control_on_c[j, n], rel=0.01)


def test_where_there_is_no_control(network: Network, found: Reliability) -> None:
    observed = np.diagonal(network.points.weight, axis1=1, axis2=2) > 0
    assert (np.isfinite(found.control_bias) == observed).all()
    assert (np.isfinite(found.control_external) == observed).all()
    assert (np.isfinite(found.control_on_c) == observed).all()


def test_no_function_moves_more_than_delta_bar(solution: Solution, found: Reliability) -> None:
    """Neither c nor the point: the effect is bounded by delta_bar standard deviations."""
    largest = np.sqrt(np.linalg.eigvalsh(solution.point_covariance)[:, -1])
    point = largest.max()
    assert (found.ray_on_point <= found.ray_external * point * (1 + 1e-9)).all()
    sigma_c = np.sqrt(solution.camera_covariance[:, 0, 0])
    assert (np.abs(found.ray_on_c) <= found.ray_external * sigma_c.max() * (1 + 1e-9)).all()


def test_free_network_with_a_distance() -> None:
    """Effects in a free network: a biased ray, adjusted again, moves its point by what was stated."""
    scene = networks.convergent(
        (networks.lens(estimate=("c",), K1=0.0, K2=0.0, K3=0.0, P1=0.0, P2=0.0, B1=0.0, B2=0.0),), points=12
    )
    base = networks.observe(scene, None, point_sigma=np.inf, disturb=1e-4)
    base = replace(base, points=replace(base.points, values=scene.points))
    relations = Relations(
        np.zeros(1, np.int64),
        np.array([0]),
        np.array([7]),
        np.array([np.linalg.norm(scene.points[0] - scene.points[7])]),
        np.array([0.001]),
    )
    free = replace(base, datum_points=np.zeros(0, np.int64), relations=relations)
    first = adjust(free)
    own = reliability(free, first)
    for r, a in ((5, 0), (0, 1)):  # a ray to a tie point, and one to an end of the distance
        plane = free.rays.plane.copy()
        plane[r, a] += 0.01 * own.ray_bias[r, a]
        moved = adjust(replace(free, rays=replace(free.rays, plane=plane)))
        j = int(free.rays.point[r])
        change = 100 * np.linalg.norm(moved.points[j] - first.points[j])
        assert change == pytest.approx(own.ray_on_point[r, a], rel=0.01)
        assert 100 * (moved.cameras[0, 0] - first.cameras[0, 0]) == pytest.approx(
            own.ray_on_c[r, a], rel=0.01
        )

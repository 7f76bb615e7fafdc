"""Laser distances as observations: their derivatives, against a dense adjustment, and what they bring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import fit, without_images
from photocal.adjustment.datum import with_datum
from photocal.adjustment.lasers import NO_LASERS, planes_ahead
from photocal.adjustment.network import Network
from photocal.adjustment.normal import Problem, other_equations, prepare
from photocal.adjustment.snooping import subset
from photocal.adjustment.state import State, moved_exposures, start_state
from photocal.adjustment.unknowns import unknowns
from photocal.adjustment.variance_components import rays_together, with_factors
from tests.photocal import networks
from tests.photocal.adjustment.test_against_dense import same

INF = np.inf


def test_a_plane_is_met_where_its_points_say() -> None:
    """The plane z = -10 + x/2 - y/4: its depth on the axis is 10, whatever the points."""
    xy = np.random.default_rng(1).uniform(-3, 3, (5, 3, 2))
    corners = np.dstack([xy, -10 + xy[..., 0] / 2 - xy[..., 1] / 4])
    met = planes_ahead(corners)
    assert met.distance == pytest.approx(10.0, rel=1e-12)
    assert met.share.sum(axis=1) == pytest.approx(1.0, rel=1e-12)
    assert np.einsum("nk,nka->na", met.share, corners) == pytest.approx(
        np.tile([0, 0, -10.0], (5, 1)), abs=1e-11
    )


@pytest.mark.parametrize("held", [False, True])
def test_derivatives_are_those_of_differences(held: bool) -> None:
    scene = networks.convergent(images=5, points=14)
    sigma = np.full((14, 3), INF)
    sigma[:5] = 0.0
    exposure = np.full((5, 6), INF)
    exposure[1, [0, 4]], exposure[2] = 0.0, 0.0
    more = {"point_sigma": sigma, "exposure_sigma": exposure} if held else {}
    network = networks.observe(scene, np.random.default_rng(2), **more)  # type: ignore[arg-type]
    network = networks.ranged(network, scene, np.random.default_rng(3))
    common_sigma = (0.0, 0.01) if held else (0.1, INF)
    network = replace(network, lasers=replace(network.lasers, common_sigma=common_sigma))
    problem, state = prepare(network), start_state(network)
    state.common[-2:] = 0.05, 0.02
    rows = other_equations(problem, state)["laser"]
    dense = np.zeros((5, problem.layout.size))
    for row in range(5):
        part = slice(rows.start[row], rows.start[row + 1])
        np.add.at(dense[row], rows.column[part], rows.coefficient[part])
    named, h = unknowns(problem), 1e-6
    for column in range(problem.layout.size):
        if named[column] is None:
            assert not dense[:, column].any()
            continue
        ahead, behind = (_residual(network, problem, state, column, sign * h) for sign in (1.0, -1.0))
        assert (ahead - behind) / (2 * h) == pytest.approx(dense[:, column], rel=1e-8, abs=2e-8)
    assert np.count_nonzero(dense.any(axis=0)) > 20


def _residual(
    network: Network, problem: Problem, state: State, column: int, size: float
) -> NDArray[np.float64]:
    step = np.zeros(problem.layout.size)
    step[column] = size
    moved = moved_exposures(network, problem.layout, state, step)
    points = state.points.copy()
    points[problem.layout.kept_points] += step[problem.layout.point_columns]
    return other_equations(problem, replace(moved, points=points))["laser"].residual


@pytest.mark.parametrize("common_sigma", [(0.02, 0.001), (INF, 0.0)])
def test_as_a_dense_adjustment(common_sigma: tuple[float, float]) -> None:
    scene = networks.convergent(images=5, points=12)
    network = networks.ranged(
        networks.observe(scene, np.random.default_rng(4)), scene, np.random.default_rng(5)
    )
    same(replace(network, lasers=replace(network.lasers, common_sigma=common_sigma)))


def test_beside_positions_and_rotated_images() -> None:
    scene = networks.convergent(images=6, points=18)
    network = networks.observe(scene, np.random.default_rng(6), point_sigma=INF)
    mounting, sigma = np.zeros(17), np.zeros(17)
    sigma[:3], sigma[9] = 0.05, 0.1
    network = networks.navigated(network, scene, np.random.default_rng(7), mounting, sigma)
    same(networks.ranged(network, scene, np.random.default_rng(8)))


def test_a_free_network_gets_its_scale_from_them() -> None:
    scene = networks.convergent(images=6, points=18)
    network = networks.observe(scene, np.random.default_rng(9), point_sigma=INF)
    network = replace(network, datum_points=np.zeros(0, dtype=np.int64))
    assert adjust(network).datum_defect == 7
    same(networks.ranged(network, scene, np.random.default_rng(10)), defect=6)


def test_a_network_without_them_is_what_it_was() -> None:
    scene = networks.convergent(images=6, points=18)
    network = networks.observe(scene, np.random.default_rng(11))
    ranged = networks.ranged(network, scene, np.random.default_rng(12))
    before, after = adjust(network), adjust(replace(ranged, lasers=NO_LASERS))
    for name in ("cameras", "exposures", "points", "residuals", "redundancy", "point_covariance"):
        assert getattr(before, name).tobytes() == getattr(after, name).tobytes()
    assert before.groups == after.groups
    assert {"laser", "laser-offset"} <= {group.name for group in adjust(ranged).groups}


def test_images_and_points_that_go_take_their_distances_along() -> None:
    scene = networks.convergent(images=8, points=24)
    network = networks.ranged(networks.observe(scene, np.random.default_rng(13)), scene, None)
    at = fit(network)
    out = np.arange(8) == 2
    smaller, state = without_images(network, at.state, out)
    assert smaller.lasers.image.tolist() == list(range(7))
    assert np.array_equal(smaller.lasers.values, np.delete(network.lasers.values, 2))
    assert [smaller.point_names[j] for j in smaller.lasers.corners[4]] == [
        network.point_names[j] for j in network.lasers.corners[5]
    ]
    again = adjust(smaller)
    assert fit(smaller, state).solution.chi_squared == pytest.approx(again.chi_squared, rel=1e-8)
    assert len(with_datum(prepare(smaller), state).stiffened) == 0


def test_sigmas_of_both_groups_are_scaled() -> None:
    scene = networks.convergent(images=6, points=18)
    network = networks.ranged(networks.observe(scene, None), scene, None, (0.02, 0.001))
    scaled = with_factors(network, rays_together(network), {"laser": 2.0, "laser-offset": 3.0})
    assert scaled.lasers.sigma == pytest.approx(2 * network.lasers.sigma)
    assert scaled.lasers.common_sigma == pytest.approx((0.06, 0.003))


def test_a_corner_that_snooping_takes_away_takes_its_distances_along() -> None:
    scene = networks.convergent(images=6, points=18)
    network = networks.observe(scene, np.random.default_rng(14), point_sigma=INF)
    network = networks.ranged(network, scene, np.random.default_rng(15))
    corners, uses = np.unique(network.lasers.corners, return_counts=True)
    lost = corners[np.argmin(uses)]
    part, _, points = subset(network, network.rays.point != lost)
    kept = (network.lasers.corners != lost).all(axis=1)
    assert lost not in points
    assert 0 < kept.sum() < 6
    assert np.array_equal(points[part.lasers.corners], network.lasers.corners[kept])
    assert np.array_equal(part.lasers.image, network.lasers.image[kept])
    assert part.lasers.common_sigma == network.lasers.common_sigma

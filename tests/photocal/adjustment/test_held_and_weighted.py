"""One rule everywhere: sigma 0 holds a value, a number makes it an observation, none leaves it free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.geometry.camera import PARAMETERS
from tests.photocal import flights, networks

INF = np.inf


def test_held_exposures_keep_their_values() -> None:
    sigma = np.full((6, 6), INF)
    sigma[0], sigma[1, 4], sigma[2, 1] = 0.0, 0.0, 0.0
    given = networks.observe(networks.convergent(), np.random.default_rng(1), exposure_sigma=sigma)
    solution = adjust(given)
    held = sigma == 0
    assert solution.exposures[held] == pytest.approx(given.exposures.values[held], abs=1e-14)
    variance = np.diagonal(solution.exposure_covariance, axis1=1, axis2=2)
    assert not variance[held].any()
    assert (variance[~held] > 0).all()


def test_held_coordinates_keep_their_values() -> None:
    sigma = np.full((20, 3), 0.003)
    sigma[0], sigma[1, 2] = 0.0, 0.0
    given = networks.observe(networks.convergent(), np.random.default_rng(2), point_sigma=sigma)
    solution = adjust(given)
    held = sigma == 0
    assert np.array_equal(solution.points[held], given.points.values[held])
    variance = np.diagonal(solution.point_covariance, axis1=1, axis2=2)
    assert np.array_equal(variance[held], np.zeros(4))
    assert (variance[~held] > 0).all()


def test_parameters_not_estimated_keep_their_values() -> None:
    own = networks.lens(estimate=("c", "x0"))
    given = networks.observe(networks.convergent((own,)), np.random.default_rng(3))
    solution = adjust(given)
    kept = ~own.estimated
    assert np.array_equal(solution.cameras[0, kept], own.values[kept])
    assert not solution.camera_covariance[0][kept].any()
    assert not solution.camera_covariance[0][:, kept].any()


def test_a_tight_sigma_nears_a_held_value() -> None:
    scene = networks.convergent()
    tight, held = np.full((6, 6), INF), np.full((6, 6), INF)
    tight[:, 3:], held[:, 3:] = 1e-7, 0.0
    weighted, fixed = (
        adjust(networks.observe(scene, None, exposure_sigma=sigma, point_sigma=0.01))
        for sigma in (tight, held)
    )
    assert weighted.points == pytest.approx(fixed.points, abs=1e-7)
    assert weighted.point_covariance == pytest.approx(fixed.point_covariance, rel=1e-3, abs=1e-12)
    assert weighted.observations - fixed.observations == 18
    assert weighted.degrees_of_freedom == fixed.degrees_of_freedom


def test_a_loose_sigma_nears_a_free_value() -> None:
    scene = networks.convergent()
    loose, free = (
        adjust(networks.observe(scene, None, exposure_sigma=sigma, point_sigma=0.01)) for sigma in (1e4, INF)
    )
    assert loose.exposure_covariance == pytest.approx(free.exposure_covariance, rel=1e-6, abs=1e-12)
    assert loose.degrees_of_freedom == free.degrees_of_freedom + 36
    group = {g.name: g for g in loose.groups}["exposure"]
    assert group.observations == 36
    assert group.redundancy == pytest.approx(36, abs=1e-3)


def test_observations_without_errors_give_the_truth() -> None:
    own = networks.lens(estimate=("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1", "B2"))
    scene = networks.convergent((own, networks.lens("b", "brown-ideal", estimate=PARAMETERS[:7])), images=8)
    solution = adjust(networks.observe(scene, None, missing=0.2))
    assert solution.chi_squared < 1e-10
    sigma = np.sqrt(np.diagonal(solution.camera_covariance, axis1=1, axis2=2))
    true = np.array([camera.values for camera in scene.cameras])
    free = sigma > 0
    assert np.abs((solution.cameras - true)[free] / sigma[free]).max() < 1e-5
    assert solution.points == pytest.approx(scene.points, abs=1e-9)
    assert solution.exposures[:, 3:] == pytest.approx(scene.exposures[:, 3:], abs=1e-7)


def test_far_start_values_are_damped() -> None:
    scene = networks.convergent()
    near = adjust(networks.observe(scene, np.random.default_rng(4)))
    far = adjust(networks.observe(scene, np.random.default_rng(4), disturb=1.0))
    assert far.cameras == pytest.approx(near.cameras, rel=1e-4, abs=1e-6)
    assert far.chi_squared == pytest.approx(near.chi_squared, rel=1e-6)


def test_positions_that_are_metres_off_do_not_turn_the_block_first() -> None:
    """Given angles and points tell where the images were: from there the minimum is near."""
    rng = np.random.default_rng(4)
    network = flights.measured(flights.flight(flights.wide(distortion=0.0), rng, images=20, points=300), rng)
    sigma = np.tile([INF, INF, INF, 5.0, 5.0, 5.0], (20, 1))
    network = replace(network, exposures=replace(network.exposures, sigma=sigma))
    first = adjust(network)
    poses = first.exposures.copy()
    poses[:, 3:] = network.exposures.values[:, 3:] + rng.normal(0.0, 5.0, (20, 3))
    oriented = replace(
        network,
        cameras=(network.cameras[0].with_values(first.cameras[0]),),
        exposures=replace(network.exposures, values=poses),
        points=replace(network.points, values=first.points),
    )
    # From the observed positions the rays miss by hundreds of pixels.
    assert adjust(oriented).iterations[0].decrement < 1e5

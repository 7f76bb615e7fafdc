"""The adjustment against a plain dense one: values, every covariance block, redundancy numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.kernels import statistics
from photocal.adjustment.network import Network
from photocal.geometry.camera import (
    AFFINITIES,
    AFFINITY_MATRICES,
    MODELS,
    PARAMETERS,
    Affinity,
    AffinityForm,
    Model,
    ReadoutDirection,
)
from tests.photocal import networks, oracle

ALL = ("c", "x0", "y0", "K1", "K2", "P1", "P2", "B1", "B2")
INF = np.inf


def same(network: Network, tolerance: float = 1e-5, defect: int = 0) -> None:
    """Compare everything that both know, in units of the standard deviations."""
    ours, plain = adjust(network), oracle.adjust_densely(network, defect=defect)
    assert ours.observations == plain.observations
    assert ours.unknowns == len(plain.covariance)
    assert ours.datum_defect == defect
    assert ours.degrees_of_freedom == ours.observations - ours.unknowns + defect
    assert ours.chi_squared == pytest.approx(plain.chi_squared, rel=1e-8)
    assert sum(group.redundancy for group in ours.groups) == pytest.approx(ours.degrees_of_freedom, abs=1e-6)
    assert sum(group.chi_squared for group in ours.groups) == pytest.approx(ours.chi_squared)
    assert ours.redundancy == pytest.approx(plain.redundancy, abs=1e-6)
    assert np.abs((ours.residuals - plain.residuals) / network.rays.sigma).max() < 2e-4
    for kind, values, theirs, covariance in (
        ("camera", ours.cameras, plain.cameras, ours.camera_covariance),
        ("exposure", ours.exposures, plain.exposures, ours.exposure_covariance),
        ("point", ours.points, plain.points, ours.point_covariance),
        ("common", ours.state.common[None], plain.common[None], ours.common_covariance[None]),
    ):
        for index in range(len(values)):
            expected = plain.block(kind, index, values.shape[1])
            sigma = np.sqrt(np.diag(expected))
            scale = np.where(sigma > 0, sigma, 1.0)
            error = values[index] - theirs[index]
            if kind == "exposure":
                error[:3] = (error[:3] + np.pi) % (2 * np.pi) - np.pi
            assert np.abs(error / scale).max() < 2e-3, (kind, index)
            assert np.abs((covariance[index] - expected) / np.outer(scale, scale)).max() < tolerance, (
                kind,
                index,
            )
    own = ours.photo_variant
    for row, (image, n) in enumerate(zip(own.image.tolist(), own.parameter.tolist(), strict=True)):
        k = network.exposures.camera[image]
        at, common = plain.column["deviation", image, n], plain.column.get(("camera", int(k), n))
        sigma = np.sqrt(plain.covariance[at, at])
        both = [at] if common is None else [at, common]
        assert own.deviations[row] == pytest.approx(plain.deviations[image, n], abs=2e-3 * sigma)
        given = plain.cameras[k, n] if n < len(PARAMETERS) else 0.0
        # What shakes has nothing given.
        if len(PARAMETERS) <= n < len(PARAMETERS) + 6:
            assert network.exposures.motion is not None
            given = (
                plain.cameras[k, PARAMETERS.index("readout")]
                * network.exposures.motion[image, n - len(PARAMETERS)]
            )
        assert own.values[row] == pytest.approx(given + plain.deviations[image, n], abs=2e-3 * sigma)
        assert own.deviation_sigma[row] == pytest.approx(sigma, rel=tolerance)
        if n < len(PARAMETERS):
            expected = np.sqrt(plain.covariance[np.ix_(both, both)].sum())
            assert own.sigma[row] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("model", ["brown-observed", "brown-ideal"])
@pytest.mark.parametrize("affinity", AFFINITIES)
@pytest.mark.parametrize("form", AFFINITY_MATRICES)
def test_every_camera_model(model: Model, affinity: Affinity, form: AffinityForm) -> None:
    # Over a free exposure the forms with a rotation inside are as well determined as the others.
    own = networks.lens(model=model, affinity=affinity, affinity_form=form, estimate=ALL)
    same(networks.observe(networks.convergent((own,), images=4, points=11), np.random.default_rng(3)))


@pytest.mark.parametrize("affinity", AFFINITIES)
def test_polynomial_at_the_measured_coordinates(affinity: Affinity) -> None:
    own = replace(networks.lens(affinity=affinity, estimate=ALL), distortion_at="measured")
    same(networks.observe(networks.convergent((own,), images=4, points=11), np.random.default_rng(3)))


def test_large_errors_inside_the_polynomial() -> None:
    """Ten times the error and strong distortion: what is small of the second order shows."""
    own = networks.lens(estimate=ALL, K1=-6e-4, P1=1e-4)
    scene = networks.convergent((own,), images=5, points=14)
    same(networks.observe(scene, np.random.default_rng(3), sigma=0.03), 1e-4)


def test_all_parameters_with_priors() -> None:
    prior = {"K3": 1e-9, "K4": 1e-12, "P3": 1e-2, "P4": 1e-4, "x0": 0.05, "c": 0.1}
    # But for the readout: images that stand still tell nothing of it.
    own = networks.lens(estimate=MODELS["brown-observed"].names[:-1], prior_sigma=prior)
    # P3 and P4 multiply P1 and P2: the last 1e-4 sigma of the iteration shows in the covariance.
    same(networks.observe(networks.convergent((own,), images=5, points=14), np.random.default_rng(4)), 2e-4)


def test_several_cameras_of_different_models() -> None:
    cameras = (
        networks.lens("a"),
        networks.lens("b", "brown-ideal", estimate=("c", "x0", "K1"), c=24.0),
        networks.lens("c", estimate=()),
    )
    same(networks.observe(networks.convergent(cameras, images=6, points=15), np.random.default_rng(5)))


@pytest.mark.parametrize(
    ("photo_variant", "estimate"),
    [
        ({"x0": 0.02, "y0": 0.03}, ("c", "x0", "y0", "K1")),
        ({"c": 0.05, "x0": 0.02, "K1": 1e-6, "B1": 1e-4}, ("c", "x0", "y0", "K1")),
        ({"c": INF}, ("x0", "y0", "K1")),
    ],
    ids=["weighted", "more than three", "free"],
)
def test_photo_variant_parameters(photo_variant: dict[str, float], estimate: tuple[str, ...]) -> None:
    cameras = (
        networks.lens("a", estimate=estimate, photo_variant=photo_variant),
        networks.lens("b", "brown-ideal", estimate=("c", "x0", "K1"), c=24.0),
    )
    sigma = np.full((16, 3), 0.003)
    same(
        networks.observe(
            networks.convergent(cameras, images=6, points=16), np.random.default_rng(15), point_sigma=sigma
        )
    )


@pytest.mark.parametrize("model", ["brown-observed", "brown-ideal"])
def test_distortion_that_varies_with_the_distance(model: Model) -> None:
    own = networks.lens(model=model, focus_m=9.0, estimate=ALL)
    scene = networks.convergent((own,), images=5, points=14)
    same(networks.observe(scene, np.random.default_rng(16)))


DIRECTIONS: tuple[ReadoutDirection, ...] = (
    "top-to-bottom", "bottom-to-top", "left-to-right", "right-to-left",
)  # fmt: skip


def rolling(model: Model, direction: ReadoutDirection, sigma: float, **more: Any) -> Network:
    """A network whose images move by metres and turn by degrees while they are read."""
    own = networks.lens(model=model, estimate=(*ALL[:7], "readout"), K3=0.0, **more)
    own = replace(own, readout_direction=direction)
    network = networks.observe(networks.convergent((own,), images=5, points=18), np.random.default_rng(21))
    rng = np.random.default_rng(22)
    motion = np.hstack([rng.normal(0, 3, (5, 3)), rng.normal(0, 0.5, (5, 3))])
    values = network.cameras[0].values.copy()
    values[PARAMETERS.index("readout")] = 0.01
    moving = replace(network.exposures, motion=motion, motion_sigma=np.full((5, 6), sigma))
    return replace(network, cameras=(network.cameras[0].with_values(values),), exposures=moving)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_rolling_shutter_in_a_known_motion(direction: ReadoutDirection) -> None:
    model: Model = "brown-ideal" if direction.endswith("bottom") else "brown-observed"
    same(rolling(model, direction, 0.0))


def test_rolling_shutter_in_an_uncertain_motion() -> None:
    network = rolling("brown-observed", "top-to-bottom", 0.3, prior_sigma={"readout": 0.005})
    sigma = np.array(network.exposures.motion_sigma)
    sigma[:, :3], sigma[0], sigma[1, 4] = 2.0, 0.0, 0.0
    same(replace(network, exposures=replace(network.exposures, motion_sigma=sigma)), 1e-4)


def test_images_that_shake_while_they_are_read() -> None:
    network = rolling("brown-ideal", "top-to-bottom", 0.3)
    shaking = replace(network.cameras[0], shake=(1e-4, 5e-5, 5e-5, 3e-5, 1e-5, 5e-6))
    same(replace(network, cameras=(shaking,)), 1e-4)


def test_weighted_exposures_and_tie_points() -> None:
    exposure = np.array([0.002, 0.002, 0.001, 0.02, 0.03, 0.02])
    network = networks.observe(
        networks.convergent(images=5, points=14),
        np.random.default_rng(6),
        point_sigma=INF,
        exposure_sigma=exposure,
        missing=0.2,
    )
    same(network)


def test_points_of_every_kind() -> None:
    sigma = np.full((16, 3), INF)
    sigma[:6] = 0.003
    sigma[6] = [0.0, 0.002, INF]
    sigma[7] = [INF, INF, 0.001]
    sigma[8] = 0.0
    same(
        networks.observe(
            networks.convergent(images=4, points=16), np.random.default_rng(7), point_sigma=sigma
        )
    )


def test_exposure_elements_of_every_kind() -> None:
    sigma = np.full((5, 6), INF)
    sigma[0] = 0.0
    sigma[1, 3:] = [0.0, 0.01, INF]
    sigma[2, :3] = [0.0, INF, 0.001]
    sigma[3, 1] = 0.0005
    same(
        networks.observe(
            networks.convergent(images=5, points=14), np.random.default_rng(8), exposure_sigma=sigma
        )
    )


def test_correlated_control_coordinates() -> None:
    network = networks.observe(networks.convergent(images=4, points=12), np.random.default_rng(9))
    root = np.array([[0.003, 0, 0], [0.002, 0.003, 0], [-0.001, 0.002, 0.004]])
    weight = np.broadcast_to(np.linalg.inv(root @ root.T), (12, 3, 3)).copy()
    same(replace(network, points=replace(network.points, weight=weight)))


def test_observations_with_their_own_sigmas() -> None:
    network = networks.observe(networks.convergent(images=4, points=14), np.random.default_rng(10))
    sigma = np.random.default_rng(1).uniform(0.001, 0.01, network.rays.sigma.shape)
    same(replace(network, rays=replace(network.rays, sigma=sigma)))


def test_distances_height_differences_and_azimuths() -> None:
    scene, rng = networks.convergent(images=5, points=14), np.random.default_rng(11)
    sigma = np.array([0.001, 0.001, 0.0005, 0.002, 0.001, 0.0003, 0.001])
    network = networks.observe(scene, rng, point_sigma=0.01, missing=0.1)
    same(networks.related(network, scene, rng, [0, 1, 2, 0, 1, 2, 0], sigma))


def test_angles_and_straight_lines() -> None:
    """Points 4 and 10 lie on lines through two others; the rays have them a few mm beside."""
    scene, rng = networks.convergent(images=5, points=14), np.random.default_rng(19)
    for k in (4, 10):
        scene.points[k + 2] = 0.4 * scene.points[k] + 0.6 * scene.points[k + 1]
    network = networks.observe(scene, rng, point_sigma=0.01, missing=0.1)
    kinds = [3, 4, 3, 4, 5, 4, 3, 0, 4, 2, 5]
    sigma = np.where(np.array(kinds) == 5, 0.001, 0.0005)
    same(networks.related(network, scene, rng, kinds, sigma))


def test_relations_with_held_points() -> None:
    scene, rng = networks.convergent(images=5, points=14), np.random.default_rng(12)
    sigma = np.full((14, 3), INF)
    sigma[:4], sigma[0], sigma[1, 2] = 0.01, 0.0, 0.0
    network = networks.observe(scene, rng, point_sigma=sigma)
    same(networks.related(network, scene, rng, [0, 1, 2, 0, 1, 2], np.full(6, 0.001)))
    same(networks.related(network, scene, rng, [3, 4, 4, 3], np.full(4, 0.001)))


LEVER = [0.3, -0.1, -0.4]
BORESIGHT = [0.01, -0.02, 0.015]


FLIGHT = [0.05, -0.03, 0.12, 0.02]


def mounting(strips: int) -> list[float]:
    return [*LEVER, *BORESIGHT, 0.02, *FLIGHT] + [0.1, -0.2, 0.15, 0.01, -0.02, 0.005] * strips


def test_antenna_positions_and_attitudes_with_a_known_mounting() -> None:
    scene, rng = networks.convergent(images=6, points=14), np.random.default_rng(15)
    network = networks.observe(scene, rng, point_sigma=INF)
    true = np.array([*LEVER, *BORESIGHT, 0.02, *[0.0] * 10])
    same(networks.navigated(network, scene, rng, true, np.zeros(17)))


def test_shift_and_drift_of_strips() -> None:
    scene, rng = networks.convergent(images=8, points=16), np.random.default_rng(17)
    network = networks.observe(scene, rng, point_sigma=0.01)
    sigma = np.array([0.0] * 11 + [INF, INF, 0.2, 0.05, INF, 0.05, 0.3, INF, INF, INF, 0.1, 0.0])
    network = networks.navigated(network, scene, rng, np.array(mounting(2)), sigma, strips=2)
    same(network)


def test_positions_without_attitudes_beside_weighted_exposures() -> None:
    scene, rng = networks.convergent(images=6, points=16), np.random.default_rng(18)
    network = networks.observe(scene, rng, point_sigma=INF, exposure_sigma=np.array([0.01] * 3 + [INF] * 3))
    sigma = np.array([0.02] * 3 + [0.0] * 3 + [0.01] + [0.0] * 10)
    true = np.array([*LEVER, 0, 0, 0, 0.01, *[0.0] * 10])
    same(networks.navigated(network, scene, rng, true, sigma, attitudes=False))


@pytest.mark.parametrize("datum", [[], [0, 3, 5, 8, 11]], ids=["all points", "some points"])
def test_free_network(datum: list[int]) -> None:
    scene = networks.convergent(images=5, points=14)
    network = networks.observe(scene, np.random.default_rng(13), point_sigma=INF)
    same(replace(network, datum_points=np.array(datum, dtype=np.int64)), defect=7)


def test_free_network_with_a_scale() -> None:
    scene, rng = networks.convergent(images=5, points=14), np.random.default_rng(14)
    network = networks.observe(scene, rng, point_sigma=INF)
    network = networks.related(network, scene, rng, [0, 0, 0], np.full(3, 0.001))
    same(replace(network, datum_points=np.array([], dtype=np.int64)), defect=6)


def test_lever_arm_boresight_and_time_offset_estimated() -> None:
    scene, rng = networks.convergent(images=8, points=16), np.random.default_rng(16)
    network = networks.observe(scene, rng, point_sigma=0.01)
    sigma = np.array([INF, INF, 0.05, INF, 0.02, INF, INF, *[0.0] * 10])
    true = np.array([*LEVER, *BORESIGHT, 0.02, *[0.0] * 10])
    same(networks.navigated(network, scene, rng, true, sigma))


def test_shift_and_height_scale_of_the_flight() -> None:
    scene, rng = networks.convergent(images=8, points=16), np.random.default_rng(19)
    network = networks.observe(scene, rng, point_sigma=0.01)
    sigma = np.array([0.05, INF, 0.05, *[0.0] * 4, INF, 0.1, 0.2, 0.05, *[0.0] * 6])
    true = np.array([*LEVER, 0, 0, 0, 0, *FLIGHT, *[0.0] * 6])
    same(networks.navigated(network, scene, rng, true, sigma))


def test_few_images_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that follow each other are worked on together until their images are too many."""
    monkeypatch.setattr(statistics, "NEIGHBOURS", 7)
    images, points = 12, 36
    cameras = networks.lens("one"), networks.lens("two", estimate=ALL)
    scene = networks.convergent(cameras, images=images, points=points)
    known = np.where(np.arange(points)[:, None] % 4, INF, 0.003)
    network = networks.observe(scene, np.random.default_rng(8), point_sigma=known)
    rays = network.rays
    some = (rays.image - rays.point) % images < 3 + rays.point % 4
    same(replace(network, rays=rays.rows(some)))

"""What must not matter: the order of images and points, and the frame that coordinates are given in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.adjustment import normal
from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network
from photocal.adjustment.normal import prepare
from photocal.base import compiled
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from tests.photocal import networks


def network() -> Network:
    sigma = np.full((20, 3), np.inf)
    sigma[:8] = 0.003
    return networks.observe(networks.convergent(), np.random.default_rng(11), point_sigma=sigma, missing=0.15)


def reordered(given: Network, images: np.ndarray, points: np.ndarray) -> Network:
    """The same network with images[k] and points[k] at place k."""
    new_image, new_point = np.argsort(images), np.argsort(points)
    exposures, rays = given.exposures, given.rays
    order = np.lexsort((new_image[rays.image], new_point[rays.point]))
    return replace(
        given,
        exposures=replace(
            exposures,
            camera=exposures.camera[images],
            values=exposures.values[images],
            sigma=exposures.sigma[images],
        ),
        points=replace(
            given.points,
            values=given.points.values[points],
            held=given.points.held[points],
            weight=given.points.weight[points],
        ),
        rays=replace(
            rays,
            image=new_image[rays.image][order],
            point=new_point[rays.point][order],
            plane=rays.plane[order],
            sigma=rays.sigma[order],
        ),
        image_names=tuple(given.image_names[k] for k in images),
        point_names=tuple(given.point_names[k] for k in points),
    )


@pytest.mark.parametrize("seed", range(5))
def test_order_of_images_and_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = network()
    images, points = rng.permutation(6), rng.permutation(20)
    one, other = adjust(given), adjust(reordered(given, images, points))
    assert other.chi_squared == pytest.approx(one.chi_squared, rel=1e-9)
    assert other.cameras == pytest.approx(one.cameras, rel=1e-6, abs=1e-9)
    assert other.exposures == pytest.approx(one.exposures[images], abs=1e-7)
    assert other.points == pytest.approx(one.points[points], abs=1e-8)
    assert other.camera_covariance == pytest.approx(one.camera_covariance, rel=1e-5, abs=1e-25)
    assert other.exposure_covariance == pytest.approx(one.exposure_covariance[images], rel=1e-5, abs=1e-12)
    assert other.point_covariance == pytest.approx(one.point_covariance[points], rel=1e-5, abs=1e-13)


@pytest.mark.parametrize("angles", [(0.3, -0.2, 2.0), (1.5, 0.0, 0.0), (0.0, 0.0, np.pi)])
def test_rotation_of_the_object_frame(angles: tuple[float, float, float]) -> None:
    given = network()
    one = adjust(given)
    turn, shift = matrix_from_angles(np.array(angles)), np.array([10.0, -20.0, 5.0])
    matrix = matrix_from_angles(given.exposures.values[:, :3]) @ turn.T
    exposures = np.hstack([angles_from_matrix(matrix), given.exposures.values[:, 3:] @ turn.T + shift])
    other = adjust(
        replace(
            given,
            exposures=replace(given.exposures, values=exposures),
            points=replace(
                given.points,
                values=given.points.values @ turn.T + shift,
                weight=turn @ given.points.weight @ turn.T,
            ),
        )
    )
    assert other.chi_squared == pytest.approx(one.chi_squared, rel=1e-9)
    assert other.points == pytest.approx(one.points @ turn.T + shift, abs=1e-8)
    assert other.point_covariance == pytest.approx(turn @ one.point_covariance @ turn.T, rel=1e-5, abs=1e-13)
    assert other.camera_covariance == pytest.approx(one.camera_covariance, rel=1e-5, abs=1e-25)
    assert other.redundancy == pytest.approx(one.redundancy, abs=1e-7)
    expected = matrix_from_angles(one.exposures[:, :3]) @ turn.T
    assert matrix_from_angles(other.exposures[:, :3]) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("phi", [89.6, 90.0, -90.0])
def test_a_station_near_the_lock_adjusts_like_any_other(phi: float) -> None:
    # The same scene, once upright and once in a frame in which image 0 looks along X.
    given = networks.convergent()
    first = matrix_from_angles(given.exposures[0, :3])
    wanted = matrix_from_angles(np.array([0.3, np.radians(phi), 0.8]))
    scene = given.turned(wanted.T @ first, np.zeros(3))
    upright = adjust(networks.observe(given, np.random.default_rng(12)))
    locked = adjust(networks.observe(scene, np.random.default_rng(12)))
    assert np.degrees(locked.exposures[0, 1]) == pytest.approx(phi, abs=0.1)
    # Control with equal sigmas in all directions: nothing in the geometry has changed, but the errors of
    # the coordinates fall in other directions.
    assert len(locked.iterations) <= len(upright.iterations) + 1
    sigma = np.sqrt(np.diagonal(locked.camera_covariance, axis1=1, axis2=2))
    before = np.sqrt(np.diagonal(upright.camera_covariance, axis1=1, axis2=2))
    assert sigma == pytest.approx(before, rel=0.02)
    position = np.sqrt(np.trace(locked.exposure_covariance[:, 3:, 3:], axis1=1, axis2=2))
    assert position == pytest.approx(
        np.sqrt(np.trace(upright.exposure_covariance[:, 3:, 3:], axis1=1, axis2=2)), rel=0.02
    )


@pytest.mark.parametrize("turn_deg", [5.0, 20.0, 60.0, 90.0])
def test_a_block_turned_against_its_antenna_positions_turns_as_a_whole(turn_deg: float) -> None:
    """No ray resists a turn, however far it goes; steps along its tangent would stretch the block."""
    scene = networks.convergent((networks.lens(estimate=()),))
    turn = Rotation.from_rotvec(np.radians(turn_deg) * np.array([0.6, -0.64, 0.48])).as_matrix()
    there = scene.turned(turn, np.array([2.0, -1.0, 0.5]))
    found = []
    for start in (scene, there):
        given = networks.observe(start, None, sigma=1e-4, point_sigma=np.inf, disturb=1e-4)
        held = np.zeros(17)
        given = networks.navigated(given, there, np.random.default_rng(5), held, held, attitudes=False)
        found.append(adjust(given))
    assert len(found[0].iterations) <= 12
    assert found[0].chi_squared == pytest.approx(found[1].chi_squared, rel=1e-6)
    assert found[0].state.points == pytest.approx(found[1].state.points, abs=1e-6)


def test_positions_far_poorer_than_the_block_is_large_say_where_it_lies_and_no_more() -> None:
    """The shape is that of a free network, though the whole is uncertain by three of its sizes."""
    given = networks.observe(networks.convergent(), np.random.default_rng(7), point_sigma=np.inf)
    sigma = np.full((6, 6), np.inf)
    sigma[:, 3:] = 30.0
    weak = adjust(replace(given, exposures=replace(given.exposures, sigma=sigma)))
    free = adjust(replace(given, datum_points=np.arange(20)))
    assert weak.chi_squared == pytest.approx(free.chi_squared, rel=1e-5)
    assert weak.cameras == pytest.approx(free.cameras, rel=1e-5, abs=1e-9)
    assert np.sqrt(np.trace(weak.point_covariance, axis1=1, axis2=2)).min() > 10.0


def test_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces of work do not depend on how many threads share them: every digit is the same."""
    monkeypatch.setattr(normal, "RAYS_IN_PIECE", 10)
    found = []
    for threads in (1, 3):
        monkeypatch.setattr(compiled, "THREADS", threads)
        found.append(adjust(network()))
    one, other = found
    assert len(prepare(network()).design.pieces) > 5
    for name in ("chi_squared", "cameras", "camera_covariance", "exposures", "points", "redundancy"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    monkeypatch.undo()
    whole = adjust(network())
    assert one.chi_squared == pytest.approx(whole.chi_squared, rel=1e-10)
    assert one.redundancy == pytest.approx(whole.redundancy, rel=1e-8, abs=1e-10)

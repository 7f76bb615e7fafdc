"""Relative orientation: the true pose is among those found, in space and on a plane."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.geometry.resection import RelativeOrientation, relative_orientations
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal import networks


def pair(scene: networks.Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rays of the first two images, and their true relative rotation and base."""
    rotation = matrix_from_angles(scene.exposures[:2, :3])
    centre = scene.exposures[:2, 3:]
    q = np.einsum("kij,knj->kni", rotation, scene.points - centre[:, None])
    rays = -q[..., :2] / q[..., 2:]
    base = rotation[0] @ (centre[1] - centre[0])
    return rays[0], rays[1], rotation[1] @ rotation[0].T, base / np.linalg.norm(base)


def error(found: list[RelativeOrientation], rotation: np.ndarray, base: np.ndarray) -> float:
    """How far the best of the poses is from the true one."""
    return min(float(max(np.abs(f.rotation - rotation).max(), np.abs(f.base - base).max())) for f in found)


@pytest.mark.parametrize("count", [8, 12, 60])
def test_exact_rays(count: int) -> None:
    scene = networks.convergent(points=count)
    first, second, rotation, base = pair(scene)
    found = relative_orientations(first, second)
    assert error(found, rotation, base) < 1e-6
    best = min(found, key=lambda f: float(np.abs(f.rotation - rotation).max()))
    along = scene.points[:, None] - scene.exposures[:2, 3:]
    along /= np.linalg.norm(along, axis=2)[..., None]
    angle = np.median(np.arccos(np.sum(along[:, 0] * along[:, 1], axis=1)))
    assert best.angle == pytest.approx(angle, abs=1e-6)


def test_gross_errors() -> None:
    first, second, rotation, base = pair(networks.convergent(points=80))
    rng = np.random.default_rng(3)
    first = first + rng.normal(0, 1e-4, first.shape)
    second[:16] += rng.uniform(-0.3, 0.3, (16, 2))
    assert error(relative_orientations(first, second), rotation, base) < 0.02


def test_plane() -> None:
    """Points of a plane: two poses explain them, the true one among them."""
    scene = networks.convergent(points=40)
    scene.points[:, 2] = 0.2 * scene.points[:, 1]
    first, second, rotation, base = pair(scene)
    assert error(relative_orientations(first, second), rotation, base) < 1e-4


def test_too_few_points() -> None:
    assert relative_orientations(np.zeros((4, 2)), np.zeros((4, 2))) == []

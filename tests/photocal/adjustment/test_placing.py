"""Rows of antenna positions and attitudes against SciPy's rotations and numerical derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.adjustment.mounting import (
    BORESIGHT,
    STRIPS,
    Attitudes,
    Mounting,
    Positions,
    antennas,
    attitude_equations,
    body_to_camera,
    position_equations,
)
from photocal.base.arrays import Floats
from photocal.geometry.rotation import NADIR, left_jacobian

IMAGES = 12
MOUNTING = Mounting(NADIR, np.zeros(STRIPS + 12), np.full(STRIPS + 12, np.inf))
# Every unknown has a column: images first, then what is common.
IMAGE_COLUMNS = np.arange(6 * IMAGES).reshape(IMAGES, 6)
COMMON_COLUMNS = 6 * IMAGES + np.arange(STRIPS + 12)


class Flown:
    """Poses and common values, and what a small step of the unknowns makes of them."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(5)
        self.rotation = Rotation.random(IMAGES, random_state=6).as_matrix()
        self.centre = self.rng.normal(0.0, 50.0, (IMAGES, 3))
        self.common = self.rng.normal(0.0, 0.2, STRIPS + 12)
        self.basis = np.tile(np.eye(3), (IMAGES, 1, 1))
        spread = self.rng.normal(0.0, 0.02, (IMAGES, 3, 3))
        self.covariance = spread @ np.swapaxes(spread, 1, 2) + 1e-5 * np.eye(3)

    def moved(self, step: Floats) -> tuple[Floats, Floats, Floats]:
        """Rotations, centres and common values after a step: turns about the camera axes."""
        poses = step[: 6 * IMAGES].reshape(IMAGES, 6)
        rotation = Rotation.from_rotvec(poses[:, :3]).as_matrix() @ self.rotation
        return rotation, self.centre + poses[:, 3:], self.common + step[6 * IMAGES :]


def derivatives(residual_of: object, size: int) -> Floats:
    """Central differences of residuals, (rows, size)."""
    h = 1e-6
    assert callable(residual_of)
    return np.column_stack([(residual_of(h * e) - residual_of(-h * e)) / (2 * h) for e in np.eye(size)])


def dense(equations: object, size: int) -> Floats:
    """Coefficients as a full matrix."""
    start, column, coefficient = (getattr(equations, name) for name in ("start", "column", "coefficient"))
    matrix = np.zeros((len(start) - 1, size))
    for row in range(len(matrix)):
        own = slice(start[row], start[row + 1])
        matrix[row, column[own]] = coefficient[own]
    return matrix


SIZE = 6 * IMAGES + STRIPS + 12


def body(common: Floats) -> tuple[Floats, Floats]:
    """Rotation from body to camera axes, and its turn by a unit of the boresight."""
    return body_to_camera(MOUNTING, common), left_jacobian(common[BORESIGHT])


def test_rows_of_positions() -> None:
    flown = Flown()
    positions = Positions(
        np.arange(IMAGES),
        flown.centre + flown.rng.normal(0.0, 1.0, (IMAGES, 3)),
        flown.covariance,
        flown.rng.normal(0.0, 8.0, (IMAGES, 3)),
        np.repeat([0, 1], IMAGES // 2),
        flown.rng.normal(0.0, 10.0, IMAGES),
        flown.rng.normal(60.0, 5.0, IMAGES),
    )

    def residual(step: Floats) -> Floats:
        """L^-1 (computed - observed), with L L' the covariance."""
        rotation, centre, common = flown.moved(step)
        computed = antennas(positions, body(common)[0], common, rotation, centre)
        return np.concatenate(
            [
                np.linalg.solve(np.linalg.cholesky(c), d)
                for c, d in zip(positions.covariance, computed - positions.values, strict=True)
            ]
        )

    given = position_equations(
        positions,
        body(flown.common),
        flown.common,
        flown.rotation,
        flown.centre,
        IMAGE_COLUMNS,
        flown.basis,
        COMMON_COLUMNS,
    )
    expected = derivatives(residual, SIZE)
    np.testing.assert_allclose(given.residual, residual(np.zeros(SIZE)), rtol=1e-12)
    np.testing.assert_allclose(dense(given, SIZE), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 0.02, 1.0, 2.5, 3.1])
def test_rows_of_attitudes(angle: float) -> None:
    flown = Flown()
    axis = flown.rng.normal(0.0, 1.0, (IMAGES, 3))
    # Along the axes, too: each element of a quaternion is the largest once.
    axis[:3] = np.eye(3)
    axis[3:6] = -np.eye(3)
    turn = angle * axis / np.linalg.norm(axis, axis=1)[:, None]
    matrix = body(flown.common)[0]
    seen = matrix.T @ Rotation.from_rotvec(-turn).as_matrix() @ flown.rotation
    attitudes = Attitudes(np.arange(IMAGES), seen, flown.covariance)

    def residual(step: Floats) -> Floats:
        """SciPy's rotation vectors, in body axes, whitened."""
        rotation, _, common = flown.moved(step)
        to_camera = body(common)[0]
        turned = Rotation.from_matrix(rotation @ np.swapaxes(to_camera @ seen, 1, 2)).as_rotvec()
        return np.concatenate(
            [
                np.linalg.solve(np.linalg.cholesky(c), r)
                for c, r in zip(flown.covariance, turned @ to_camera, strict=True)
            ]
        )

    given = attitude_equations(
        attitudes,
        body(flown.common),
        flown.rotation,
        IMAGE_COLUMNS,
        flown.basis,
        COMMON_COLUMNS,
    )
    expected = derivatives(residual, SIZE)
    at = residual(np.zeros(SIZE))
    np.testing.assert_allclose(given.residual, at, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(dense(given, SIZE), expected, atol=2e-6 * np.abs(expected).max())

"""Start values of object points: where the rays of a point come closest to each other."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats, Integers


def intersect(
    point: Integers, count: int, centre: Floats, rotation: Floats, ideal: Floats, principal_distance: Floats
) -> Floats:
    """Intersect rays linearly: least squares of the distances from the rays.

    point (n,): point of each ray.
    centre (n, 3): projection centre of each ray.
    rotation (n, 3, 3): object to camera axes of each ray.
    ideal (n, 2): undistorted image coordinates from the principal point.
    principal_distance (n,).

    returns (count, 3): NaN for points whose rays are parallel or fewer than two.
    """
    direction = np.column_stack([ideal, -principal_distance])
    direction = np.einsum("nji,nj->ni", rotation, direction)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    right = np.einsum("nij,nj->ni", across, centre)
    matrix = np.empty((count, 3, 3))
    vector = np.empty((count, 3))
    for a in range(3):
        vector[:, a] = np.bincount(point, right[:, a], count)
        for b in range(3):
            matrix[:, a, b] = np.bincount(point, across[:, a, b], count)
    determinant = np.linalg.det(matrix)
    rays = np.bincount(point, minlength=count)
    # The determinant of the mean of I - d d' falls with the square of the angle between the rays.
    good = determinant > 1e-9 * np.maximum(rays, 1) ** 3
    result = np.full((count, 3), np.nan)
    result[good] = np.linalg.solve(matrix[good], vector[good][..., None])[..., 0]
    return result

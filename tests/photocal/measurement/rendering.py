"""Pictures of targets with known truth: supersampled, blurred, noisy, in perspective."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
DARK, LIGHT = 60.0, 200.0


def perspective(rng: np.random.Generator, size: int, flattening: float = 0.6) -> Floats:
    """From target coordinates (px at unit scale) to pixels of a picture whose middle shows the origin."""

    def turn(angle: float) -> Floats:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    matrix = np.eye(3)
    stretch = np.diag([1, rng.uniform(flattening, 1)])
    matrix[:2, :2] = turn(rng.uniform(0, 2 * np.pi)) @ stretch @ turn(rng.uniform(0, 2 * np.pi))
    matrix[2, :2] = rng.normal(0, 0.001, 2)
    matrix[:2, 2] = size / 2 + rng.uniform(-0.5, 0.5, 2)
    return matrix


def bend(matrix: Floats) -> Floats:
    """Of the picture's plane at the image of the origin, from its line at infinity."""
    line = np.linalg.solve(matrix.T, [0.0, 0.0, 1.0])
    slope = line[:2] / (line @ matrix[:, 2]) * matrix[2, 2]
    # d / (1 + slope d) = d - d (slope d) + ...
    one = np.einsum("ij,k->ijk", np.eye(2), slope)
    return np.asarray(-(one + np.swapaxes(one, 1, 2)) / 2)


def render(
    scene: Callable[[Floats, Floats], Floats],
    matrix: Floats,
    size: int,
    rng: np.random.Generator,
    *,
    blur: float = 0.8,
    noise: float = 0.02,
    over: int = 6,
) -> NDArray[np.uint8]:
    """Render a scene (grey value at target coordinates) with blur in px and noise in parts of 255."""
    places = (np.arange(size * over) + 0.5) / over - 0.5
    x, y = np.meshgrid(places, places)
    back = np.linalg.inv(matrix)
    u, v, w = np.einsum("ij,jkl->ikl", back, np.stack([x, y, np.ones_like(x)]))
    fine = cv2.GaussianBlur(scene(u / w, v / w).astype(np.float32), (0, 0), blur * over)
    coarse = fine.reshape(size, over, size, over).mean(axis=(1, 3))
    return np.asarray(np.clip(np.round(coarse + rng.normal(0, 255 * noise, coarse.shape)), 0, 255), np.uint8)


def warped(
    texture: NDArray[np.uint8], matrix: Floats, size: tuple[int, int], over: int = 4
) -> NDArray[np.uint8]:
    """Show a texture through a homography from texture to picture pixels (centres at whole numbers)."""
    half = (over - 1) / 2
    zoom = np.array([[over, 0, half], [0, over, half], [0, 0, 1.0]])
    fine = cv2.warpPerspective(
        texture, zoom @ matrix, (size[0] * over, size[1] * over), flags=cv2.INTER_AREA, borderValue=(255,)
    )
    fine = cv2.GaussianBlur(fine, (0, 0), 0.7 * over)
    coarse = fine.reshape(size[1], over, size[0], over).astype(float).mean(axis=(1, 3))
    return np.asarray(np.round(coarse), np.uint8)

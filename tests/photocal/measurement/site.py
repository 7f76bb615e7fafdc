"""A small survey rendered with known truth: textured level ground, coded plates, views from above."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from photocal.geometry.camera import Camera, camera
from photocal.geometry.oriented_images import OrientedImages

Floats = NDArray[np.float64]

# Pixels of the ground's picture, m; the picture's middle is the origin.
GROUND_PX_M = 0.02
SIDE = 2200


def texture(seed: int, side: int) -> NDArray[np.float32]:
    """Blobs of several sizes."""
    rng = np.random.default_rng(seed)
    total = np.zeros((side, side), np.float32)
    for sigma in (2, 4, 8, 16):
        layer = cv2.GaussianBlur(rng.normal(0, 1, (side, side)).astype(np.float32), (0, 0), sigma)
        total += layer / layer.std()
    return np.asarray(125 + 18 * total, np.float32)


def with_plate(ground: NDArray[np.float32], picture: NDArray[np.uint8], place: tuple[float, float]) -> None:
    """Lay a plate on the ground: its middle at X, Y, one pixel for one of the ground."""
    height, width = picture.shape
    column = round(place[0] / GROUND_PX_M + (SIDE - 1) / 2 - (width - 1) / 2)
    row = round((SIDE - 1) / 2 - place[1] / GROUND_PX_M - (height - 1) / 2)
    ground[row : row + height, column : column + width] = picture


def plate_place(picture: NDArray[np.uint8], place: tuple[float, float]) -> tuple[float, float]:
    """Where the middle of a plate came to lie, m."""
    height, width = picture.shape
    column = round(place[0] / GROUND_PX_M + (SIDE - 1) / 2 - (width - 1) / 2) + (width - 1) / 2
    row = round((SIDE - 1) / 2 - place[1] / GROUND_PX_M - (height - 1) / 2) + (height - 1) / 2
    return (column - (SIDE - 1) / 2) * GROUND_PX_M, ((SIDE - 1) / 2 - row) * GROUND_PX_M


@dataclass(frozen=True)
class Site:
    """Views of the ground and their names."""

    camera: Camera
    poses: Floats
    names: tuple[str, ...]

    @property
    def views(self) -> OrientedImages:
        """Give the true views."""
        count = len(self.poses)
        return OrientedImages(self.names, (self.camera,), np.zeros(count, np.int64), self.poses)

    def render(self, ground: NDArray[np.float32], folder: Path, seed: int = 0) -> None:
        """Write the pictures, blurred a little and with noise."""
        rng = np.random.default_rng(seed)
        width, height = self.camera.size_px
        y, x = np.mgrid[0:height, 0:width].astype(float)
        pixels = np.column_stack([x.ravel(), y.ravel()])
        views = self.views
        for k, name in enumerate(self.names):
            ideal, c = views.ideal(np.full(len(pixels), k), pixels)
            ray = np.column_stack([ideal, -c]) @ views.rotation[k]
            there = views.station[k] - ray * (views.station[k, 2] / ray[:, 2])[:, None]
            column = (there[:, 0] / GROUND_PX_M + (SIDE - 1) / 2).reshape(height, width)
            row = ((SIDE - 1) / 2 - there[:, 1] / GROUND_PX_M).reshape(height, width)
            # Pixels of the picture cover several of the ground: smoothed as a lens would.
            smooth = cv2.GaussianBlur(ground, (0, 0), 0.5 * self.poses[k, 5] / c[0] / GROUND_PX_M)
            picture = cv2.remap(smooth, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR)
            noisy = picture + rng.normal(0, 2, picture.shape)
            Image.fromarray(np.clip(noisy, 0, 255).astype(np.uint8)).save(folder / name)


def flight(seed: int = 0) -> Site:
    """Two strips of four views, 20 m above the ground, the second flown back; tilts of some degrees."""
    rng = np.random.default_rng(seed)
    own = camera("cam", "brown-ideal", "px", (480, 360), (1.0, 1.0), {"c": 450.0, "K1": -8e-8})
    poses = np.zeros((8, 6))
    for k in range(8):
        strip, step = divmod(k, 4)
        x = -6 + 4.0 * (step if strip == 0 else 3 - step)
        poses[k, 3:] = [x, -3 + 6 * strip, 20 + rng.uniform(-0.5, 0.5)]
        poses[k, :3] = np.radians([*rng.uniform(-3, 3, 2), 180 * strip + rng.uniform(-5, 5)])
    return Site(own, poses, tuple(f"p{k + 1}.png" for k in range(8)))

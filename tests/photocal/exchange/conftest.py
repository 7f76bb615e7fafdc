"""A small reconstruction with everything in it, made by projecting points."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.camera import Camera, camera, plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles


def vision_camera(**extra: float) -> Camera:
    values = {"c": 3650.25, "x0": -12.5, "y0": 7.75, "K1": -3e-9, "K2": 2e-16, "K3": -1e-24}
    values |= {"P1": 1.5e-8, "P2": -2.5e-8}
    return camera("x5", "brown-ideal", "px", (4608, 3456), (1.0, 1.0), values | extra, affinity="after")


def observed_camera() -> Camera:
    values = {"c": 20.5, "x0": -0.22, "y0": 0.18, "K1": -2.75e-4, "K2": 2.7e-7, "K3": 9e-10}
    values |= {"P1": 1e-5, "P2": 5e-6}
    return camera("dcs460", "brown-observed", "mm", (3060, 2036), (0.009, 0.009), values)


def reconstruction_of(cameras: tuple[Camera, ...], count: int = 6, points: int = 40) -> Reconstruction:
    random = np.random.default_rng(8)
    poses = np.column_stack(
        [
            random.normal(0, 0.2, (count, 2)),
            random.uniform(-3, 3, count),
            random.uniform(-30, 30, (count, 2)),
            random.uniform(90, 110, count),
        ]
    )
    xyz = random.uniform([-40, -40, 0], [40, 40, 15], (points, 3))
    which = np.arange(count) % len(cameras)
    image, point, pixels = [], [], []
    for k in range(count):
        own = cameras[which[k]]
        q = (xyz - poses[k, 3:]) @ matrix_from_angles(poses[k, :3]).T
        found = plane_to_pixel(own.size_px, own.pitch, projected(own, q))
        inside = np.isfinite(found).all(axis=1) & (found > 0).all(axis=1) & (found < own.size_px).all(axis=1)
        image += [k] * int(inside.sum())
        point += np.flatnonzero(inside).tolist()
        pixels.append(found[inside])
    exact = np.vstack(pixels)
    residuals = random.normal(0, 0.4, exact.shape)
    return Reconstruction(
        cameras,
        tuple(f"img_{k}.jpg" for k in range(count)),
        which,
        poses,
        tuple(str(100 + k) for k in range(len(xyz))),
        xyz,
        np.array(image),
        np.array(point),
        exact - residuals,
        tuple(("control", "check", "tie")[min(k, 2)] for k in range(len(xyz))),
        np.full((count, 6), 1e-3),
        np.full(xyz.shape, 2e-3),
        residuals,
    )


@pytest.fixture(scope="session")
def vision() -> Reconstruction:
    """Two cameras of the vision model: without and with an affinity."""
    return reconstruction_of((vision_camera(), vision_camera(B1=2e-4)))


@pytest.fixture(scope="session")
def photogrammetric() -> Reconstruction:
    """One camera of the photogrammetric model, in mm."""
    return reconstruction_of((observed_camera(),))

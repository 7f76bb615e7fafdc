"""Cameras as the kernels of the orthophoto take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.lens import optics


@dataclass(frozen=True)
class LensTables:
    """Cameras as the kernels take them.

    values (cameras, 20).
    optics (cameras, 14).
    pitch, size (cameras, 2).
    limit (cameras,): largest distance of an ideal image point from the principal point that the camera can
        record.
    """

    values: Floats
    optics: Floats
    pitch: Floats
    size: Floats
    limit: Floats


def lens_tables(cameras: tuple[Camera, ...]) -> LensTables:
    """Gather what the kernels need of the cameras."""
    return LensTables(
        np.array([camera.values for camera in cameras]),
        np.array([optics(camera) for camera in cameras]),
        np.array([camera.pitch for camera in cameras], dtype=float),
        np.array([camera.size_px for camera in cameras], dtype=float),
        np.array([ideal_limit(camera) for camera in cameras]),
    )


def image_border(camera: Camera, per_side: int = 64) -> Floats:
    """Pixel coordinates along the outer edge of an image, shape (4 per_side, 2)."""
    width, height = camera.size_px
    t = np.arange(per_side) / per_side
    one = np.ones(per_side)
    unit = np.vstack(
        [
            np.column_stack([t, 0 * one]),
            np.column_stack([one, t]),
            np.column_stack([1 - t, one]),
            np.column_stack([0 * one, 1 - t]),
        ]
    )
    return np.asarray(unit * [width, height] - 0.5)


def ideal_limit(camera: Camera) -> float:
    """Largest ideal radius that lies in the image, in the camera's unit.

    A polynomial from ideal to distorted coordinates turns back at some radius; what lies beyond would be
    folded into the image and show the same ground twice.
    """
    border = pixel_to_plane(camera.size_px, camera.pitch, image_border(camera))
    ideal = np.linalg.norm(undistorted(camera, border), axis=1)
    # The limit only spares work beyond the image, it must never cut into it.
    seen = ideal[np.isfinite(ideal)].max(initial=0.0)
    whole = bool(np.isfinite(ideal).all())
    limit = 1.05 * seen if whole else np.inf
    if camera.model == "brown-ideal":
        limit = min(limit, _turning_radius(camera))
    return float(limit)


def _turning_radius(camera: Camera) -> float:
    """First radius at which r + r rad(r) stops growing; infinite when it never does."""
    k = camera.values[3:7]
    r0 = camera.reference_radius**2
    constant = 1 - sum(kn * r0**n for n, kn in enumerate(k, start=1))
    polynomial = [*((2 * n + 1) * k[n - 1] for n in (4, 3, 2, 1)), constant]
    roots = np.roots(np.trim_zeros(polynomial, "f"))
    real = roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real
    return float(np.sqrt(real.min(initial=np.inf)))

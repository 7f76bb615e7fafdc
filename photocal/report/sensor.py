"""Image residuals in the image plane of their camera, whatever unit and axes they were observed in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Flags, Floats, Integers
from photocal.geometry.camera import Camera
from photocal.report.stored_analysis import Run


@dataclass(frozen=True)
class SensorResiduals:
    """Rays of one camera in its image plane: x right, y up from the image centre.

    place (n, 2): measured coordinates, in the unit of the camera.
    residual_px (n, 2): residuals (computed minus measured) in pixels.
    """

    place: Floats
    residual_px: Floats


@dataclass(frozen=True)
class Vectors:
    """Arrows to draw: where, which way (px), and how many rays each stands for."""

    place: Floats
    residual_px: Floats
    rays: Integers


def sensor_residuals(run: Run, camera_id: str) -> SensorResiduals:
    """Take the residuals of one camera to its image plane."""
    camera = run.result.cameras[camera_id]
    rays = run.result.residuals_of(camera_id)
    return to_plane(
        camera,
        rays.measured,
        rays.residual,
        unit=run.result.block.observation_unit,
        axes=run.result.block.observation_axes,
    )


def to_plane(camera: Camera, measured: Floats, residual: Floats, *, unit: str, axes: str) -> SensorResiduals:
    """Turn observed coordinates and residuals into the image plane of a camera.

    measured, residual (n, 2): in `unit` and `axes`.
    unit: unit of the observations.
    """
    # Pitch in the unit of the observations per pixel, and in the unit of the camera per pixel.
    observed = np.array((1.0, 1.0) if unit == "px" else camera.pitch)
    pixels, vectors = measured / observed, residual / observed
    if axes == "pixel":
        pixels = (pixels - (np.array(camera.size_px) - 1) / 2) * [1.0, -1.0]
        vectors = vectors * [1.0, -1.0]
    return SensorResiduals(pixels * np.array(camera.pitch), vectors)


def thinned(residuals: SensorResiduals, camera: Camera, at_most: int) -> Vectors:
    """Keep every residual, or their means over square cells when there are too many to see."""
    n = len(residuals.place)
    if n <= at_most:
        return Vectors(residuals.place, residuals.residual_px, np.ones(n, dtype=np.int64))
    extent = np.array(camera.size_px) * np.array(camera.pitch)
    cell = float(np.sqrt(extent[0] * extent[1] / (at_most / 4)))
    columns, rows = (int(k) for k in np.ceil(extent / cell))
    ij = np.clip(np.floor((residuals.place + extent / 2) / cell).astype(np.int64), 0, [columns - 1, rows - 1])
    flat = ij[:, 1] * columns + ij[:, 0]
    rays = np.bincount(flat, minlength=columns * rows)
    full = rays > 0
    mean = [_cell_mean(flat, values, rays, full) for values in (*residuals.place.T, *residuals.residual_px.T)]
    return Vectors(np.column_stack(mean[:2]), np.column_stack(mean[2:]), rays[full].astype(np.int64))


def _cell_mean(cell: Integers, values: Floats, rays: Integers, full: Flags) -> Floats:
    total = np.bincount(cell, weights=values, minlength=len(rays))
    return np.asarray(total[full] / rays[full], dtype=np.float64)

"""A calibration as it enters a comparison, and how it sees a grid of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError, IllPosedError
from photocal.analysis.estimates import Estimates
from photocal.geometry.camera import PARAMETERS, Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted


@dataclass(frozen=True)
class Calibration:
    """One calibration of a camera.

    camera: its model and parameter values.
    uncertainty: the estimated parameters with their covariance, in the unit of the camera; None when unknown.
    """

    camera: Camera
    uncertainty: Estimates | None = None

    @property
    def id(self) -> str:
        """Name of the calibration."""
        return self.camera.id


@dataclass(frozen=True)
class View:
    """Where a calibration places pixels: the ideal image of its rays.

    ideal (n, 2): image coordinates free of distortion, from the principal point, x right, y up, px.
    c: principal distance, px.
    """

    ideal: Floats
    c: float


def sensor_grid(size_px: tuple[int, int], step_px: float | None = None) -> Floats:
    """Spread a regular grid of pixels over the format.

    step_px: distance of the grid points; 100 px unless the image is so small that fewer than 20 columns of
        points would fit. The first point stands half a step from the upper left.
    returns (n, 2): column and row of each point, px.

    Notes
    -----
    With 100 px on 4608 x 3456 this is the grid of the Canon ELPH study: 46 x 35 points from (50, 50).
    """
    width, height = size_px
    step = min(100.0, width / 20.0) if step_px is None else step_px
    columns, rows = np.arange(step / 2, width, step), np.arange(step / 2, height, step)
    return np.column_stack([m.ravel() for m in np.meshgrid(columns, rows)])


def view(camera: Camera, pixels: Floats) -> View:
    """Correct pixels by a calibration.

    pixels (n, 2): column and row, px.
    returns: ideal image coordinates and principal distance in units of the camera's own pixel width.
    raises IllPosedError: when the distortion folds, so that pixels have no ray.
    """
    plane = pixel_to_plane(camera.size_px, camera.pitch, pixels)
    ideal = undistorted(camera, plane) / camera.pitch[0]
    if not np.all(np.isfinite(ideal)):
        column, row = pixels[np.flatnonzero(~np.all(np.isfinite(ideal), axis=1))[0]]
        raise IllPosedError(
            f"the distortion folds within the image, pixel ({column:g}, {row:g}) has no ray",
            where=f"camera {camera.id}",
            remedy="check sign and unit of the coefficients, and the direction of the model",
        )
    return View(ideal, camera.value("c") / camera.pitch[0])


def sensitivity(calibration: Calibration, pixels: Floats) -> tuple[Floats, Floats]:
    """Change of a view with each estimated parameter, times the square root of their covariance."""
    known = calibration.uncertainty
    if known is None:
        raise ConfigurationError(
            "has no sigmas", where=f"camera {calibration.id}", remedy="add a [camera.sigma] table"
        )
    # The factor of the correlation matrix, by its eigenvalues: rounded correlations may leave it a
    # little indefinite, which a Cholesky factor would not survive.
    eigenvalues, vectors = np.linalg.eigh(known.correlation)
    factor = known.sigmas[:, None] * vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    ideal, c = [], []
    for name, sigma in zip(known.names, known.sigmas, strict=True):
        at = PARAMETERS.index(name)
        above, below = (view(_shifted(calibration.camera, at, sign * sigma), pixels) for sign in (1.0, -1.0))
        ideal.append((above.ideal - below.ideal) / (2.0 * sigma))
        c.append((above.c - below.c) / (2.0 * sigma))
    return np.tensordot(factor.T, np.array(ideal), axes=1), factor.T @ np.array(c)


def _shifted(camera: Camera, at: int, by: float) -> Camera:
    values = camera.values.copy()
    values[at] += by
    return camera.with_values(values)

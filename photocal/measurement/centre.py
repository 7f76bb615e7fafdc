"""The measured centre of a target: a place to a fraction of a pixel with its own covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.measurement.image_file import Grey, as_eight_bit
from photocal.measurement.template import Fit, Window, odd_variance

# A contrast below this multiple of the noise is no target.
WEAKEST_CONTRAST = 3.0
# Targets are drawn on paper; a centre that claims more than this trusts the model too much.
FINEST_PX = 0.003

# Far enough for digits, near enough for the third order not to matter.
_STEP_PX = 8.0
_AROUND = _STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]])


@dataclass(frozen=True)
class Centre:
    """A measured centre.

    column, row: px; the centre of the upper-left pixel is (0, 0).
    covariance (2, 2): px squared.
    contrast, noise: grey values.
    shape (k,): further parameters of the target, as in `patterns`; the blur stands last.
    """

    column: float
    row: float
    covariance: Floats
    contrast: float
    noise: float
    shape: Floats

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations of column and row, px."""
        return float(np.sqrt(self.covariance[0, 0])), float(np.sqrt(self.covariance[1, 1]))


def measurable(grey: Grey) -> Grey:
    """Grey values in whole steps, as the templates take them for granted."""
    return as_eight_bit(grey) if grey.dtype == np.float32 else grey


def half_contrast(window: Window) -> float:
    """Half of the range of the grey values in a window, outliers apart; 1 at least."""
    low, high = np.quantile(window.grey, [0.05, 0.95])
    return max(float(high - low) / 2, 1.0)


def accepted(
    window: Window,
    fit: Fit,
    contrast: float,
    approximate: tuple[float, float],
    farthest: float,
    shape: Floats,
) -> Centre | None:
    """Make a centre of a fitted template, unless it is too faint, unsure or far from where it was expected.

    approximate: column and row where it was expected, px.
    farthest: how far from there it may be, px.
    shape (k,): as in `Centre`.
    """
    place = fit.parameters[:2]
    column, row = (float(p + m) for p, m in zip(place, window.middle, strict=True))
    moved = np.hypot(column - approximate[0], row - approximate[1])
    if not moved <= farthest or contrast < WEAKEST_CONTRAST * fit.noise:
        return None
    covariance = odd_variance(window, fit, place) * fit.cofactor[:2, :2] + FINEST_PX**2 * np.eye(2)
    if not max(covariance[0, 0], covariance[1, 1]) <= 1:
        return None
    return Centre(column, row, covariance, contrast, fit.noise, shape.copy())


def ground_bend(camera: Camera, rotation: Floats, pixel: Floats) -> Floats:
    """Bend of level ground about a place: what takes a target's middle out of that of its picture.

    The centre of the ellipse that shows a circle is not where the circle's centre is seen: perspective and
    distortion move it by a part of the target's size squared. To the second order an offset d in the image
    belongs to the offset A^-1 (d + b(d, d)) on the ground, with A the affine part and b the bend. A picture
    that is drawn with this bend has its centre where the target has its own (for perspective alone this is
    the correction of Ahn, Warnecke and Kotowski 1999, up to the third order).
    """
    ideal = undistorted(camera, pixel_to_plane(camera.size_px, camera.pitch, pixel + _AROUND))
    ray = np.column_stack([ideal, np.full(len(ideal), -camera.value("c"))]) @ rotation
    ground = ray[:, :2] / ray[:, 2:]
    by_pixel = np.column_stack([ground[1] - ground[2], ground[3] - ground[4]]) / (2 * _STEP_PX)
    second = np.empty((2, 2, 2))
    second[:, 0, 0], second[:, 1, 1] = (ground[k] - 2 * ground[0] + ground[k + 1] for k in (1, 3))
    second[:, 0, 1] = second[:, 1, 0] = (ground[5] + ground[6] - ground[7] - ground[8]) / 4
    return np.asarray(np.tensordot(np.linalg.inv(by_pixel), second, 1) / (2 * _STEP_PX**2))

"""The measured centre of a target: a place to a fraction of a pixel with its own covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.measurement.image_file import Grey, as_eight_bit
from photocal.measurement.template import Fit, Window, odd_variance

# A contrast below this multiple of the noise is no target.
WEAKEST_CONTRAST = 3.0
# Targets are drawn on paper; a centre that claims more than this trusts the model too much.
FINEST_PX = 0.003


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

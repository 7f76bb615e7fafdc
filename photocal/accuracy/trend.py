"""Systematic parts of discrepancies: the mean, and a similarity over the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from drivers.errors import IllPosedError
from photocal.accuracy.significance_tests import bias_test
from photocal.accuracy.statistics import Moments


@dataclass(frozen=True)
class SimilarityTrend:
    """Scale, rotation and shift that explain planimetric discrepancies best.

    shift_m: east and north part at the centre of the points, m.
    scale: by which the product is too large: 0.01 is 1 %.
    rotation_rad: by which the product is turned counter-clockwise, rad.
    rmse_left_m: planimetric root mean square (over n) of what it does not explain, m.
    """

    shift_m: tuple[float, float]
    scale: float
    rotation_rad: float
    rmse_left_m: float


def rmse_after_trend_removal(component: Moments, confidence: float) -> float:
    """Give the RMSE after the mean has been subtracted where it is significant."""
    biased = bias_test(component, confidence).significant
    return component.rmse_without_mean_m if biased else component.rmse_m


def similarity_trend(positions_m: Floats, discrepancies_m: Floats) -> SimilarityTrend:
    """Fit shift, scale and rotation to planimetric discrepancies by least squares."""
    if len(positions_m) < 3:
        raise IllPosedError("a similarity trend needs at least three check points with coordinates")
    reduced = positions_m - positions_m.mean(axis=0)
    inertia = float(np.sum(reduced**2))
    if inertia == 0.0:
        raise IllPosedError(
            "all check points have the same coordinates", remedy="look at the columns E and N"
        )
    shift = discrepancies_m.mean(axis=0)
    east, north = reduced.T
    scale = float(np.sum(reduced * discrepancies_m)) / inertia
    rotation = float(np.sum(east * discrepancies_m[:, 1] - north * discrepancies_m[:, 0])) / inertia
    explained = shift + np.column_stack((scale * east - rotation * north, rotation * east + scale * north))
    left = discrepancies_m - explained
    rmse_left = math.sqrt(float(np.sum(left**2)) / len(left))
    return SimilarityTrend((float(shift[0]), float(shift[1])), scale, rotation, rmse_left)

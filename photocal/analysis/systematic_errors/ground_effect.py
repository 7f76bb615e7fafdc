"""What an error of c does on the ground, and which effects are small."""

from __future__ import annotations

import numpy as np

from photocal.analysis.systematic_errors.refit import Fit

# Below half a pixel and two standard deviations of c an effect is called small.
SMALL_PX = 0.5
SMALL_SIGMAS = 2.0


def mean_distance(fitted: Fit, camera: int) -> float:
    """Give the mean distance of object points from the exposures of a camera."""
    rays, state = fitted.network.rays, fitted.state
    mine = fitted.network.exposures.camera[rays.image] == camera
    apart = state.points[rays.point[mine]] - state.centre[rays.image[mine]]
    return float(np.mean(np.linalg.norm(apart, axis=1))) if mine.any() else float("nan")


def ground_effect(fitted: Fit, camera: int, change_of_c: float) -> float:
    """Give the height error that a wrong c makes at the mean distance of the block."""
    return float(abs(change_of_c) / fitted.solution.cameras[camera, 0] * mean_distance(fitted, camera))

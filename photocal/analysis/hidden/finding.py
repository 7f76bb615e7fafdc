"""One line of the list of hidden errors, and what makes it small."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photocal.analysis.hidden.refit import Fit

# Below half a pixel and two standard deviations of c an effect is called small.
SMALL_PX = 0.5
SMALL_SIGMAS = 2.0


@dataclass(frozen=True)
class Finding:
    """One line of the list.

    Attributes
    ----------
    kind : str
        Machine-readable kind.
    sentence : str
        The finding in words.
    figure : float
        Its figure.
    sigma : float or None
        Standard deviation of the figure (a priori).
    unit : str
        Unit of the figure.
    effect_c : float or None
        By how much c was wrong because of it, in the unit of the camera.
    effect_ground_m : float or None
        What that c makes of heights at the distance of this block, m.
    effect_px : float or None
        Largest displacement in the image, px.
    small : bool
        Whether it may be left as it is.
    """

    kind: str
    sentence: str
    figure: float
    sigma: float | None
    unit: str
    effect_c: float | None
    effect_ground_m: float | None
    effect_px: float | None
    small: bool


def mean_distance(fitted: Fit, camera: int) -> float:
    """Give the mean distance of object points from the exposures of a camera.

    Parameters
    ----------
    fitted : Fit
        The network at its minimum.
    camera : int
        Which camera.

    Returns
    -------
    float
        Over all its rays, m; NaN without rays.
    """
    rays, state = fitted.network.rays, fitted.state
    mine = fitted.network.exposures.camera[rays.image] == camera
    apart = state.points[rays.point[mine]] - state.centre[rays.image[mine]]
    return float(np.mean(np.linalg.norm(apart, axis=1))) if mine.any() else float("nan")


def ground_effect(fitted: Fit, camera: int, change_of_c: float) -> float:
    """Give the height error that a wrong c makes at the mean distance of the block.

    Parameters
    ----------
    fitted : Fit
        The network at its minimum.
    camera : int
        Which camera.
    change_of_c : float
        Error of c, in the unit of the camera.

    Returns
    -------
    float
        Distance times the relative error of c, m.
    """
    return float(abs(change_of_c) / fitted.solution.cameras[camera, 0] * mean_distance(fitted, camera))


def metres(length: float) -> str:
    """Write a length in m or mm, whichever is readable."""
    return f"{length:.2f} m" if length >= 1.0 else f"{length * 1000:.1f} mm"

"""Correlation of camera parameters with the exterior orientation, such as c with the heights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.state import State
from photocal.analysis.correlation import cause
from photocal.analysis.estimates import Array
from photocal.analysis.systematic_errors.refit import Fit, lowest
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import angles_from_matrix

ELEMENTS = ("omega", "phi", "kappa", "X0", "Y0", "Z0")


@dataclass(frozen=True)
class ExteriorCorrelation:
    """A camera parameter and an element of the exterior orientation that the network separates badly.

    Attributes
    ----------
    parameter, element : str
        The two.
    image : str
        Where the correlation is largest.
    value : float
        The correlation there.
    images : int
        Number of images in which it is over the threshold.
    cause : str
        Code of why, with what would separate them.
    """

    parameter: str
    element: str
    image: str
    value: float
    images: int
    cause: str


def exterior_correlations(
    fit: Fit, camera: int, threshold: float, done: Callable[[], None] = lambda: None
) -> tuple[ExteriorCorrelation, ...]:
    """List camera parameters that are strongly correlated with exterior orientations.

    A parameter is held one standard deviation away from its estimate and everything is adjusted anew: the
    others follow by their covariance with it, so their change over their own standard deviation is the
    correlation.
    """
    found = []
    for at in np.flatnonzero(fit.network.cameras[camera].estimated):
        try:
            r = correlation_with(fit, camera, int(at))
        except (IllPosedError, NotConvergedError):
            continue
        finally:
            done()
        for k, element in enumerate(ELEMENTS):
            strong = np.abs(r[:, k]) >= threshold
            if strong.any():
                i = int(np.argmax(np.abs(r[:, k])))
                name = PARAMETERS[at]
                found.append(
                    ExteriorCorrelation(
                        name,
                        element,
                        fit.network.image_names[i],
                        float(r[i, k]),
                        int(strong.sum()),
                        cause(name, element),
                    )
                )
    return tuple(sorted(found, key=lambda one: -abs(one.value)))


def correlation_with(fit: Fit, camera: int, parameter: int) -> Array:
    """Give the correlation of one camera parameter with every exterior orientation."""
    moved = moved_by_one_sigma(fit, camera, parameter)
    change = np.hstack(
        [
            angles_from_matrix(moved.rotation) - angles_from_matrix(fit.state.rotation),
            moved.centre - fit.state.centre,
        ]
    )
    change[:, :3] = (change[:, :3] + np.pi) % (2.0 * np.pi) - np.pi
    sigma = np.sqrt(np.diagonal(fit.solution.exposure_covariance, axis1=1, axis2=2))
    return np.clip(np.divide(change, sigma, out=np.zeros_like(change), where=sigma > 0.0), -1.0, 1.0)


def moved_by_one_sigma(fit: Fit, camera: int, parameter: int) -> State:
    """Hold one camera parameter a standard deviation away from its estimate and adjust."""
    own = fit.network.cameras[camera]
    sigma = float(np.sqrt(fit.solution.camera_covariance[camera, parameter, parameter]))
    estimated = own.estimated.copy()
    estimated[parameter] = False
    values = own.values.copy()
    values[parameter] = fit.state.cameras[camera, parameter] + sigma
    cameras = list(fit.network.cameras)
    cameras[camera] = replace(own, estimated=estimated, values=values)
    current = fit.state.cameras.copy()
    current[camera, parameter] = values[parameter]
    return lowest(replace(fit.network, cameras=tuple(cameras)), replace(fit.state, cameras=current)).state

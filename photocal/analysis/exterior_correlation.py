"""Correlation of camera parameters with the exterior orientation, such as c with the heights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.factored import covariance_column
from photocal.adjustment.state import turn_basis
from photocal.analysis.correlation import cause
from photocal.analysis.systematic_errors.refit import Fit
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import angles_from_matrix, turn_per_angle

ELEMENTS = ("omega", "phi", "kappa", "X0", "Y0", "Z0")


@dataclass(frozen=True)
class ExteriorCorrelation:
    """A camera parameter and an element of the exterior orientation that the network separates badly.

    parameter, element: the two.
    image: where the correlation is largest.
    value: the correlation there.
    images: number of images in which it is over the threshold.
    cause: code of why, with what would separate them.
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
    """List camera parameters that are strongly correlated with exterior orientations."""
    found = []
    for at in np.flatnonzero(fit.network.cameras[camera].estimated):
        r = correlation_with(fit, camera, int(at))
        for k, element in enumerate(ELEMENTS):
            strong = np.abs(r[:, k]) >= threshold
            if strong.any():
                i = int(np.argmax(np.abs(r[:, k])))
                name, image = PARAMETERS[at], fit.network.image_names[i]
                why = cause(name, element)
                found.append(
                    ExteriorCorrelation(name, element, image, float(r[i, k]), int(strong.sum()), why)
                )
        done()
    return tuple(sorted(found, key=lambda one: -abs(one.value)))


def correlation_with(fit: Fit, camera: int, parameter: int) -> Floats:
    """Give the correlation of one camera parameter with every exterior orientation, from its column."""
    layout = fit.factored.problem.layout
    active, columns = layout.camera_columns[camera]
    right = np.zeros(layout.size)
    right[columns[active == parameter]] = 1.0
    column, _ = covariance_column(fit.factored, right, np.zeros_like(fit.state.points))
    covariance = np.where(fit.network.exposures.sigma == 0, 0.0, column[layout.image_columns])
    angles = turn_per_angle(angles_from_matrix(fit.state.rotation))
    turns = np.einsum("nab,nb->na", turn_basis(fit.network, fit.state), covariance[:, :3])
    covariance[:, :3] = np.linalg.solve(angles, turns[:, :, None])[:, :, 0]
    sigma = np.sqrt(np.diagonal(fit.solution.exposure_covariance, axis1=1, axis2=2))
    own = float(np.sqrt(fit.solution.camera_covariance[camera, parameter, parameter]))
    r = np.divide(covariance, sigma * own, out=np.zeros_like(covariance), where=sigma > 0.0)
    return np.asarray(np.clip(r, -1.0, 1.0))

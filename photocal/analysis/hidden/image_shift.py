"""Images that have a scale or a principal point of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photocal.adjustment.state import State
from photocal.analysis.estimates import Array
from photocal.analysis.hidden.refit import Fit
from photocal.geometry.rotation import turned

# Less of a column than this, beside the exterior orientation, is not determined.
INDEPENDENT = 1e-2


@dataclass(frozen=True)
class ImageShift:
    """Scale and principal point of one image against its camera.

    Attributes
    ----------
    image : str
        The image.
    scale : float
        Relative difference of scale, dimensionless.
    shift_px : (2,) array
        Shift of the principal point to the right and up, px.
    effect_px : float
        Largest displacement of a ray that the exterior orientation does not take up, px.
    p_value : float
        Probability without such a difference, already multiplied by the number of images.
    """

    image: str
    scale: float
    shift_px: Array
    effect_px: float
    p_value: float


def image_shifts(fit: Fit, variance_factor: float) -> tuple[ImageShift, ...]:
    """Test the residuals of each image for a scale and a principal point of its own.

    What the exterior orientation of the image takes up is taken away first. Other unknowns are not, which
    makes the test alarm less often than its level says.

    Parameters
    ----------
    fit : Fit
        The network at its minimum.
    variance_factor : float
        Variance of unit weight of the image coordinates.

    Returns
    -------
    tuple of ImageShift
        One for each image with enough rays.
    """
    from scipy import stats

    network, state = fit.network, fit.state
    rays = network.rays
    poses = pose_derivatives(fit, state)
    zero, one = np.zeros(len(rays.plane)), np.ones(len(rays.plane))
    x, y = rays.plane.T
    shapes = np.stack([np.column_stack(pair) for pair in ((x, y), (one, zero), (zero, one))], axis=-1)
    images = len(network.image_names)
    found = []
    for i, name in enumerate(network.image_names):
        mine = rays.image == i
        weight = 1.0 / rays.sigma[mine].ravel()
        if len(weight) < 12:
            continue
        orientation, _ = np.linalg.qr(poses[mine].reshape(-1, 6) * weight[:, None])
        columns = shapes[mine].reshape(-1, 3) * weight[:, None]
        size = np.linalg.norm(columns, axis=0)
        unit = columns / size
        unit -= orientation @ (orientation.T @ unit)
        # Residuals are computed minus measured: what must be added to the measurements.
        v = fit.solution.residuals[mine].ravel() * weight
        left, values, right = np.linalg.svd(unit, full_matrices=False)
        k = int(np.sum(values > INDEPENDENT))
        if k == 0:
            continue
        along = left[:, :k].T @ v
        statistic = float(along @ along) / k / variance_factor
        amount = right[:k].T @ (along / values[:k]) / size
        pitch = np.array(network.cameras[network.exposures.camera[i]].pitch)
        moved = (left[:, :k] @ along / weight).reshape(-1, 2) / pitch
        p_value = min(1.0, images * float(stats.f.sf(statistic, k, fit.solution.degrees_of_freedom)))
        effect = float(np.linalg.norm(moved, axis=1).max())
        found.append(ImageShift(name, float(amount[0]), amount[1:] / pitch, effect, p_value))
    return tuple(found)


def pose_derivatives(fit: Fit, state: State) -> Array:
    """Change of the ideal image coordinates with the exterior orientation of their image.

    Parameters
    ----------
    fit : Fit
        The network.
    state : State
        Where to take the derivatives.

    Returns
    -------
    (n, 2, 6) array
        Per radian of turn about the camera axes and per metre.
    """
    image = fit.network.rays.image
    c = state.cameras[fit.network.exposures.camera[image], :1]
    points = state.points[fit.network.rays.point]

    def ideal(rotation: Array, centre: Array) -> Array:
        q = np.einsum("nij,nj->ni", rotation[image], points - centre[image])
        return np.asarray(-c * q[:, :2] / q[:, 2:])

    reach = float(np.median(np.linalg.norm(points - state.centre[image], axis=1)))
    columns = []
    for axis in np.eye(3):
        turn = np.broadcast_to(1e-6 * axis, state.centre.shape)
        above, below = (ideal(turned(state.rotation, sign * turn), state.centre) for sign in (1.0, -1.0))
        columns.append((above - below) / 2e-6)
    for axis in np.eye(3):
        move = 1e-6 * reach * axis
        above, below = (ideal(state.rotation, state.centre + sign * move) for sign in (1.0, -1.0))
        columns.append((above - below) / (2e-6 * reach))
    return np.stack(columns, axis=-1)

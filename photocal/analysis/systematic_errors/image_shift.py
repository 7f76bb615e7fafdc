"""Images that have a scale or a principal point of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.score import followed_by, score
from photocal.adjustment.state import State
from photocal.analysis.systematic_errors.refit import Fit
from photocal.geometry.rotation import turned

# Less of a column than this, beside the exterior orientation, is not determined.
INDEPENDENT = 1e-2
# Coordinates of an image that is tested.
FEWEST = 12
# So many images are adjusted with a scale and a principal point of their own.
MOST_JOINT = 12


@dataclass(frozen=True)
class ImageShift:
    """Scale and principal point of one image against its camera.

    image: the image.
    scale: relative difference of scale, dimensionless.
    shift_px (2,): shift of the principal point to the right and up, px.
    effect_px: largest displacement of a ray that the other unknowns do not take up, px.
    p_value: probability without such a difference, already multiplied by the number of images.
    sigma (3,): of scale and shift (px), a priori, when they were estimated jointly with all other unknowns;
        NaN for what these take up. None when only the exterior orientation of the image was taken into
        account.
    """

    image: str
    scale: float
    shift_px: Floats
    effect_px: float
    p_value: float
    sigma: Floats | None = None


def image_shifts(
    fit: Fit, variance_factor: float, done: Callable[[], None] = lambda: None
) -> tuple[ImageShift, ...]:
    """Test each image for a scale and a principal point of its own.

    The most suspicious images, all of them in a small network, get them as unknowns beside all others. The
    rest is tested by its residuals, from which only what the exterior orientation takes up is taken away:
    that test alarms less often than its level says.
    """
    screened = screened_shifts(fit, variance_factor)
    suspicious = sorted(screened, key=lambda one: one.p_value)[:MOST_JOINT]
    if len(screened) > MOST_JOINT:
        suspicious = [one for one in suspicious if one.p_value < 1.0]
    jointly = dict[str, ImageShift]()
    for one in suspicious:
        estimated = joint_shift(fit, one.image)
        if estimated is not None:
            jointly[one.image] = estimated
        done()
    return tuple(jointly.get(one.image, one) for one in screened)


def joint_shift(fit: Fit, image: str) -> ImageShift | None:
    """Estimate scale and principal point of one image as further unknowns, to first order."""
    from scipy import stats

    network = fit.network
    i = network.image_names.index(image)
    mine = network.rays.image == i
    sigma = network.rays.sigma[mine]
    columns = _own_geometry(fit.computed[mine])
    step = 1.0 / np.linalg.norm((columns / sigma[:, :, None]).reshape(-1, 3), axis=0)
    fields = np.zeros((3, *network.rays.plane.shape))
    fields[:, mine] = -np.moveaxis(columns * step, -1, 0)
    joint = score(fit.factored, fit.solution.residuals, fields)
    values, vectors = np.linalg.eigh(joint.information)
    seen = values > INDEPENDENT**2
    k = int(seen.sum())
    if k == 0:
        return None
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    amount = -inverse @ joint.slope
    fall = float(joint.slope @ inverse @ joint.slope)
    freedom = fit.solution.degrees_of_freedom - k
    statistic = fall / k / (max(fit.solution.chi_squared - fall, 1e-300) / freedom)
    pitch = np.array(network.cameras[network.exposures.camera[i]].pitch)
    unit = step / np.array([1.0, *pitch])
    # What other unknowns take up has no variance to speak of here: it is not determined.
    hidden = np.linalg.norm(vectors[:, ~seen], axis=1) > 0.5
    spread = np.where(hidden, np.nan, np.sqrt(np.diag(inverse))) * unit
    follows = followed_by(fit.factored, amount @ joint.steps, np.tensordot(amount, joint.moved, 1))
    moved = (np.tensordot(amount, fields[:, mine], 1) - follows[mine]) / pitch
    return ImageShift(
        image,
        float(amount[0] * unit[0]),
        amount[1:] * unit[1:],
        float(np.linalg.norm(moved, axis=1).max()),
        min(1.0, len(network.image_names) * float(stats.f.sf(statistic, k, freedom))),
        spread,
    )


def _own_geometry(plane: Floats) -> Floats:
    """Displacement of image plane coordinates by a scale and a shift of one image, (n, 2, 3)."""
    zero, one = np.zeros(len(plane)), np.ones(len(plane))
    x, y = plane.T
    return np.stack([np.column_stack(pair) for pair in ((x, y), (one, zero), (zero, one))], axis=-1)


def screened_shifts(fit: Fit, variance_factor: float) -> tuple[ImageShift, ...]:
    """Test the residuals of each image for a scale and a principal point of its own.

    What the exterior orientation of the image takes up is taken away first. Other unknowns are not, which
    makes the test alarm less often than its level says.
    """
    from scipy import stats

    network, state = fit.network, fit.state
    rays = network.rays
    images, shown = len(network.image_names), np.bincount(rays.image, minlength=len(network.image_names))
    columns = np.concatenate([pose_derivatives(fit, state), _own_geometry(fit.computed)], axis=2)
    by_image = np.argsort(rays.image, kind="stable")
    groups = np.split(by_image, np.cumsum(shown)[:-1])
    tested = np.flatnonzero(2 * shown >= FEWEST)
    if not len(tested):
        return ()
    # Residuals are computed minus measured: what must be added to the measurements.
    normal, slope = np.empty((len(tested), 9, 9)), np.empty((len(tested), 9))
    for k, i in enumerate(tested.tolist()):
        weight = 1.0 / rays.sigma[groups[i]].ravel()
        own = columns[groups[i]].reshape(-1, 9) * weight[:, None]
        normal[k], slope[k] = own.T @ own, own.T @ (fit.solution.residuals[groups[i]].ravel() * weight)
    size = np.sqrt(np.diagonal(normal, axis1=1, axis2=2))
    normal, slope = normal / size[:, :, None] / size[:, None, :], slope / size
    follows = np.linalg.solve(normal[:, :6, :6], normal[:, :6, 6:])
    left = normal[:, 6:, 6:] - normal[:, 6:, :6] @ follows
    pull = slope[:, 6:] - np.einsum("iab,ia->ib", follows, slope[:, :6])
    values, vectors = np.linalg.eigh(left)
    seen = values > INDEPENDENT**2
    along = np.einsum("iab,ia->ib", vectors, pull)
    number = seen.sum(axis=1)
    values = np.where(seen, values, np.inf)
    statistic = np.sum(along**2 / values, axis=1) / np.maximum(number, 1) / variance_factor
    amount = np.einsum("iab,ib->ia", vectors, along / values)
    change = np.hstack([-np.einsum("iab,ib->ia", follows, amount), amount]) / size
    p_value = np.minimum(1.0, images * stats.f.sf(statistic, number, fit.solution.degrees_of_freedom))
    found = []
    for k in np.flatnonzero(number).tolist():
        i = int(tested[k])
        pitch = np.array(network.cameras[network.exposures.camera[i]].pitch)
        effect = float(np.linalg.norm(columns[groups[i]] @ change[k] / pitch, axis=1).max())
        scale, shift = float(change[k, 6]), change[k, 7:] / pitch
        found.append(ImageShift(network.image_names[i], scale, shift, effect, float(p_value[k])))
    return tuple(found)


def pose_derivatives(fit: Fit, state: State) -> Floats:
    """Change of the ideal image coordinates with the exterior orientation of their image."""
    image = fit.network.rays.image
    c = state.cameras[fit.network.exposures.camera[image], :1]
    points = state.points[fit.network.rays.point]

    def ideal(rotation: Floats, centre: Floats) -> Floats:
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

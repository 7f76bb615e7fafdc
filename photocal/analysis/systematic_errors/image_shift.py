"""Images that have a scale or a principal point of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.score import score
from photocal.adjustment.state import State
from photocal.analysis.systematic_errors.refit import Fit
from photocal.geometry.rotation import turned

# Less of a column than this, beside the exterior orientation, is not determined.
INDEPENDENT = 1e-2
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
    moved = np.einsum("t,trk->rk", amount, joint.visible[:, mine]) / pitch
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
    poses = pose_derivatives(fit, state)
    shapes = _own_geometry(fit.computed)
    images = len(network.image_names)
    found = []
    by_image = np.argsort(rays.image, kind="stable")
    groups = np.split(by_image, np.searchsorted(rays.image[by_image], np.arange(1, images)))
    for i, (name, mine) in enumerate(zip(network.image_names, groups, strict=True)):
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

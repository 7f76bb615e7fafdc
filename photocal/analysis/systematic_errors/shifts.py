"""What a common shift of all positions would do, and scales and shifts of single images."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.envelope import solve
from photocal.adjustment.groups import tested
from photocal.adjustment.mounting import SHIFT, STRIPS
from photocal.adjustment.network import Network
from photocal.adjustment.score import followed_by, score
from photocal.adjustment.solution import Group
from photocal.base.arrays import Floats, Integers
from photocal.base.policy import policy

# Less of a column than this, beside the exterior orientation, is not determined.
INDEPENDENT = 1e-2
# So many images are adjusted with a scale and a principal point of their own.
MOST_JOINT = 12


@dataclass(frozen=True)
class PositionShift:
    """A common shift of the observed positions, as three more unknowns.

    shift, sigma: (3,), observed less what the rest of the network says, and standard deviations a priori, m;
        infinite where nothing but the positions tells it.
    fall: by how much the sum of squares falls with it.
    p_value: probability of that without a shift, in height or in plane (Bonferroni), judged by the scatter of
        the positions themselves.
    c_by_shift: (cameras, 3), change of each principal distance with it, per m.
    stated: (3,), medians of the stated standard deviations of a position, m.
    """

    shift: Floats
    sigma: Floats
    fall: float
    p_value: float
    c_by_shift: Floats
    stated: Floats


def position_shift(fit: AdjustedNetwork) -> PositionShift | None:
    """Estimate the shift from the normal equations as they stand; None where it is free already."""
    network, positions = fit.network, fit.network.positions
    if not len(positions.image) or np.any(network.mounting.sigma[SHIFT]) or _strips_free(network):
        return None
    fields = _whitened(fit)
    information, slope, steps = _further(fit, fields)
    layout = fit.factored.problem.layout
    c_by_shift = np.array(
        [steps[:, columns[parameters == 0]].sum(axis=1) for parameters, columns in layout.camera_columns]
    )
    group = next(part for part in fit.solution.groups if part.name == "position")
    if group.redundancy - 3.0 < policy.fewest_redundant or not _determined(fields, information):
        return PositionShift(np.zeros(3), np.full(3, np.inf), 0.0, 1.0, c_by_shift, positions.stated())
    shift, sigma, fall, p_value = _estimated(information, slope, group)
    # Standard deviations that are too small by a factor compete with it: they explain all residuals alike.
    factor = tested(group)
    wrong = factor.factor > 1.0 and factor.p_value < policy.significance
    if wrong and factor.gain > fall - 2.0 * np.log(fit.solution.observations):
        p_value = 1.0
    return PositionShift(shift, sigma, fall, p_value, c_by_shift, positions.stated())


def _determined(fields: Floats, information: Floats) -> bool:
    """Whether something of shifts along whitened fields is left beside all other unknowns."""
    # Of a shift, what no other unknown takes up, squared: less is not determined.
    least_left = 1e-4
    return bool(np.linalg.eigvalsh(np.linalg.solve(fields.T @ fields, information))[0] >= least_left)


def _estimated(information: Floats, slope: Floats, group: Group) -> tuple[Floats, Floats, float, float]:
    """Give a shift, its sigmas, the fall of v'Pv, and p judged by the scatter of the positions themselves."""
    rest = group.redundancy - 3.0
    covariance: Floats = np.asarray(np.linalg.inv(information), dtype=np.float64)
    shift = -covariance @ slope
    fall = float(-slope @ shift)
    scale = max(1.0, (group.chi_squared - fall) / rest)
    return shift, np.sqrt(np.diag(covariance)), fall, _smaller_p(shift, scale * covariance, rest)


def _whitened(fit: AdjustedNetwork) -> Floats:
    """Rows of observed positions are whitened position by position: so is a shift, (3 positions, 3)."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(fit.network.positions.covariance)).reshape(-1, 3))


def _further(fit: AdjustedNetwork, fields: Floats) -> tuple[Floats, Floats, Floats]:
    """Normal equations of shifts along fields of the whitened positions, and how all else follows a unit."""
    at = fit.factored
    rows = at.others["position"]
    # What exterior orientations and the mounting follow is the same for any points: these are eliminated.
    right = np.zeros((at.problem.layout.size, fields.shape[1]))
    pulls = rows.coefficient[:, None] * np.repeat(rows.weight[:, None] * fields, np.diff(rows.start), axis=0)
    np.add.at(right, rows.column, pulls)
    right[at.problem.held] = 0.0
    steps = solve(at.problem.layout.envelope, at.normal.matrix, right)
    information = fields.T @ fields - right.T @ steps
    return (information + information.T) / 2, fields.T @ (rows.weight * rows.residual), steps.T


def _smaller_p(shift: Floats, covariance: Floats, freedom: float) -> float:
    """The smaller probability of height and plane, corrected for having tested both."""
    of_part = [
        float(
            special.fdtrc(n, freedom, shift[part] @ np.linalg.solve(covariance[part, part], shift[part]) / n)
        )
        for part, n in ((slice(2, 3), 1), (slice(0, 2), 2))
    ]
    return min(1.0, 2.0 * min(of_part))


def _strips_free(network: Network) -> bool:
    return bool(np.any(network.mounting.sigma[STRIPS:]))


@dataclass(frozen=True)
class ImageShift:
    """Scale and principal point of one image against its camera.

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
    fit: AdjustedNetwork, variance_factor: float, done: Callable[[], None] = lambda: None
) -> tuple[ImageShift, ...]:
    """Test each image for a scale and a principal point of its own."""
    screened = screened_shifts(fit, variance_factor)
    suspicious = sorted(screened, key=lambda shift: shift.p_value)[:MOST_JOINT]
    if len(screened) > MOST_JOINT:
        suspicious = [shift for shift in suspicious if shift.p_value < 1.0]
    jointly = dict[str, ImageShift]()
    for suspect in suspicious:
        estimated = joint_shift(fit, suspect.image)
        if estimated is not None:
            jointly[suspect.image] = estimated
        done()
    return tuple(jointly.get(shift.image, shift) for shift in screened)


def joint_shift(fit: AdjustedNetwork, image: str) -> ImageShift | None:
    """Estimate scale and principal point of one image as further unknowns, to first order."""
    network = fit.network
    i = network.image_names.index(image)
    in_image = network.rays.image == i
    sigma = network.rays.sigma[in_image]
    columns = _own_geometry(fit.computed[in_image])
    step = 1.0 / np.linalg.norm((columns / sigma[:, :, None]).reshape(-1, 3), axis=0)
    fields = np.zeros((3, *network.rays.plane.shape))
    fields[:, in_image] = -np.moveaxis(columns * step, -1, 0)
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
    moved = (np.tensordot(amount, fields[:, in_image], 1) - follows[in_image]) / pitch
    return ImageShift(
        image,
        float(amount[0] * unit[0]),
        amount[1:] * unit[1:],
        float(np.linalg.norm(moved, axis=1).max()),
        min(1.0, len(network.image_names) * float(special.fdtrc(k, freedom, statistic))),
        spread,
    )


def _own_geometry(plane: Floats) -> Floats:
    """Displacement of image plane coordinates by a scale and a shift of one image, (n, 2, 3)."""
    zero, ones = np.zeros(len(plane)), np.ones(len(plane))
    x, y = plane.T
    return np.stack([np.column_stack(pair) for pair in ((x, y), (ones, zero), (zero, ones))], axis=-1)


def screened_shifts(fit: AdjustedNetwork, variance_factor: float) -> tuple[ImageShift, ...]:
    """Test the residuals of each image for a scale and a principal point of its own."""
    network, rays = fit.network, fit.network.rays
    images, shown = len(network.image_names), np.bincount(rays.image, minlength=len(network.image_names))
    order = np.argsort(rays.image, kind="stable")
    ends = np.cumsum(shown)
    columns, sigma = np.empty((len(order), 2, 9)), rays.sigma[order]
    _pose_derivatives(fit, order, columns[:, :, :6])
    columns[:, :, 6:] = _own_geometry(fit.computed[order])
    weighted = (columns / sigma[:, :, None]).reshape(-1, 9)
    residual = (fit.solution.residuals[order] / sigma).ravel()
    tested = np.flatnonzero(2 * shown >= policy.fewest_coordinates_of_image)
    if not len(tested):
        return ()
    # Residuals are computed minus measured: what must be added to the measurements.
    normal, slope = np.empty((len(tested), 9, 9)), np.empty((len(tested), 9))
    for k, i in enumerate(tested.tolist()):
        rows = slice(2 * (ends[i] - shown[i]), 2 * ends[i])
        normal[k], slope[k] = weighted[rows].T @ weighted[rows], weighted[rows].T @ residual[rows]
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
    p_value = np.minimum(1.0, images * special.fdtrc(number, fit.solution.degrees_of_freedom, statistic))
    shifts = []
    for k in np.flatnonzero(number).tolist():
        i = int(tested[k])
        pitch = np.array(network.cameras[network.exposures.camera[i]].pitch)
        moved = (columns[ends[i] - shown[i] : ends[i]].reshape(-1, 9) @ change[k]).reshape(-1, 2) / pitch
        effect = float(np.linalg.norm(moved, axis=1).max())
        scale, shift = float(change[k, 6]), change[k, 7:] / pitch
        shifts.append(ImageShift(network.image_names[i], scale, shift, effect, float(p_value[k])))
    return tuple(shifts)


def _pose_derivatives(fit: AdjustedNetwork, rays: Integers, columns: Floats) -> None:
    """Fill in (n, 2, 6), by how much ideal coordinates of some rays change with the pose of their images."""
    image = fit.network.rays.image[rays]
    c = fit.state.cameras[fit.network.exposures.camera[image], 0]
    axes, (x, y, z) = fit.state.rotation[image], fit.seen[rays].T
    scale = -c / z
    for k, (here, other) in enumerate(((x, y), (y, x))):
        along, sign = -scale * here / z, 1.0 - 2.0 * k
        # A small turn t moves q by t x q.
        columns[:, k, k] = along * (y if k == 0 else -x)
        columns[:, k, 1 - k] = along * (-x if k == 0 else y) + sign * scale * z
        columns[:, k, 2] = -sign * scale * other
        columns[:, k, 3:] = -scale[:, None] * axes[:, k] - along[:, None] * axes[:, 2]

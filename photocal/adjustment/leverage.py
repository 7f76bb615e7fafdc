"""Groups of images left out of an adjusted network in closed form, for what it makes of the cameras.

With X the derivatives of the observations by the parameters of the cameras when all other unknowns follow,
and Q their covariance, a group of images moves the parameters by (Q^-1 - X'DX)^-1 X'Dv when it is left out,
which are sums over its own observations (Cook 1977; Bell and McCaffrey 2002). D is their weight where points
are intersected anew from the rays that are left. The orientations of the group go with it, since nothing else
determines them. How other orientations loosen is left out. It makes the spread over groups smaller than exact
removals do: by 6 % in the middle, by a fifth at most, which is what fifteen groups tell of a spread.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.equations import Equations
from photocal.adjustment.factored import camera_covariance_columns
from photocal.adjustment.normal import RAYS_IN_PIECE, values_of
from photocal.adjustment.score import followed_by
from photocal.adjustment.sensitivity import along
from photocal.base.arrays import Flags, Floats, Integers

# Of the information of a point, in its worst direction, so much is left or nothing is; of that of a camera.
_LEFT_OF_POINT, _LEFT_OF_CAMERA = 1e-6, 1e-6
# The product over all directions from which on a point's inverse needs no care.
_MUCH_OF_POINT = 1e-3


@dataclass(frozen=True)
class _Rays:
    """Rays in the order of their groups and, within these, of their points.

    weight, residual (n, 2), by_camera (n, 2, k), by_point (n, 2, 3).
    """

    group: Integers
    point: Integers
    weight: Floats
    residual: Floats
    by_camera: Floats
    by_point: Floats


def cameras_without(fitted: AdjustedNetwork, groups: list[Flags]) -> tuple[Floats, Flags]:
    """Parameters of all cameras without each group of images.

    returns values (groups, cameras, parameters).
    returns possible (groups,): without which ones the rest is determined.
    """
    at, state = fitted.factored, fitted.state
    of_cameras = at.problem.layout.camera_columns
    columns = np.concatenate([columns for _, columns in of_cameras])
    values = np.repeat(state.cameras[None], len(groups), axis=0)
    if not len(columns):
        return values, np.ones(len(groups), dtype=np.bool_)
    steps, moved = camera_covariance_columns(at, columns)
    information: Floats = np.linalg.inv(steps[:, columns]).astype(np.float64)
    group = np.zeros(len(fitted.network.image_names), dtype=np.int64)
    for k, out in enumerate(groups):
        group[out] = k
    root = np.linalg.cholesky(steps[:, columns])
    rays = _rays(fitted, group, steps, moved, information)
    pulls, held = _of_others(fitted, group, information @ steps, len(groups))
    starts = np.searchsorted(rays.group, np.arange(len(groups) + 1))
    inverse = at.normal.kept.inverse
    # Few rays at a time, or groups by themselves.
    together = max(1, len(groups) * RAYS_IN_PIECE // max(len(rays.group), 1))
    for begin in range(0, len(groups), together):
        part = slice(begin, min(begin + together, len(groups)))
        pull, hold = _of_groups(rays, starts[part.start : part.stop + 1], inverse)
        pulls[part] += pull
        held[part] += hold
    left = information - held
    possible = np.linalg.eigvalsh(root.T @ left @ root)[:, 0] > _LEFT_OF_CAMERA
    for k in np.flatnonzero(possible).tolist():
        change, first = np.linalg.solve(left[k], pulls[k]), 0
        for camera, (active, own) in enumerate(of_cameras):
            values[k, camera, active] += change[first : first + len(own)]
            first += len(own)
    return values, possible


def _rays(fitted: AdjustedNetwork, group: Integers, steps: Floats, moved: Floats, scale: Floats) -> _Rays:
    """All rays with their derivatives by the cameras' parameters, all else following, and by their points."""
    problem, rays = fitted.factored.problem, fitted.network.rays
    of_ray = group[rays.image]
    order = np.lexsort((rays.point, of_ray))
    # All rays at once: a product of small matrices for each takes several times as long.
    changes = scale.T @ followed_by(fitted.factored, steps, moved).reshape(len(steps), -1)
    unit = np.ascontiguousarray(np.broadcast_to(np.eye(3)[:, None], (3, *fitted.state.points.shape)))
    by_point, nothing = np.zeros((3, *rays.plane.shape)), np.zeros((3, problem.layout.size))
    along(problem.design, values_of(problem, fitted.state), problem.layout.envelope, nothing, unit, by_point)
    return _Rays(
        of_ray[order],
        rays.point[order],
        problem.design.weight[order],
        fitted.solution.residuals[order],
        *(
            np.ascontiguousarray(np.moveaxis(one.reshape(-1, *rays.plane.shape), 0, 2))[order]
            for one in (changes, by_point)
        ),
    )


def _of_groups(rays: _Rays, starts: Integers, inverse: Floats) -> tuple[Floats, Floats]:
    """X'Dv and X'DX of the rays of some groups that follow each other, (groups, k) and (groups, k, k).

    starts (groups + 1,): where the rays of each begin.
    inverse (points, 3, 3): of each point's own normal matrix; zero where it is not eliminated.
    """
    own, count = slice(starts[0], starts[-1]), rays.by_camera.shape[2]
    group, point, x, v = rays.group[own], rays.point[own], rays.by_camera[own], rays.residual[own]
    pull, hold = np.zeros((len(starts) - 1, count)), np.zeros((len(starts) - 1, count, count))
    if not len(point):
        return pull, hold
    weighted = rays.weight[own][:, :, None]
    flat = weighted * x
    new = (point[1:] != point[:-1]) | (group[1:] != group[:-1])
    first = np.flatnonzero(np.append(True, new))
    by_point = np.swapaxes(weighted * rays.by_point[own], 1, 2)
    with_all = np.concatenate([rays.by_point[own], x, v[:, :, None]], axis=2)
    sums = np.add.reduceat(by_point @ with_all, first, axis=0)
    own_block, by_camera, by_residual = sums[:, :, :3], sums[:, :, 3:-1], sums[:, :, -1]
    # In axes in which the point's matrix is the unit, what is left of it is 1 - B'PB.
    whole = inverse[point[first]]
    eliminated = whole.any(axis=(1, 2))
    root = np.zeros_like(whole)
    root[eliminated] = np.linalg.cholesky(whole[eliminated])
    left = np.eye(3) - np.swapaxes(root, 1, 2) @ own_block @ root
    gain = np.empty_like(left)
    # Eigenvalues of it are shares: a product of three that is not small has none that is.
    much = np.linalg.det(left) > _MUCH_OF_POINT
    gain[much] = np.linalg.inv(left[much])
    share, axes = np.linalg.eigh(left[~much])
    # Where nothing is left of a point the rest has no pull either, so that the group had none: 0 / 0 is 0.
    back = np.where(share > _LEFT_OF_POINT, 1.0 / np.maximum(share, _LEFT_OF_POINT), 0.0)
    gain[~much] = (axes * back[:, None]) @ np.swapaxes(axes, 1, 2)
    turned = np.swapaxes(root, 1, 2)
    by_camera, by_residual = turned @ by_camera, np.einsum("pab,pb->pa", turned, by_residual)
    scaled = gain @ by_camera
    ends = starts - starts[0]
    for k, (begin, end) in enumerate(pairwise(ends.tolist())):
        of_points = slice(*np.searchsorted(first, (begin, end)))
        for factor, other, right in (
            (flat[begin:end], x[begin:end], v[begin:end]),
            (scaled[of_points], by_camera[of_points], by_residual[of_points]),
        ):
            transposed = factor.reshape(-1, count).T
            pull[k] += transposed @ right.ravel()
            hold[k] += transposed @ other.reshape(-1, count)
    return pull, hold


def _of_others(fitted: AdjustedNetwork, group: Integers, steps: Floats, groups: int) -> tuple[Floats, Floats]:
    """The same of observations that are of an image of the group alone, beside what all images share.

    steps (k, size): how the reduced system follows a unit of each parameter.
    """
    layout, count = fitted.factored.problem.layout, len(steps)
    pulls, held = np.zeros((groups, count)), np.zeros((groups, count, count))
    image = np.full(layout.size, -1)
    for columns in (layout.image_columns, layout.own_columns):
        for column in columns.T:
            image[column[column >= 0]] = np.flatnonzero(column >= 0)
    for rows in fitted.factored.others.values():
        if not len(rows.weight):
            continue
        of_row = _image_of(rows, image)
        own = of_row >= 0
        effect = np.add.reduceat(rows.coefficient * steps[:, rows.column], rows.start[:-1], axis=1)[:, own]
        weighted, of_group = effect * rows.weight[own], group[of_row[own]]
        np.add.at(pulls, of_group, (weighted * rows.residual[own]).T)
        np.add.at(held, of_group, np.einsum("kr,lr->rkl", weighted, effect))
    return pulls, held


def _image_of(rows: Equations, image: Integers) -> Integers:
    """Which image an observation is of; -1 for those of none."""
    of_row = np.full(len(rows.weight), -1)
    np.maximum.at(of_row, np.repeat(np.arange(len(of_row)), np.diff(rows.start)), image[rows.column])
    return of_row

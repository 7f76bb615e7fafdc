"""The loops over all rays: reduced normal equations, back substitution, and statistics.

Each pass visits the object points one after the other, evaluates the rays of a point with their
derivatives, and is done with the point: nothing of the size of the design matrix is ever stored
(Brown 1976; Triggs et al. 2000, section 6). Points are shared among threads in contiguous pieces.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from photocal.compiled import compiled, compiled_parallel, inlined
from photocal.geometry.lens import ray_residual

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

WORK = 30


class Design(NamedTuple):
    """What stays the same while the unknowns change; arrays that kernels read.

    Attributes
    ----------
    pieces : ndarray of int, shape (threads + 1,)
        First point of each thread's piece.
    ray_start : ndarray of int, shape (points + 1,)
        First ray of each point.
    ray_image : ndarray of int, shape (rays,)
    plane, weight : ndarray, shape (rays, 2)
        Measured coordinates and their weights 1 / sigma^2.
    image_camera, image_column : ndarray of int, shape (images,)
        Camera and first column of each image.
    pose_free : ndarray, shape (images, 6)
        1 where a pose unknown is free, else 0.
    optics : ndarray, shape (cameras, 11)
        From `lens.optics`.
    active : ndarray of int, shape (cameras, 13)
        Positions of the estimated parameters, the first `active_count` of each row.
    active_count, active_column : ndarray of int, shape (cameras,)
        Number of estimated parameters and the first of their columns within the border.
    point_free : ndarray, shape (points, 3)
        1 where a coordinate is free, else 0.
    prior_points, prior_weight : ndarray, shape (points, 3) and (points, 3, 3)
        Observed coordinates and their weights.
    """

    pieces: Integers
    ray_start: Integers
    ray_image: Integers
    plane: Floats
    weight: Floats
    image_camera: Integers
    image_column: Integers
    pose_free: Floats
    optics: Floats
    active: Integers
    active_count: Integers
    active_column: Integers
    point_free: Floats
    prior_points: Floats
    prior_weight: Floats


class Values(NamedTuple):
    """What the unknowns are now.

    Attributes
    ----------
    cameras : ndarray, shape (cameras, 13)
    rotation, basis : ndarray, shape (images, 3, 3)
        Object to camera axes; the turn that each rotation unknown makes.
    centre : ndarray, shape (images, 3)
    points : ndarray, shape (points, 3)
    """

    cameras: Floats
    rotation: Floats
    basis: Floats
    centre: Floats
    points: Floats


class Structure(NamedTuple):
    """Structure of the reduced matrix, see `envelope.Envelope`."""

    panel: int
    last: Integers
    width: Integers
    offset: Integers
    band: int
    border: int


@inlined
def ray_rows(
    values: Floats,
    optic: Floats,
    x: float,
    y: float,
    rotation: Floats,
    basis: Floats,
    centre: Floats,
    point: Floats,
    pose_free: Floats,
    point_free: Floats,
    by_pose: Floats,
    by_point: Floats,
    by_camera: Floats,
    work: Floats,
) -> tuple[float, float]:
    """Residual of one ray and its derivatives with respect to pose (2, 6), point (2, 3), camera (2, 13)."""
    dx, dy, dz = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    q = work[:3]
    by_q = work[3:9].reshape(2, 3)
    u = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
    v = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
    w = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
    q[0], q[1], q[2] = u, v, w
    vx, vy = ray_residual(values, optic, x, y, q, by_q, by_camera, work[10:30].reshape(10, 2))
    for a in range(2):
        g0, g1, g2 = by_q[a, 0], by_q[a, 1], by_q[a, 2]
        # A small turn t moves q by t x q.
        t0, t1, t2 = v * g2 - w * g1, w * g0 - u * g2, u * g1 - v * g0
        for k in range(3):
            by_pose[a, k] = (t0 * basis[0, k] + t1 * basis[1, k] + t2 * basis[2, k]) * pose_free[k]
            along = g0 * rotation[0, k] + g1 * rotation[1, k] + g2 * rotation[2, k]
            by_pose[a, 3 + k] = -along * pose_free[3 + k]
            by_point[a, k] = along * point_free[k]
    return vx, vy


@inlined
def inverse3(matrix: Floats, result: Floats) -> bool:
    """Invert a symmetric positive definite 3 x 3 matrix; False when it is singular."""
    a, b, c = matrix[0, 0], matrix[1, 1], matrix[2, 2]
    d, e, f = matrix[1, 0], matrix[2, 0], matrix[2, 1]
    c00, c10, c20 = b * c - f * f, e * f - d * c, d * f - b * e
    determinant = a * c00 + d * c10 + e * c20
    if not determinant > 1e-14 * a * b * c:
        return False
    s = 1.0 / determinant
    result[0, 0], result[1, 1], result[2, 2] = c00 * s, (a * c - e * e) * s, (a * b - d * d) * s
    result[1, 0] = result[0, 1] = c10 * s
    result[2, 0] = result[0, 2] = c20 * s
    result[2, 1] = result[1, 2] = (d * e - a * f) * s
    return True


@compiled_parallel
def accumulate(
    design: Design,
    values: Values,
    structure: Structure,
    damping: float,
    matrices: Floats,
    gradients: Floats,
    totals: Floats,
    singular: NDArray[np.bool_],
) -> None:
    """Normal equations of the rays and of the weighted points, reduced to images and border.

    Parameters
    ----------
    design, values, structure
        The network, the current unknowns and where they stand.
    damping : float
        Relative addition to the diagonal of each point's own block (Marquardt 1963).
    matrices, gradients, totals
        Receive, for each thread, the matrix, the gradient A'Pv and the sum of v'Pv.
    singular : ndarray of bool, shape (points,)
        Receives the points that their rays do not determine.
    """
    pieces, ray_start, ray_image, plane = design.pieces, design.ray_start, design.ray_image, design.plane
    weight, image_camera, image_column, pose_free = (
        design.weight,
        design.image_camera,
        design.image_column,
        design.pose_free,
    )
    optics, active, active_count, active_column = (
        design.optics,
        design.active,
        design.active_count,
        design.active_column,
    )
    point_free, prior_points, prior_weight = design.point_free, design.prior_points, design.prior_weight
    cameras, rotation, basis, centre = values.cameras, values.rotation, values.basis, values.centre
    points = values.points
    panel, last, width, offset = structure.panel, structure.last, structure.width, structure.offset
    band, border = structure.band, structure.border
    for thread in numba.prange(len(pieces) - 1):
        matrix, gradient = matrices[thread], gradients[thread]
        total = 0.0
        first, stop = pieces[thread], pieces[thread + 1]
        most = 1
        for j in range(first, stop):
            most = max(most, ray_start[j + 1] - ray_start[j])
        work = np.zeros(WORK)
        by_pose, by_point, by_camera = np.zeros((2, 6)), np.zeros((2, 3)), np.zeros((2, 13))
        mixed = np.zeros((most, 6, 3))
        mixed_border, scaled_border = np.zeros((max(border, 1), 3)), np.zeros((max(border, 1), 3))
        scaled = np.zeros((6, 3))
        block, inverse = np.zeros((3, 3)), np.zeros((3, 3))
        side = np.zeros(3)
        for j in range(first, stop):
            begin, end = ray_start[j], ray_start[j + 1]
            for a in range(3):
                side[a] = 0.0
                for b in range(3):
                    p = prior_weight[j, a, b]
                    deviation = points[j, b] - prior_points[j, b]
                    block[a, b] = p
                    side[a] += p * deviation
                    total += (points[j, a] - prior_points[j, a]) * p * deviation
            for a in range(3):
                if point_free[j, a] == 0.0:
                    side[a] = 0.0
                    for b in range(3):
                        block[a, b] = 0.0
                        block[b, a] = 0.0
                    block[a, a] = 1.0
            mixed_border[:] = 0.0
            for r in range(begin, end):
                i = ray_image[r]
                k = image_camera[i]
                vx, vy = ray_rows(
                    cameras[k], optics[k], plane[r, 0], plane[r, 1], rotation[i], basis[i], centre[i],
                    points[j], pose_free[i], point_free[j], by_pose, by_point, by_camera, work,
                )  # fmt: skip
                px, py = weight[r, 0], weight[r, 1]
                total += px * vx * vx + py * vy * vy
                column = image_column[i]
                home = column // panel
                step = width[home]
                corner = offset[home] + (column - home * panel) * step + column - home * panel
                foot = offset[home] + (last[home] - home * panel) * step + column - home * panel
                for a in range(6):
                    ax, ay = px * by_pose[0, a], py * by_pose[1, a]
                    gradient[column + a] += ax * vx + ay * vy
                    for b in range(a + 1):
                        matrix[corner + a * step + b] += ax * by_pose[0, b] + ay * by_pose[1, b]
                    for b in range(3):
                        mixed[r - begin, a, b] = ax * by_point[0, b] + ay * by_point[1, b]
                for a in range(3):
                    ax, ay = px * by_point[0, a], py * by_point[1, a]
                    side[a] += ax * vx + ay * vy
                    for b in range(3):
                        block[a, b] += ax * by_point[0, b] + ay * by_point[1, b]
                at = active_column[k]
                for s in range(active_count[k]):
                    cx, cy = px * by_camera[0, active[k, s]], py * by_camera[1, active[k, s]]
                    gradient[band + at + s] += cx * vx + cy * vy
                    row = foot + (at + s) * step
                    for b in range(6):
                        matrix[row + b] += cx * by_pose[0, b] + cy * by_pose[1, b]
                    for b in range(3):
                        mixed_border[at + s, b] += cx * by_point[0, b] + cy * by_point[1, b]
                    row = offset[len(width) - 1] + (at + s) * border + at
                    for b in range(s + 1):
                        matrix[row + b] += cx * by_camera[0, active[k, b]] + cy * by_camera[1, active[k, b]]
            for a in range(3):
                block[a, a] *= 1.0 + damping
            if not inverse3(block, inverse):
                singular[j] = True
                continue
            # Eliminate the point.
            for a in range(border):
                for b in range(3):
                    scaled_border[a, b] = (
                        mixed_border[a, 0] * inverse[0, b]
                        + mixed_border[a, 1] * inverse[1, b]
                        + mixed_border[a, 2] * inverse[2, b]
                    )
                gradient[band + a] -= (
                    scaled_border[a, 0] * side[0]
                    + scaled_border[a, 1] * side[1]
                    + scaled_border[a, 2] * side[2]
                )
                row = offset[len(width) - 1] + a * border
                for b in range(a + 1):
                    matrix[row + b] -= (
                        scaled_border[a, 0] * mixed_border[b, 0]
                        + scaled_border[a, 1] * mixed_border[b, 1]
                        + scaled_border[a, 2] * mixed_border[b, 2]
                    )
            for r in range(end - begin):
                column = image_column[ray_image[begin + r]]
                for a in range(6):
                    for b in range(3):
                        scaled[a, b] = (
                            mixed[r, a, 0] * inverse[0, b]
                            + mixed[r, a, 1] * inverse[1, b]
                            + mixed[r, a, 2] * inverse[2, b]
                        )
                    gradient[column + a] -= (
                        scaled[a, 0] * side[0] + scaled[a, 1] * side[1] + scaled[a, 2] * side[2]
                    )
                home = column // panel
                step = width[home]
                foot = offset[home] + (last[home] - home * panel) * step + column - home * panel
                for s in range(border):
                    row = foot + s * step
                    for b in range(6):
                        matrix[row + b] -= (
                            mixed_border[s, 0] * scaled[b, 0]
                            + mixed_border[s, 1] * scaled[b, 1]
                            + mixed_border[s, 2] * scaled[b, 2]
                        )
                top = offset[home] + column - home * panel
                for t in range(end - begin):
                    other = image_column[ray_image[begin + t]]
                    if other < column:
                        continue
                    corner = top + (other - home * panel) * step
                    for a in range(6):
                        m0, m1, m2 = mixed[t, a, 0], mixed[t, a, 1], mixed[t, a, 2]
                        row = corner + a * step
                        for b in range(6):
                            matrix[row + b] -= m0 * scaled[b, 0] + m1 * scaled[b, 1] + m2 * scaled[b, 2]
        totals[thread] += total


@compiled_parallel
def back_substitute(
    design: Design,
    values: Values,
    structure: Structure,
    damping: float,
    step: Floats,
    new: Values,
    decreases: Floats,
    totals: Floats,
) -> None:
    """Steps of the points for a step of the reduced system, and the sum of v'Pv at the new values.

    Parameters
    ----------
    design, values, structure, damping
        As in `accumulate`, at the old values.
    step : ndarray, shape (n,)
        Step of the reduced system.
    new : Values
        After the step; its points are received.
    decreases, totals : ndarray, shape (threads,)
        Receive g'V^-1 g of the points, g the gradient, and the new sum of v'Pv. A point behind a camera
        that sees it makes the sum infinite.
    """
    pieces, ray_start, ray_image, plane = design.pieces, design.ray_start, design.ray_image, design.plane
    weight, image_camera, image_column, pose_free = (
        design.weight,
        design.image_camera,
        design.image_column,
        design.pose_free,
    )
    optics, active, active_count, active_column = (
        design.optics,
        design.active,
        design.active_count,
        design.active_column,
    )
    point_free, prior_points, prior_weight = design.point_free, design.prior_points, design.prior_weight
    cameras, rotation, basis, centre = values.cameras, values.rotation, values.basis, values.centre
    points = values.points
    band = structure.band
    new_cameras, new_rotation, new_centre, new_points = new.cameras, new.rotation, new.centre, new.points
    for thread in numba.prange(len(pieces) - 1):
        total, decrease = 0.0, 0.0
        work = np.zeros(WORK)
        by_pose, by_point, by_camera = np.zeros((2, 6)), np.zeros((2, 3)), np.zeros((2, 13))
        block, inverse = np.zeros((3, 3)), np.zeros((3, 3))
        side, change = np.zeros(3), np.zeros(3)
        for j in range(pieces[thread], pieces[thread + 1]):
            for a in range(3):
                side[a] = 0.0
                for b in range(3):
                    p = prior_weight[j, a, b]
                    block[a, b] = p
                    side[a] += p * (points[j, b] - prior_points[j, b])
            for a in range(3):
                if point_free[j, a] == 0.0:
                    side[a] = 0.0
                    for b in range(3):
                        block[a, b] = 0.0
                        block[b, a] = 0.0
                    block[a, a] = 1.0
            for a in range(3):
                change[a] = side[a]
            for r in range(ray_start[j], ray_start[j + 1]):
                i = ray_image[r]
                k = image_camera[i]
                vx, vy = ray_rows(
                    cameras[k], optics[k], plane[r, 0], plane[r, 1], rotation[i], basis[i], centre[i],
                    points[j], pose_free[i], point_free[j], by_pose, by_point, by_camera, work,
                )  # fmt: skip
                fx, fy = vx, vy
                column = image_column[i]
                for a in range(6):
                    fx += by_pose[0, a] * step[column + a]
                    fy += by_pose[1, a] * step[column + a]
                at = band + active_column[k]
                for s in range(active_count[k]):
                    fx += by_camera[0, active[k, s]] * step[at + s]
                    fy += by_camera[1, active[k, s]] * step[at + s]
                for a in range(3):
                    ax, ay = weight[r, 0] * by_point[0, a], weight[r, 1] * by_point[1, a]
                    side[a] += ax * vx + ay * vy
                    change[a] += ax * fx + ay * fy
                    for b in range(3):
                        block[a, b] += ax * by_point[0, b] + ay * by_point[1, b]
            for a in range(3):
                block[a, a] *= 1.0 + damping
            if inverse3(block, inverse):
                for a in range(3):
                    move = -(
                        inverse[a, 0] * change[0] + inverse[a, 1] * change[1] + inverse[a, 2] * change[2]
                    )
                    new_points[j, a] = points[j, a] + move
                    for b in range(3):
                        decrease += side[a] * inverse[a, b] * side[b]
            else:
                for a in range(3):
                    new_points[j, a] = points[j, a]
            for a in range(3):
                for b in range(3):
                    total += (
                        (new_points[j, a] - prior_points[j, a])
                        * prior_weight[j, a, b]
                        * (new_points[j, b] - prior_points[j, b])
                    )
            for r in range(ray_start[j], ray_start[j + 1]):
                i = ray_image[r]
                k = image_camera[i]
                vx, vy = ray_rows(
                    new_cameras[k], optics[k], plane[r, 0], plane[r, 1], new_rotation[i], basis[i],
                    new_centre[i], new_points[j], pose_free[i], point_free[j], by_pose, by_point, by_camera,
                    work,
                )  # fmt: skip
                total += weight[r, 0] * vx * vx + weight[r, 1] * vy * vy
                if work[2] >= 0.0:
                    total = np.inf
        totals[thread] += total
        decreases[thread] += decrease


@inlined
def element_address(structure: Structure, row: int, column: int) -> int:
    """Where an element of the lower triangle stands among the values of the reduced matrix."""
    panel, band = structure.panel, structure.band
    if column >= band:
        return int(
            structure.offset[len(structure.width) - 1] + (row - band) * structure.border + column - band
        )
    home = column // panel
    top = home * panel
    line = row - top if row < band else structure.last[home] - top + row - band
    return int(structure.offset[home] + line * structure.width[home] + column - top)


@compiled_parallel
def statistics(
    design: Design,
    values: Values,
    structure: Structure,
    inverse: Floats,
    point_covariance: Floats,
    residuals: Floats,
    redundancy: Floats,
) -> None:
    """Covariance of each point, and residual and redundancy number of each image coordinate.

    Parameters
    ----------
    design, values, structure
        As in `accumulate`, at the adjusted values.
    inverse : ndarray
        Selected inverse of the reduced matrix.
    point_covariance : ndarray, shape (points, 3, 3)
    residuals, redundancy : ndarray, shape (rays, 2)
        Receive the results. r = 1 - p a Q a' with a the row of the design matrix (Foerstner 1979).
    """
    pieces, ray_start, ray_image, plane = design.pieces, design.ray_start, design.ray_image, design.plane
    weight, image_camera, image_column, pose_free = (
        design.weight,
        design.image_camera,
        design.image_column,
        design.pose_free,
    )
    optics, active, active_count, active_column = (
        design.optics,
        design.active,
        design.active_count,
        design.active_column,
    )
    point_free, prior_weight = design.point_free, design.prior_weight
    cameras, rotation, basis, centre = values.cameras, values.rotation, values.basis, values.centre
    points = values.points
    band, border = structure.band, structure.border
    for thread in numba.prange(len(pieces) - 1):
        first, stop = pieces[thread], pieces[thread + 1]
        most = 1
        for j in range(first, stop):
            most = max(most, ray_start[j + 1] - ray_start[j])
        work = np.zeros(WORK)
        by_camera = np.zeros((2, 13))
        poses, rows, lens = np.zeros((most, 2, 6)), np.zeros((most, 2, 3)), np.zeros((most, 2, 13))
        size = 6 * most + border
        columns = np.zeros(size, dtype=np.int64)
        mixed, spread = np.zeros((size, 3)), np.zeros((size, 3))
        local = np.zeros((size, size))
        block, own, cov = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
        for j in range(first, stop):
            begin, n = ray_start[j], ray_start[j + 1] - ray_start[j]
            for a in range(3):
                for b in range(3):
                    block[a, b] = prior_weight[j, a, b]
            for a in range(3):
                if point_free[j, a] == 0.0:
                    for b in range(3):
                        block[a, b] = 0.0
                        block[b, a] = 0.0
                    block[a, a] = 1.0
            edge = 6 * n
            m = edge + border
            mixed[:m] = 0.0
            for s in range(border):
                columns[edge + s] = band + s
            for r in range(n):
                ray = begin + r
                i = ray_image[ray]
                k = image_camera[i]
                vx, vy = ray_rows(
                    cameras[k], optics[k], plane[ray, 0], plane[ray, 1], rotation[i], basis[i], centre[i],
                    points[j], pose_free[i], point_free[j], poses[r], rows[r], by_camera, work,
                )  # fmt: skip
                residuals[ray, 0], residuals[ray, 1] = vx, vy
                for a in range(6):
                    columns[6 * r + a] = image_column[i] + a
                for a in range(2):
                    p = weight[ray, a]
                    for b in range(3):
                        pb = p * rows[r, a, b]
                        for c in range(3):
                            block[b, c] += pb * rows[r, a, c]
                        for c in range(6):
                            mixed[6 * r + c, b] += pb * poses[r, a, c]
                        for s in range(active_count[k]):
                            mixed[edge + active_column[k] + s, b] += pb * by_camera[a, active[k, s]]
                    for s in range(active_count[k]):
                        lens[r, a, s] = by_camera[a, active[k, s]]
            if not inverse3(block, own):
                point_covariance[j] = np.nan
                redundancy[begin : begin + n] = np.nan
                continue
            for a in range(m):
                for b in range(a + 1):
                    high, low = max(columns[a], columns[b]), min(columns[a], columns[b])
                    z = inverse[element_address(structure, high, low)]
                    local[a, b] = z
                    local[b, a] = z
            # spread = Q_uu W V^-1, so that Q_up = -spread and Q_pp = V^-1 + V^-1 W' spread.
            for a in range(m):
                s0, s1, s2 = 0.0, 0.0, 0.0
                for b in range(m):
                    z = local[a, b]
                    s0 += z * mixed[b, 0]
                    s1 += z * mixed[b, 1]
                    s2 += z * mixed[b, 2]
                for b in range(3):
                    spread[a, b] = s0 * own[0, b] + s1 * own[1, b] + s2 * own[2, b]
            for a in range(3):
                for b in range(3):
                    block[a, b] = 0.0
                    for c in range(m):
                        block[a, b] += mixed[c, a] * spread[c, b]
            for a in range(3):
                for b in range(3):
                    cov[a, b] = (
                        own[a, b]
                        + own[a, 0] * block[0, b]
                        + own[a, 1] * block[1, b]
                        + own[a, 2] * block[2, b]
                    )
            for a in range(3):
                for b in range(3):
                    held = point_free[j, a] == 0.0 or point_free[j, b] == 0.0
                    point_covariance[j, a, b] = 0.0 if held else cov[a, b]
            for r in range(n):
                k = image_camera[ray_image[begin + r]]
                at = edge + active_column[k]
                count = active_count[k]
                for a in range(2):
                    variance = 0.0
                    for b in range(3):
                        along = 0.0
                        for c in range(6):
                            along += poses[r, a, c] * spread[6 * r + c, b]
                        for s in range(count):
                            along += lens[r, a, s] * spread[at + s, b]
                        variance -= 2.0 * along * rows[r, a, b]
                        for c in range(3):
                            variance += rows[r, a, b] * cov[b, c] * rows[r, a, c]
                    for b in range(6):
                        part = 0.0
                        for c in range(6):
                            part += local[6 * r + b, 6 * r + c] * poses[r, a, c]
                        for s in range(count):
                            part += 2.0 * local[6 * r + b, at + s] * lens[r, a, s]
                        variance += poses[r, a, b] * part
                    for b in range(count):
                        for s in range(count):
                            variance += lens[r, a, b] * local[at + b, at + s] * lens[r, a, s]
                    redundancy[begin + r, a] = 1.0 - weight[begin + r, a] * variance


@compiled
def evaluate(
    ray_image: Integers,
    ray_point: Integers,
    plane: Floats,
    image_camera: Integers,
    rotation: Floats,
    centre: Floats,
    cameras: Floats,
    optics: Floats,
    points: Floats,
    residuals: Floats,
    depth: Floats,
) -> None:
    """Residuals, shape (rays, 2), and depths (positive in front of the camera), shape (rays,)."""
    work, by_q, by_camera = np.zeros((10, 2)), np.zeros((2, 3)), np.zeros((2, 13))
    q = np.zeros(3)
    for r in range(len(ray_image)):
        i, j = ray_image[r], ray_point[r]
        for a in range(3):
            q[a] = 0.0
            for b in range(3):
                q[a] += rotation[i, a, b] * (points[j, b] - centre[i, b])
        k = image_camera[i]
        residuals[r, 0], residuals[r, 1] = ray_residual(
            cameras[k], optics[k], plane[r, 0], plane[r, 1], q, by_q, by_camera, work
        )
        depth[r] = -q[2]

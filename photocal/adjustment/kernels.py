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
from photocal.geometry.lens import Scratch, ray_residual, scratch

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


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
    point_column : ndarray of int, shape (points,)
        First column, within the border, of a point that is not eliminated; -1 for all others.
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
    point_column: Integers
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
    """Structure of the reduced matrix, see `envelope.Envelope`.

    The first `lens` columns of the border belong to the cameras: the only ones that rays touch.
    """

    panel: int
    last: Integers
    width: Integers
    offset: Integers
    band: int
    border: int
    lens: int


class Eliminated(NamedTuple):
    """What elimination of the points leaves behind, so that their steps can be found afterwards.

    Attributes
    ----------
    mixed : ndarray, shape (rays, 3, 6)
        Normal matrix between the point and the exposure of each ray.
    mixed_border : ndarray, shape (points, 3, lens)
        Between each point and the cameras.
    inverse : ndarray, shape (points, 3, 3)
        Inverse of each point's own block; zero where its rays do not determine it.
    gradient : ndarray, shape (points, 3)
    """

    mixed: Floats
    mixed_border: Floats
    inverse: Floats
    gradient: Floats


@inlined
def ray_rows(design: Design, values: Values, r: int, i: int, j: int, room: Scratch) -> tuple[float, float]:
    """Residual of ray r from image i to point j; its derivatives are put into the scratch room."""
    points, centre, rotation, basis = values.points, values.centre, values.rotation, values.basis
    k = design.image_camera[i]
    dx, dy, dz = points[j, 0] - centre[i, 0], points[j, 1] - centre[i, 1], points[j, 2] - centre[i, 2]
    u = rotation[i, 0, 0] * dx + rotation[i, 0, 1] * dy + rotation[i, 0, 2] * dz
    v = rotation[i, 1, 0] * dx + rotation[i, 1, 1] * dy + rotation[i, 1, 2] * dz
    w = rotation[i, 2, 0] * dx + rotation[i, 2, 1] * dy + rotation[i, 2, 2] * dz
    vx, vy = ray_residual(
        values.cameras, design.optics, k, design.plane[r, 0], design.plane[r, 1], u, v, w, room
    )
    by_q, by_pose, by_point = room.by_q, room.by_pose, room.by_point
    for a in range(2):
        g0, g1, g2 = by_q[a, 0], by_q[a, 1], by_q[a, 2]
        # A small turn t moves q by t x q.
        t0, t1, t2 = v * g2 - w * g1, w * g0 - u * g2, u * g1 - v * g0
        for n in range(3):
            turn = t0 * basis[i, 0, n] + t1 * basis[i, 1, n] + t2 * basis[i, 2, n]
            along = g0 * rotation[i, 0, n] + g1 * rotation[i, 1, n] + g2 * rotation[i, 2, n]
            by_pose[a, n] = turn * design.pose_free[i, n]
            by_pose[a, 3 + n] = -along * design.pose_free[i, 3 + n]
            by_point[a, n] = along * design.point_free[j, n]
    return vx, vy


@inlined
def inverse3(matrix: Floats, result: Floats, j: int) -> bool:
    """Invert a symmetric positive definite 3 x 3 matrix; False, and zeros, when it is singular."""
    a, b, c = matrix[0, 0], matrix[1, 1], matrix[2, 2]
    d, e, f = matrix[1, 0], matrix[2, 0], matrix[2, 1]
    c00, c10, c20 = b * c - f * f, e * f - d * c, d * f - b * e
    determinant = a * c00 + d * c10 + e * c20
    if not determinant > 1e-14 * a * b * c:
        result[j] = 0.0
        return False
    s = 1.0 / determinant
    result[j, 0, 0], result[j, 1, 1], result[j, 2, 2] = c00 * s, (a * c - e * e) * s, (a * b - d * d) * s
    result[j, 1, 0] = result[j, 0, 1] = c10 * s
    result[j, 2, 0] = result[j, 0, 2] = c20 * s
    result[j, 2, 1] = result[j, 1, 2] = (d * e - a * f) * s
    return True


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


@inlined
def own_block(design: Design, values: Values, j: int, block: Floats, side: Floats) -> float:
    """Start the normal equations of a point with its observed coordinates; returns their v'Pv."""
    total = 0.0
    for a in range(3):
        side[a] = 0.0
        for b in range(3):
            p = design.prior_weight[j, a, b]
            v = values.points[j, b] - design.prior_points[j, b]
            block[a, b] = p
            side[a] += p * v
            total += (values.points[j, a] - design.prior_points[j, a]) * p * v
    for a in range(3):
        if design.point_free[j, a] == 0.0:
            side[a] = 0.0
            for b in range(3):
                block[a, b] = 0.0
                block[b, a] = 0.0
            block[a, a] = 1.0
    return total


@inlined
def add_ray(
    design: Design,
    structure: Structure,
    r: int,
    i: int,
    j: int,
    vx: float,
    vy: float,
    room: Scratch,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
    block: Floats,
    side: Floats,
) -> None:
    """Add one ray to the normal equations of its exposure, camera and point."""
    by_pose, by_point, by_camera = room.by_pose, room.by_point, room.by_camera
    panel, band, border, width = structure.panel, structure.band, structure.border, structure.width
    k = design.image_camera[i]
    px, py = design.weight[r, 0], design.weight[r, 1]
    column = design.image_column[i]
    home = column // panel
    top = home * panel
    step = width[home]
    corner = structure.offset[home] + (column - top) * step + column - top
    foot = structure.offset[home] + (structure.last[home] - top) * step + column - top
    for a in range(6):
        ax, ay = px * by_pose[0, a], py * by_pose[1, a]
        gradient[column + a] += ax * vx + ay * vy
        for b in range(a + 1):
            matrix[corner + a * step + b] += ax * by_pose[0, b] + ay * by_pose[1, b]
    for a in range(3):
        ax, ay = px * by_point[0, a], py * by_point[1, a]
        side[a] += ax * vx + ay * vy
        for b in range(3):
            block[a, b] += ax * by_point[0, b] + ay * by_point[1, b]
        for b in range(6):
            kept.mixed[r, a, b] = ax * by_pose[0, b] + ay * by_pose[1, b]
    at = design.active_column[k]
    own = structure.offset[len(width) - 1] + at * (border + 1)
    for s in range(design.active_count[k]):
        n = design.active[k, s]
        cx, cy = px * by_camera[0, n], py * by_camera[1, n]
        gradient[band + at + s] += cx * vx + cy * vy
        row = foot + (at + s) * step
        for b in range(6):
            matrix[row + b] += cx * by_pose[0, b] + cy * by_pose[1, b]
        for b in range(3):
            kept.mixed_border[j, b, at + s] += cx * by_point[0, b] + cy * by_point[1, b]
        row = own + s * border
        for b in range(s + 1):
            matrix[row + b] += cx * by_camera[0, design.active[k, b]] + cy * by_camera[1, design.active[k, b]]


@inlined
def eliminate(
    design: Design,
    structure: Structure,
    j: int,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
    scaled: Floats,
    scaled_border: Floats,
) -> None:
    """Subtract what the point's own unknowns explain from the normal equations of what sees it."""
    panel, band, border, width = structure.panel, structure.band, structure.border, structure.width
    lens = structure.lens
    mixed, mixed_border, inverse, side = kept.mixed, kept.mixed_border, kept.inverse, kept.gradient
    begin, end = design.ray_start[j], design.ray_start[j + 1]
    g0, g1, g2 = side[j, 0], side[j, 1], side[j, 2]
    for a in range(3):
        for s in range(lens):
            scaled_border[a, s] = (
                inverse[j, a, 0] * mixed_border[j, 0, s]
                + inverse[j, a, 1] * mixed_border[j, 1, s]
                + inverse[j, a, 2] * mixed_border[j, 2, s]
            )
    own = structure.offset[len(width) - 1]
    for s in range(lens):
        gradient[band + s] -= scaled_border[0, s] * g0 + scaled_border[1, s] * g1 + scaled_border[2, s] * g2
        m0, m1, m2 = mixed_border[j, 0, s], mixed_border[j, 1, s], mixed_border[j, 2, s]
        row = own + s * border
        for t in range(s + 1):
            matrix[row + t] -= m0 * scaled_border[0, t] + m1 * scaled_border[1, t] + m2 * scaled_border[2, t]
    for r in range(begin, end):
        column = design.image_column[design.ray_image[r]]
        for a in range(3):
            for b in range(6):
                scaled[a, b] = (
                    inverse[j, a, 0] * mixed[r, 0, b]
                    + inverse[j, a, 1] * mixed[r, 1, b]
                    + inverse[j, a, 2] * mixed[r, 2, b]
                )
        for b in range(6):
            gradient[column + b] -= scaled[0, b] * g0 + scaled[1, b] * g1 + scaled[2, b] * g2
        home = column // panel
        top = home * panel
        step = width[home]
        foot = structure.offset[home] + (structure.last[home] - top) * step + column - top
        for s in range(lens):
            m0, m1, m2 = mixed_border[j, 0, s], mixed_border[j, 1, s], mixed_border[j, 2, s]
            row = foot + s * step
            for b in range(6):
                matrix[row + b] -= m0 * scaled[0, b] + m1 * scaled[1, b] + m2 * scaled[2, b]
        start = structure.offset[home] + column - top
        for t in range(begin, end):
            other = design.image_column[design.ray_image[t]]
            if other < column:
                continue
            corner = start + (other - top) * step
            for a in range(6):
                m0, m1, m2 = mixed[t, 0, a], mixed[t, 1, a], mixed[t, 2, a]
                row = corner + a * step
                for b in range(6):
                    matrix[row + b] -= m0 * scaled[0, b] + m1 * scaled[1, b] + m2 * scaled[2, b]


@inlined
def retain(
    design: Design,
    structure: Structure,
    j: int,
    block: Floats,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
) -> None:
    """Add the normal equations of a point that stays among the unknowns of the border."""
    panel, band, border, width = structure.panel, structure.band, structure.border, structure.width
    at = design.point_column[j]
    own = structure.offset[len(width) - 1]
    for a in range(3):
        row = own + (at + a) * border
        gradient[band + at + a] += kept.gradient[j, a]
        for b in range(a + 1):
            matrix[row + at + b] += block[a, b]
        # The cameras' columns come before those of the points.
        for s in range(structure.lens):
            matrix[row + s] += kept.mixed_border[j, a, s]
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            column = design.image_column[design.ray_image[r]]
            home = column // panel
            top = home * panel
            foot = structure.offset[home] + (structure.last[home] - top + at + a) * width[home] + column - top
            for b in range(6):
                matrix[foot + b] += kept.mixed[r, a, b]
        for b in range(3):
            kept.inverse[j, a, b] = 0.0


@compiled
def accumulate_piece(
    design: Design,
    values: Values,
    structure: Structure,
    damping: float,
    piece: int,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
    singular: NDArray[np.bool_],
    room: Scratch,
    block: Floats,
    side: Floats,
    scaled: Floats,
    scaled_border: Floats,
) -> float:
    """Normal equations of one thread's points; returns their v'Pv, infinite for a point behind a camera."""
    total = 0.0
    for j in range(design.pieces[piece], design.pieces[piece + 1]):
        total += own_block(design, values, j, block, side)
        for a in range(3):
            for s in range(structure.lens):
                kept.mixed_border[j, a, s] = 0.0
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            i = design.ray_image[r]
            vx, vy = ray_rows(design, values, r, i, j, room)
            total += design.weight[r, 0] * vx * vx + design.weight[r, 1] * vy * vy
            if not room.depth[0] > 0.0:
                total = np.inf
            add_ray(design, structure, r, i, j, vx, vy, room, matrix, gradient, kept, block, side)
        for a in range(3):
            kept.gradient[j, a] = side[a]
        if design.point_column[j] >= 0:
            retain(design, structure, j, block, matrix, gradient, kept)
            singular[j] = False
            continue
        for a in range(3):
            block[a, a] *= 1.0 + damping
        singular[j] = not inverse3(block, kept.inverse, j)
        if not singular[j]:
            eliminate(design, structure, j, matrix, gradient, kept, scaled, scaled_border)
    return total


@compiled_parallel
def accumulate(
    design: Design,
    values: Values,
    structure: Structure,
    damping: float,
    matrices: Floats,
    gradients: Floats,
    totals: Floats,
    kept: Eliminated,
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
        Receive, for each thread, the matrix, the gradient A'Pv and the sum of v'Pv, which is infinite
        when a point lies behind a camera that sees it.
    kept : Eliminated
        Receives what the points' steps need.
    singular : ndarray of bool, shape (points,)
        Receives the points that their rays do not determine.
    """
    for piece in numba.prange(len(design.pieces) - 1):
        totals[piece] = accumulate_piece(
            design,
            values,
            structure,
            damping,
            piece,
            matrices[piece],
            gradients[piece],
            kept,
            singular,
            scratch(),
            np.zeros((3, 3)),
            np.zeros(3),
            np.zeros((3, 6)),
            np.zeros((3, max(structure.lens, 1))),
        )


@compiled
def evaluate_piece(
    design: Design, values: Values, piece: int, room: Scratch, residuals: Floats, depth: Floats
) -> None:
    """Residuals of one thread's points, see `evaluate`."""
    for j in range(design.pieces[piece], design.pieces[piece + 1]):
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            residuals[r, 0], residuals[r, 1] = ray_rows(design, values, r, design.ray_image[r], j, room)
            depth[r] = room.depth[0]


@compiled_parallel
def evaluate(design: Design, values: Values, residuals: Floats, depth: Floats) -> None:
    """Residuals of all rays.

    Parameters
    ----------
    design, values
        As in `accumulate`.
    residuals : ndarray, shape (rays, 2)
        Receives computed minus measured.
    depth : ndarray, shape (rays,)
        Receives how far each point lies in front of the camera, m.
    """
    for piece in numba.prange(len(design.pieces) - 1):
        evaluate_piece(design, values, piece, scratch(), residuals, depth)


@compiled
def back_substitute_piece(
    design: Design, structure: Structure, step: Floats, kept: Eliminated, piece: int, points: Floats
) -> float:
    """Move one thread's points; returns g'V^-1 g, see `back_substitute`."""
    decrease, band = 0.0, structure.band
    for j in range(design.pieces[piece], design.pieces[piece + 1]):
        g0, g1, g2 = kept.gradient[j, 0], kept.gradient[j, 1], kept.gradient[j, 2]
        c0, c1, c2 = g0, g1, g2
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            column = design.image_column[design.ray_image[r]]
            for b in range(6):
                c0 += kept.mixed[r, 0, b] * step[column + b]
                c1 += kept.mixed[r, 1, b] * step[column + b]
                c2 += kept.mixed[r, 2, b] * step[column + b]
        for s in range(structure.lens):
            c0 += kept.mixed_border[j, 0, s] * step[band + s]
            c1 += kept.mixed_border[j, 1, s] * step[band + s]
            c2 += kept.mixed_border[j, 2, s] * step[band + s]
        for a in range(3):
            q0, q1, q2 = kept.inverse[j, a, 0], kept.inverse[j, a, 1], kept.inverse[j, a, 2]
            points[j, a] -= q0 * c0 + q1 * c1 + q2 * c2
            decrease += kept.gradient[j, a] * (q0 * g0 + q1 * g1 + q2 * g2)
    return decrease


@compiled_parallel
def back_substitute(
    design: Design, structure: Structure, step: Floats, kept: Eliminated, points: Floats, decreases: Floats
) -> None:
    """Move the points by the steps that belong to a step of the reduced system.

    Parameters
    ----------
    design, structure
        As in `accumulate`.
    step : ndarray, shape (n,)
        Step of the reduced system.
    kept : Eliminated
        From `accumulate`.
    points : ndarray, shape (points, 3)
        Moved in place.
    decreases : ndarray, shape (threads,)
        Receive g'V^-1 g of the points, their part of the Newton decrement.
    """
    for piece in numba.prange(len(design.pieces) - 1):
        decreases[piece] = back_substitute_piece(design, structure, step, kept, piece, points)


@compiled
def reduce_right(
    design: Design, structure: Structure, right: Floats, kept: Eliminated, reduced: Floats
) -> None:
    """Eliminate the points from a right-hand side.

    Parameters
    ----------
    design, structure
        As in `accumulate`.
    right : ndarray, shape (points, 3)
        Right-hand side at the points.
    kept : Eliminated
        From `accumulate`.
    reduced : ndarray, shape (n,)
        Its part of the reduced system; less W V^-1 of the points' part afterwards.
    """
    band = structure.band
    for j in range(len(design.ray_start) - 1):
        b0, b1, b2 = right[j, 0], right[j, 1], right[j, 2]
        for a in range(3):
            x = kept.inverse[j, a, 0] * b0 + kept.inverse[j, a, 1] * b1 + kept.inverse[j, a, 2] * b2
            if x == 0.0:
                continue
            for r in range(design.ray_start[j], design.ray_start[j + 1]):
                column = design.image_column[design.ray_image[r]]
                for b in range(6):
                    reduced[column + b] -= kept.mixed[r, a, b] * x
            for s in range(structure.lens):
                reduced[band + s] -= kept.mixed_border[j, a, s] * x


@compiled
def most_rays(design: Design, piece: int) -> int:
    """Largest number of rays of a point among one thread's points, at least 1."""
    most = 1
    for j in range(design.pieces[piece], design.pieces[piece + 1]):
        most = max(most, design.ray_start[j + 1] - design.ray_start[j])
    return most


@inlined
def gather(design: Design, structure: Structure, j: int, inverse: Floats, local: Floats) -> int:
    """Copy the covariance among all that a point's rays touch; returns its size."""
    panel, border, width = structure.panel, structure.border, structure.width
    # Only a point that stays among the unknowns has columns behind those of the cameras.
    reach = border if design.point_column[j] >= 0 else structure.lens
    begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
    edge = 6 * n
    for r in range(n):
        column = design.image_column[design.ray_image[begin + r]]
        home = column // panel
        top = home * panel
        step = width[home]
        start = structure.offset[home] + column - top
        for t in range(n):
            other = design.image_column[design.ray_image[begin + t]]
            if other < column:
                continue
            corner = start + (other - top) * step
            for a in range(6):
                for b in range(6):
                    z = inverse[corner + a * step + b]
                    local[6 * t + a, 6 * r + b] = z
                    local[6 * r + b, 6 * t + a] = z
        foot = start + (structure.last[home] - top) * step
        for s in range(reach):
            for b in range(6):
                z = inverse[foot + s * step + b]
                local[edge + s, 6 * r + b] = z
                local[6 * r + b, edge + s] = z
    own = structure.offset[len(width) - 1]
    for s in range(reach):
        for t in range(s + 1):
            local[edge + s, edge + t] = inverse[own + s * border + t]
            local[edge + t, edge + s] = inverse[own + s * border + t]
    return int(edge + reach)


@compiled
def statistics_piece(
    design: Design,
    values: Values,
    structure: Structure,
    piece: int,
    inverse: Floats,
    kept: Eliminated,
    point_covariance: Floats,
    residuals: Floats,
    redundancy: Floats,
    room: Scratch,
    mixed: Floats,
    spread: Floats,
    local: Floats,
    row: Floats,
    cov: Floats,
) -> None:
    """Statistics of one thread's points, see `statistics`."""
    for j in range(design.pieces[piece], design.pieces[piece + 1]):
        begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
        edge = 6 * n
        m = gather(design, structure, j, inverse, local)
        # mixed = V^-1 W' and spread = V^-1 W' Q_uu: Q_pu = -spread, Q_pp = V^-1 + spread W V^-1.
        for a in range(3):
            q0, q1, q2 = kept.inverse[j, a, 0], kept.inverse[j, a, 1], kept.inverse[j, a, 2]
            for r in range(n):
                for b in range(6):
                    mixed[a, 6 * r + b] = (
                        q0 * kept.mixed[begin + r, 0, b]
                        + q1 * kept.mixed[begin + r, 1, b]
                        + q2 * kept.mixed[begin + r, 2, b]
                    )
            for s in range(edge, m):
                mixed[a, s] = 0.0
            for s in range(structure.lens):
                mixed[a, edge + s] = (
                    q0 * kept.mixed_border[j, 0, s]
                    + q1 * kept.mixed_border[j, 1, s]
                    + q2 * kept.mixed_border[j, 2, s]
                )
            for b in range(m):
                spread[a, b] = 0.0
        for c in range(m):
            m0, m1, m2 = mixed[0, c], mixed[1, c], mixed[2, c]
            for b in range(m):
                spread[0, b] += m0 * local[c, b]
                spread[1, b] += m1 * local[c, b]
                spread[2, b] += m2 * local[c, b]
        stays = design.point_column[j]
        for a in range(3):
            if stays >= 0:
                for b in range(m):
                    spread[a, b] = -local[edge + stays + a, b]
            for b in range(3):
                q = kept.inverse[j, a, b]
                for c in range(m):
                    q += spread[a, c] * mixed[b, c]
                if stays >= 0:
                    q = local[edge + stays + a, edge + stays + b]
                held = design.point_free[j, a] == 0.0 or design.point_free[j, b] == 0.0
                cov[a, b] = 0.0 if held else q
                point_covariance[j, a, b] = cov[a, b]
        for r in range(begin, begin + n):
            i = design.ray_image[r]
            k = design.image_camera[i]
            residuals[r, 0], residuals[r, 1] = ray_rows(design, values, r, i, j, room)
            at, first = edge + design.active_column[k], 6 * (r - begin)
            count = design.active_count[k]
            for a in range(2):
                b0, b1, b2 = room.by_point[a, 0], room.by_point[a, 1], room.by_point[a, 2]
                variance = 0.0
                for b in range(3):
                    variance += room.by_point[a, b] * (cov[b, 0] * b0 + cov[b, 1] * b1 + cov[b, 2] * b2)
                for s in range(count):
                    row[s] = room.by_camera[a, design.active[k, s]]
                for b in range(6):
                    part = -2.0 * (
                        spread[0, first + b] * b0 + spread[1, first + b] * b1 + spread[2, first + b] * b2
                    )
                    for c in range(6):
                        part += local[first + b, first + c] * room.by_pose[a, c]
                    for s in range(count):
                        part += 2.0 * local[first + b, at + s] * row[s]
                    variance += room.by_pose[a, b] * part
                for b in range(count):
                    part = -2.0 * (spread[0, at + b] * b0 + spread[1, at + b] * b1 + spread[2, at + b] * b2)
                    for s in range(count):
                        part += local[at + b, at + s] * row[s]
                    variance += row[b] * part
                redundancy[r, a] = 1.0 - design.weight[r, a] * variance


@compiled_parallel
def statistics(
    design: Design,
    values: Values,
    structure: Structure,
    inverse: Floats,
    kept: Eliminated,
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
    kept : Eliminated
        From `accumulate` at the adjusted values, without damping.
    point_covariance : ndarray, shape (points, 3, 3)
    residuals, redundancy : ndarray, shape (rays, 2)
        Receive the results. r = 1 - p a Q a' with a the row of the design matrix (Foerstner 1979).
    """
    for piece in numba.prange(len(design.pieces) - 1):
        size = 6 * most_rays(design, piece) + structure.border
        statistics_piece(
            design,
            values,
            structure,
            piece,
            inverse,
            kept,
            point_covariance,
            residuals,
            redundancy,
            scratch(),
            np.zeros((3, size)),
            np.zeros((3, size)),
            np.zeros((size, size)),
            np.zeros(size),
            np.zeros((3, 3)),
        )

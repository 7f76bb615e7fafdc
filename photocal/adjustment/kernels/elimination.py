"""Normal equations of the rays, the points eliminated as they pass."""

from __future__ import annotations

import numba
import numpy as np

from drivers.arrays import Flags, Floats
from photocal.adjustment.kernels.data import Design, Eliminated, Structure, Values, columns
from photocal.adjustment.kernels.ray import inverse3, ray_rows
from photocal.compiled import compiled, compiled_parallel, inlined
from photocal.geometry.lens import Scratch, scratch


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
    by_image, by_point, by_camera = room.by_image, room.by_point, room.by_camera
    panel, band, border, width = structure.panel, structure.band, structure.border, structure.width
    k = design.image_lens[i]
    px, py = design.weight[r, 0], design.weight[r, 1]
    column = design.image_column[i]
    home = column // panel
    top = home * panel
    step = width[home]
    corner = structure.offset[home] + (column - top) * step + column - top
    foot = structure.offset[home] + (structure.last[home] - top) * step + column - top
    for a in range(columns(design)):
        ax, ay = px * by_image[0, a], py * by_image[1, a]
        gradient[column + a] += ax * vx + ay * vy
        for b in range(a + 1):
            matrix[corner + a * step + b] += ax * by_image[0, b] + ay * by_image[1, b]
    for a in range(3):
        ax, ay = px * by_point[0, a], py * by_point[1, a]
        side[a] += ax * vx + ay * vy
        for b in range(3):
            block[a, b] += ax * by_point[0, b] + ay * by_point[1, b]
        for b in range(columns(design)):
            kept.mixed[r, a, b] = ax * by_image[0, b] + ay * by_image[1, b]
    at = design.active_column[k]
    own = structure.offset[len(width) - 1] + at * (border + 1)
    for s in range(design.active_count[k]):
        n = design.active[k, s]
        cx, cy = px * by_camera[0, n], py * by_camera[1, n]
        gradient[band + at + s] += cx * vx + cy * vy
        row = foot + (at + s) * step
        for b in range(columns(design)):
            matrix[row + b] += cx * by_image[0, b] + cy * by_image[1, b]
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
            for b in range(columns(design)):
                scaled[a, b] = (
                    inverse[j, a, 0] * mixed[r, 0, b]
                    + inverse[j, a, 1] * mixed[r, 1, b]
                    + inverse[j, a, 2] * mixed[r, 2, b]
                )
        for b in range(columns(design)):
            gradient[column + b] -= scaled[0, b] * g0 + scaled[1, b] * g1 + scaled[2, b] * g2
        home = column // panel
        top = home * panel
        step = width[home]
        foot = structure.offset[home] + (structure.last[home] - top) * step + column - top
        for s in range(lens):
            m0, m1, m2 = mixed_border[j, 0, s], mixed_border[j, 1, s], mixed_border[j, 2, s]
            row = foot + s * step
            for b in range(columns(design)):
                matrix[row + b] -= m0 * scaled[0, b] + m1 * scaled[1, b] + m2 * scaled[2, b]
        start = structure.offset[home] + column - top
        for t in range(begin, end):
            other = design.image_column[design.ray_image[t]]
            if other < column:
                continue
            corner = start + (other - top) * step
            for a in range(columns(design)):
                m0, m1, m2 = mixed[t, 0, a], mixed[t, 1, a], mixed[t, 2, a]
                row = corner + a * step
                for b in range(columns(design)):
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
            for b in range(columns(design)):
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
    singular: Flags,
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
    singular: Flags,
) -> None:
    """Normal equations of the rays and of the weighted points, reduced to images and border.

    damping: relative addition to the diagonal of each point's own block (Marquardt 1963).
    singular (points,): receives the points that their rays do not determine.
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
            scratch(columns(design)),
            np.zeros((3, 3)),
            np.zeros(3),
            np.zeros((3, columns(design))),
            np.zeros((3, max(structure.lens, 1))),
        )

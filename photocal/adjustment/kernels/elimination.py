"""Normal equations of the rays, the points eliminated as they pass."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Flags, Floats, Integers
from photocal.adjustment.kernels.data import Design, Eliminated, Structure, Values, columns, width
from photocal.adjustment.kernels.ray import inverse3, ray_rows
from photocal.compiled import compiled, each_piece, inlined
from photocal.geometry.lens import Scratch, scratch


class Place(NamedTuple):
    """Where a piece's values stand: the first of its strips, as if none were before it; its border."""

    base: int
    border: int


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
    place: Place,
    r: int,
    i: int,
    j: int,
    vx: float,
    vy: float,
    room: Scratch,
    lens: Floats,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
    block: Floats,
    side: Floats,
) -> None:
    """Add one ray to the normal equations of its exposure, camera and point."""
    by_image, by_point, by_camera = room.by_image, room.by_point, room.by_camera
    border, width = structure.border, columns(design)
    k = design.image_lens[i]
    px, py = design.weight[r, 0], design.weight[r, 1]
    column = design.image_column[i]
    corner = place.base + structure.offset[column // width]
    at, count = design.active_column[k], design.active_count[k]
    foot = corner + (structure.last[column // width] - column + at) * width
    for s in range(count):
        lens[0, s] = by_camera[0, design.active[k, s]]
        lens[1, s] = by_camera[1, design.active[k, s]]
    for a in range(width):
        ax, ay = px * by_image[0, a], py * by_image[1, a]
        gradient[column + a] += ax * vx + ay * vy
        for b in range(width):
            matrix[corner + a * width + b] += ax * by_image[0, b] + ay * by_image[1, b]
    for s in range(count):
        cx, cy = px * lens[0, s], py * lens[1, s]
        for b in range(width):
            matrix[foot + s * width + b] += cx * by_image[0, b] + cy * by_image[1, b]
    for a in range(3):
        ax, ay = px * by_point[0, a], py * by_point[1, a]
        side[a] += ax * vx + ay * vy
        for b in range(width):
            kept.mixed[r, a, b] = ax * by_image[0, b] + ay * by_image[1, b]
        for b in range(3):
            block[a, b] += ax * by_point[0, b] + ay * by_point[1, b]
        for s in range(count):
            kept.mixed_border[j, a, at + s] += ax * lens[0, s] + ay * lens[1, s]
    diagonal = place.border + at * (border + 1)
    for s in range(count):
        cx, cy = px * lens[0, s], py * lens[1, s]
        gradient[structure.band + at + s] += cx * vx + cy * vy
        for b in range(s + 1):
            matrix[diagonal + s * border + b] += cx * lens[0, b] + cy * lens[1, b]


@inlined
def eliminate(
    design: Design,
    structure: Structure,
    place: Place,
    j: int,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
    scaled: Floats,
    scaled_border: Floats,
) -> None:
    """Subtract what the point's own unknowns explain from the normal equations of what sees it."""
    border, lens, width = structure.border, structure.lens, columns(design)
    mixed, mixed_border, inverse, side = kept.mixed, kept.mixed_border[j], kept.inverse[j], kept.gradient
    begin, end = design.ray_start[j], design.ray_start[j + 1]
    g0, g1, g2 = side[j, 0], side[j, 1], side[j, 2]
    for a in range(3):
        for s in range(lens):
            scaled_border[a, s] = (
                inverse[a, 0] * mixed_border[0, s]
                + inverse[a, 1] * mixed_border[1, s]
                + inverse[a, 2] * mixed_border[2, s]
            )
    for s in range(lens):
        gradient[structure.band + s] -= (
            scaled_border[0, s] * g0 + scaled_border[1, s] * g1 + scaled_border[2, s] * g2
        )
        m0, m1, m2 = mixed_border[0, s], mixed_border[1, s], mixed_border[2, s]
        row = place.border + s * border
        for t in range(s + 1):
            matrix[row + t] -= m0 * scaled_border[0, t] + m1 * scaled_border[1, t] + m2 * scaled_border[2, t]
    for r in range(begin, end):
        column = design.image_column[design.ray_image[r]]
        corner = place.base + structure.offset[column // width]
        foot = corner + (structure.last[column // width] - column) * width
        for a in range(3):
            for b in range(width):
                scaled[a, b] = (
                    inverse[a, 0] * mixed[r, 0, b]
                    + inverse[a, 1] * mixed[r, 1, b]
                    + inverse[a, 2] * mixed[r, 2, b]
                )
        for b in range(width):
            gradient[column + b] -= scaled[0, b] * g0 + scaled[1, b] * g1 + scaled[2, b] * g2
        for s in range(lens):
            m0, m1, m2 = mixed_border[0, s], mixed_border[1, s], mixed_border[2, s]
            for b in range(width):
                matrix[foot + s * width + b] -= m0 * scaled[0, b] + m1 * scaled[1, b] + m2 * scaled[2, b]
        for t in range(begin, end):
            other = design.image_column[design.ray_image[t]]
            if other < column:
                continue
            for a in range(width):
                m0, m1, m2 = mixed[t, 0, a], mixed[t, 1, a], mixed[t, 2, a]
                row = corner + (other - column + a) * width
                for b in range(width):
                    matrix[row + b] -= m0 * scaled[0, b] + m1 * scaled[1, b] + m2 * scaled[2, b]


@inlined
def retain(
    design: Design,
    structure: Structure,
    place: Place,
    j: int,
    block: Floats,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
) -> None:
    """Add the normal equations of a point that stays among the unknowns of the border."""
    border, width = structure.border, columns(design)
    at = design.point_column[j]
    for a in range(3):
        row = place.border + (at + a) * border
        gradient[structure.band + at + a] += kept.gradient[j, a]
        for b in range(a + 1):
            matrix[row + at + b] += block[a, b]
        # The cameras' columns come before those of the points.
        for s in range(structure.lens):
            matrix[row + s] += kept.mixed_border[j, a, s]
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            column = design.image_column[design.ray_image[r]]
            corner = place.base + structure.offset[column // width]
            foot = corner + (structure.last[column // width] - column + at + a) * width
            for b in range(width):
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
    place: Place,
    matrix: Floats,
    gradient: Floats,
    kept: Eliminated,
    singular: Flags,
    room: Scratch,
    lens: Floats,
    block: Floats,
    side: Floats,
    scaled: Floats,
    scaled_border: Floats,
) -> float:
    """Normal equations of one piece's points; returns their v'Pv, infinite for a point behind a camera."""
    total = 0.0
    for nth in range(design.pieces[piece], design.pieces[piece + 1]):
        j = design.order[nth]
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
            add_ray(
                design, structure, place, r, i, j, vx, vy, room, lens, matrix, gradient, kept, block, side
            )
        for a in range(3):
            kept.gradient[j, a] = side[a]
        if design.point_column[j] >= 0:
            retain(design, structure, place, j, block, matrix, gradient, kept)
            singular[j] = False
            continue
        for a in range(3):
            block[a, a] *= 1.0 + damping
        singular[j] = not inverse3(block, kept.inverse, j)
        if not singular[j]:
            eliminate(design, structure, place, j, matrix, gradient, kept, scaled, scaled_border)
    return total


def accumulate(
    design: Design,
    values: Values,
    structure: Structure,
    damping: float,
    start: Integers,
    matrix: Floats,
    gradients: Floats,
    totals: Floats,
    kept: Eliminated,
    singular: Flags,
) -> None:
    """Normal equations of the rays and of the weighted points, reduced to images and border, piece by piece.

    damping: relative addition to the diagonal of each point's own block (Marquardt 1963).
    start (pieces + 1,): where each piece's strips begin in `matrix`; its border stands at their end.
    singular (points,): receives the points that their rays do not determine.
    """

    def work(piece: int) -> None:
        totals[piece] = accumulate_piece(
            design,
            values,
            structure,
            damping,
            piece,
            Place(
                start[piece] - structure.offset[design.reach[piece, 0]],
                start[piece + 1] - structure.border**2,
            ),
            matrix,
            gradients[piece],
            kept,
            singular,
            scratch(width(design)),
            np.zeros((2, max(structure.lens, 1))),
            np.zeros((3, 3)),
            np.zeros(3),
            np.zeros((3, width(design))),
            np.zeros((3, max(structure.lens, 1))),
        )

    each_piece(len(totals), work)


@compiled
def join_strips(
    design: Design,
    strips: Structure,
    structure: Structure,
    start: Integers,
    pieces: Floats,
    begin: int,
    end: int,
    matrix: Floats,
) -> None:
    """Add what the pieces have given to the columns of some images, see `join`."""
    wide, border = columns(design), structure.border
    for strip in range(begin, end):
        column, rows = strip * wide, strips.last[strip] - strip * wide
        home = column // structure.panel
        top, step = home * structure.panel, structure.width[home]
        corner = structure.offset[home] + (column - top) * step + column - top
        foot = structure.offset[home] + (structure.last[home] - top) * step + column - top
        for piece in range(len(design.reach)):
            if strip < design.reach[piece, 0] or strip >= design.reach[piece, 1]:
                continue
            at = start[piece] - strips.offset[design.reach[piece, 0]] + strips.offset[strip]
            for row in range(rows + border):
                to = corner + row * step if row < rows else foot + (row - rows) * step
                for b in range(wide):
                    matrix[to + b] += pieces[at + row * wide + b]


def join(
    design: Design, strips: Structure, structure: Structure, start: Integers, pieces: Floats, matrix: Floats
) -> None:
    """Add what the pieces have given, in their order, to the reduced matrix.

    strips: structure of the pieces' values: a panel for each image.
    """
    shares = np.linspace(0, len(strips.last), len(design.pieces)).astype(np.int64)

    def work(share: int) -> None:
        join_strips(design, strips, structure, start, pieces, shares[share], shares[share + 1], matrix)

    each_piece(len(shares) - 1, work)

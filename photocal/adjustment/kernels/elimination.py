"""Normal equations of the rays, the points eliminated as they pass."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from photocal.adjustment.kernels.data import Design, Eliminated, Structure, Values, columns, width
from photocal.adjustment.kernels.ray import corner_of, inverse3, ray_rows
from photocal.base.arrays import Floats, Integers
from photocal.base.compiled import apart, compiled, each_piece, fetch, inlined
from photocal.geometry.lens import Scratch, scratch

# So many points before they are worked on, their places in memory are asked for.
AHEAD = 2


class Contribution(NamedTuple):
    """What the points of one piece give to the reduced normal equations.

    strips (rows, columns of an image), base: to the images, from this row less the piece's first offset on.
        Rows of known length and arrays that lie apart let the compiler use the processor's vectors.
    corner (border, border): to the border.
    images (images, columns of an image), cameras (border,): to A'Pv.
    """

    base: int
    strips: Floats
    corner: Floats
    images: Floats
    cameras: Floats


class Rows(NamedTuple):
    """Rows of the design matrix that belong to one point's rays, in units of their sigmas, and room for more.

    ray: derivatives of one ray.
    block (3, 3): normal equations of the point itself.
    image, point (rays, 2, n): columns of each ray's own image and of the point.
    lens (rays, 2, lens + 1): columns of the cameras; the last one is the residual.
    less, free (3 and 2, lens + 1): by how much the point follows each of these columns, and what of them one
        ray's rows then have left.
    scaled (2, 3), other (2, columns of an image): one ray's rows of the point and of the image, transformed.
    """

    ray: Scratch
    block: Floats
    image: Floats
    point: Floats
    lens: Floats
    less: Floats
    free: Floats
    scaled: Floats
    other: Floats


def most_rays(design: Design) -> int:
    """Largest number of rays of a point, at least 1."""
    return int(np.max(np.diff(design.ray_start), initial=1))


@inlined
def fetch_point(design: Design, values: Values, kept: Eliminated, j: int) -> None:
    """Ask the memory for what a point's work takes: it lies far from that of the point before."""
    begin, end = design.ray_start[j], design.ray_start[j + 1]
    fetch(values.points, 3 * j)
    fetch(design.point_free, 3 * j)
    fetch(design.prior_points, 3 * j)
    fetch(kept.gradient, 3 * j)
    for line in range(0, 16, 8):
        fetch(design.prior_weight, 9 * j + line)
        fetch(kept.inverse, 9 * j + line)
    for r in range(begin, end, 4):
        fetch(design.plane, 2 * r)
        fetch(design.weight, 2 * r)
        fetch(design.ray_image, r)
    for line in range(3 * columns(design) * begin, 3 * columns(design) * end, 8):
        fetch(kept.mixed, line)
    size = kept.mixed_border.shape[1] * kept.mixed_border.shape[2]
    for line in range(size * j, size * (j + 1), 8):
        fetch(kept.mixed_border, line)


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
    j: int,
    residual: tuple[float, float],
    rows: Rows,
    kept: Eliminated,
) -> None:
    """Add one ray to the normal equations of its point, and put its rows among those of the point."""
    room, block = rows.ray, rows.block
    i, n, lens = design.ray_image[r], r - design.ray_start[j], structure.lens
    k = design.image_lens[i]
    at = design.active_column[k]
    for x in range(2):
        root = np.sqrt(design.weight[r, x])
        for b in range(columns(design)):
            rows.image[n, x, b] = root * room.by_image[x, b]
        for b in range(3):
            rows.point[n, x, b] = root * room.by_point[x, b]
        for s in range(lens):
            rows.lens[n, x, s] = 0.0
        for s in range(design.active_count[k]):
            rows.lens[n, x, at + s] = root * room.by_camera[x, design.active[k, s]]
        rows.lens[n, x, lens] = root * (residual[1] if x else residual[0])
    for a in range(3):
        px, py = rows.point[n, 0, a], rows.point[n, 1, a]
        kept.gradient[j, a] += px * rows.lens[n, 0, lens] + py * rows.lens[n, 1, lens]
        for b in range(3):
            block[a, b] += px * rows.point[n, 0, b] + py * rows.point[n, 1, b]
        for b in range(columns(design)):
            kept.mixed[r, a, b] = px * rows.image[n, 0, b] + py * rows.image[n, 1, b]
        for s in range(lens):
            kept.mixed_border[j, a, s] += px * rows.lens[n, 0, s] + py * rows.lens[n, 1, s]


@inlined
def eliminate(
    design: Design, structure: Structure, j: int, sums: Contribution, kept: Eliminated, rows: Rows
) -> None:
    """Add a point's rays to the normal equations of what sees it, less what its own unknowns explain.

    With B, A, C the columns of the point, the images and the cameras with the residual, and V the point's own
    normal equations: (A, C)' (C - B V^-1 B' C) and A' (1 - B V^-1 B') A. Where V^-1 is zero, all of it.
    """
    strips, corner, images, cameras = sums.strips, sums.corner, sums.images, sums.cameras
    lens, width, image, point, free = structure.lens, columns(design), rows.image, rows.point, rows.free
    begin, end = design.ray_start[j], design.ray_start[j + 1]
    mixed, inverse, less, scaled, other = kept.mixed_border, kept.inverse, rows.less, rows.scaled, rows.other
    for a in range(3):
        i0, i1, i2 = inverse[j, a, 0], inverse[j, a, 1], inverse[j, a, 2]
        for s in range(lens):
            less[a, s] = i0 * mixed[j, 0, s] + i1 * mixed[j, 1, s] + i2 * mixed[j, 2, s]
        less[a, lens] = i0 * kept.gradient[j, 0] + i1 * kept.gradient[j, 1] + i2 * kept.gradient[j, 2]
    for n in range(end - begin):
        i = design.ray_image[begin + n]
        k, column = design.image_lens[i], design.image_column[i]
        for x in range(2):
            p0, p1, p2 = point[n, x, 0], point[n, x, 1], point[n, x, 2]
            for s in range(lens + 1):
                free[x, s] = rows.lens[n, x, s] - (p0 * less[0, s] + p1 * less[1, s] + p2 * less[2, s])
            for a in range(3):
                scaled[x, a] = inverse[j, a, 0] * p0 + inverse[j, a, 1] * p1 + inverse[j, a, 2] * p2
        at, count = design.active_column[k], design.active_count[k]
        for s in range(at, at + count):
            cx, cy = rows.lens[n, 0, s], rows.lens[n, 1, s]
            cameras[s] += cx * free[0, lens] + cy * free[1, lens]
            for t in range(at + count):
                corner[s, t] += cx * free[0, t] + cy * free[1, t]
        strip = column // width
        top = sums.base + structure.offset[strip]
        foot = top + structure.last[strip] - column
        for b in range(width):
            images[strip, b] += image[n, 0, b] * free[0, lens] + image[n, 1, b] * free[1, lens]
        for s in range(lens):
            for b in range(width):
                strips[foot + s, b] += free[0, s] * image[n, 0, b] + free[1, s] * image[n, 1, b]
        for m in range(end - begin):
            below = design.image_column[design.ray_image[begin + m]] - column
            if below < 0:
                continue
            for x in range(2):
                s0, s1, s2 = scaled[x, 0], scaled[x, 1], scaled[x, 2]
                gx = -(point[m, 0, 0] * s0 + point[m, 0, 1] * s1 + point[m, 0, 2] * s2)
                gy = -(point[m, 1, 0] * s0 + point[m, 1, 1] * s1 + point[m, 1, 2] * s2)
                if m == n and x == 0:
                    gx += 1.0
                elif m == n:
                    gy += 1.0
                for a in range(width):
                    other[x, a] = gx * image[m, 0, a] + gy * image[m, 1, a]
            for a in range(width):
                for b in range(width):
                    strips[top + below + a, b] += other[0, a] * image[n, 0, b] + other[1, a] * image[n, 1, b]


@inlined
def retain(
    design: Design, structure: Structure, j: int, block: Floats, sums: Contribution, kept: Eliminated
) -> None:
    """Add the normal equations of a point that stays among the unknowns of the border."""
    strips, corner, cameras = sums.strips, sums.corner, sums.cameras
    width, at = columns(design), design.point_column[j]
    for a in range(3):
        cameras[at + a] += kept.gradient[j, a]
        for b in range(a + 1):
            corner[at + a, at + b] += block[a, b]
        # The cameras' columns come before those of the points.
        for s in range(structure.lens):
            corner[at + a, s] += kept.mixed_border[j, a, s]
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            column = design.image_column[design.ray_image[r]]
            foot = sums.base + structure.offset[column // width] + structure.last[column // width] - column
            for b in range(width):
                strips[foot + at + a, b] += kept.mixed[r, a, b]
        for b in range(3):
            kept.inverse[j, a, b] = 0.0


@apart
def accumulate_piece(
    design: Design,
    values: Values,
    structure: Structure,
    damping: float,
    piece: int,
    sums: Contribution,
    kept: Eliminated,
    rows: Rows,
) -> float:
    """Normal equations of one piece's points; returns their v'Pv, infinite for a point behind a camera."""
    total, end, block = 0.0, design.pieces[piece + 1], rows.block
    for nth in range(design.pieces[piece], end):
        j = design.order[nth]
        fetch_point(design, values, kept, design.order[min(nth + AHEAD, end - 1)])
        total += own_block(design, values, j, block, kept.gradient[j])
        for a in range(3):
            for s in range(structure.lens):
                kept.mixed_border[j, a, s] = 0.0
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            vx, vy = ray_rows(design, values, r, design.ray_image[r], j, rows.ray)
            total += design.weight[r, 0] * vx * vx + design.weight[r, 1] * vy * vy
            if not rows.ray.depth[0] > 0.0:
                total = np.inf
            add_ray(design, structure, r, j, (vx, vy), rows, kept)
        kept.singular[j] = False
        if design.point_column[j] >= 0:
            retain(design, structure, j, block, sums, kept)
        else:
            for a in range(3):
                block[a, a] *= 1.0 + damping
            kept.singular[j] = not inverse3(block, kept.inverse, j)
        eliminate(design, structure, j, sums, kept, rows)
    return total


def accumulate(
    design: Design,
    values: Values,
    structure: Structure,
    damping: float,
    parts: Sequence[Contribution],
    kept: Eliminated,
) -> float:
    """Normal equations of the rays and of the weighted points, reduced to images and border; returns v'Pv.

    damping: relative addition to the diagonal of each point's own block (Marquardt 1963).
    parts: receive what each piece gives.
    """
    totals = np.zeros(len(parts))
    rays, lens, wide = most_rays(design), structure.lens + 1, width(design)

    def work(piece: int) -> None:
        """One piece of the rays, or one share of the strips: they run side by side."""
        shapes = (rays, 2, wide), (rays, 2, 3), (rays, 2, lens), (3, lens), (2, lens), (2, 3), (2, wide)
        rows = Rows(scratch(wide), np.zeros((3, 3)), *map(np.zeros, shapes))
        totals[piece] = accumulate_piece(design, values, structure, damping, piece, parts[piece], kept, rows)

    each_piece(len(parts), work)
    return float(totals.sum())


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
        corner, foot, step = corner_of(structure, column)
        for piece in range(len(design.reach)):
            if strip < design.reach[piece, 0] or strip >= design.reach[piece, 1]:
                continue
            at = start[piece] - strips.offset[design.reach[piece, 0]] + strips.offset[strip]
            for row in range(rows + border):
                to = corner + row * step if row < rows else foot + (row - rows) * step
                for b in range(wide):
                    matrix[to + b] += pieces[at + row, b]


def join(
    design: Design, strips: Structure, structure: Structure, start: Integers, pieces: Floats, matrix: Floats
) -> None:
    """Add what the pieces have given, in their order, to the reduced matrix.

    strips: structure of the pieces' values: a panel for each image.
    """
    shares = np.linspace(0, len(strips.last), len(design.pieces)).astype(np.int64)

    def work(share: int) -> None:
        """One piece of the rays, or one share of the strips: they run side by side."""
        join_strips(design, strips, structure, start, pieces, shares[share], shares[share + 1], matrix)

    each_piece(len(shares) - 1, work)

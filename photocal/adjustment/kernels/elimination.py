"""Normal equations of the rays, the points eliminated as they pass."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from photocal.adjustment.kernels.data import Design, Eliminated, Reduced, Structure, Values, columns, width
from photocal.adjustment.kernels.lanes import LANES, filled, load, none, padded, plus, store
from photocal.adjustment.kernels.ray import corner_of, inverse3, ray_rows
from photocal.base.arrays import Floats, Integers
from photocal.base.compiled import compiled, each_piece, fetch, inlined
from photocal.geometry.lens import Scratch, scratch

# So many points before they are worked on, their places in memory are asked for.
AHEAD = 2


class Contribution(NamedTuple):
    """What the points of one piece give to the reduced normal equations, A'Pv as a first row and column.

    base, strips (rows, columns of an image): to the images, from this row less the piece's first offset on.
    corner (1 + border, 1 + border): to the border, below the diagonal.
    """

    base: int
    strips: Floats
    corner: Floats


class Rows(NamedTuple):
    """Rows of the design matrix that belong to one point's rays, in units of their sigmas, and room for more.

    ray: derivatives of one ray.
    block (3, 3): normal equations of the point itself.
    point (rays, 2, 3): columns of the point.
    image (rays, 2, n): those of each ray's own image, in whole lanes, as all that follows.
    lens (rays, 2, 1 + lens): the residual, then the columns of the cameras.
    mixed, less (3, 1 + lens): normal matrix between the point and these; by how much it follows them.
    free (2, 1 + lens): what of one ray's rows is then left.
    near (3, n): normal matrix between the point and one ray's image.
    """

    ray: Scratch
    block: Floats
    point: Floats
    image: Floats
    lens: Floats
    mixed: Floats
    less: Floats
    free: Floats
    near: Floats


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
    fetch(design.point_column, j)
    fetch(kept.singular, j)
    fetch(kept.gradient, 3 * j)
    for line in range(0, 16, 8):
        fetch(design.prior_weight, 9 * j + line)
        fetch(kept.inverse, 9 * j + line)
    for r in range(begin, end + 3, 4):
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
def put_ray(
    design: Design, structure: Structure, r: int, n: int, residual: tuple[float, float], rows: Rows
) -> None:
    """Put the rows of a ray, whose derivatives are in the room, as the nth among those of its point."""
    room, image, point, lens = rows.ray, rows.image, rows.point, rows.lens
    k, span = design.image_lens[design.ray_image[r]], lens.shape[2]
    for x in range(2):
        root = np.sqrt(design.weight[r, x])
        for b in range(columns(design)):
            image[n, x, b] = root * room.by_image[x, b]
        for b in range(3):
            point[n, x, b] = root * room.by_point[x, b]
        for q in range(0, 1 + structure.lens, LANES):
            store(lens, span * (2 * n + x) + q, none())
        lens[n, x, 0] = root * residual[x]
        for s in range(design.active_count[k]):
            lens[n, x, 1 + design.active_column[k] + s] = root * room.by_camera[x, design.active[k, s]]


@inlined
def across(total: Any, point: Floats, n: int, a: int, x: Any, y: Any) -> Any:
    """Add what relates a coordinate of the point to columns whose two rows of its nth ray are given."""
    return plus(plus(total, point[n, 0, a], x), point[n, 1, a], y)


@inlined
def along(total: Any, sign: float, matrix: Floats, n: int, a: int, u: Any, v: Any, w: Any) -> Any:
    """Add or subtract rows u, v, w, each times its element in row a of the nth matrix."""
    total = plus(plus(total, sign * matrix[n, a, 0], u), sign * matrix[n, a, 1], v)
    return plus(total, sign * matrix[n, a, 2], w)


@inlined
def relate(structure: Structure, j: int, count: int, rows: Rows, kept: Eliminated) -> None:
    """Add up the normal equations of a point of so many rays, and what relates it to the cameras."""
    block, point, lens, mixed = rows.block, rows.point, rows.lens, rows.mixed
    span = mixed.shape[1]
    for n in range(count):
        for a in range(3):
            for b in range(a + 1):
                block[a, b] += point[n, 0, a] * point[n, 0, b] + point[n, 1, a] * point[n, 1, b]
    for q in range(0, 1 + structure.lens, LANES):
        u, v, w = none(), none(), none()
        for n in range(count):
            x, y = load(lens, span * 2 * n + q), load(lens, span * (2 * n + 1) + q)
            u, v, w = across(u, point, n, 0, x, y), across(v, point, n, 1, x, y), across(w, point, n, 2, x, y)
        store(mixed, q, u)
        store(mixed, span + q, v)
        store(mixed, 2 * span + q, w)
    for a in range(3):
        mixed[a, 0] += kept.gradient[j, a]
        kept.gradient[j, a] = mixed[a, 0]
        for s in range(structure.lens):
            kept.mixed_border[j, a, s] = mixed[a, 1 + s]


@inlined
def eliminate(
    design: Design, structure: Structure, j: int, sums: Contribution, kept: Eliminated, rows: Rows
) -> None:
    """Add a point's rays to the normal equations of what sees it, less what its own unknowns explain.

    With B, A, C the columns of the point, the images and the cameras with the residual, and V the point's own
    normal equations: (A, C)' (C - B V^-1 B' C) and A' (1 - B V^-1 B') A. Where V^-1 is zero, all of it.
    """
    (base, strips, corner), inverse = sums, kept.inverse
    _, _, point, image, lens, mixed, less, free, near = rows
    wide, tall, span, edge = columns(design), filled(columns(design)), mixed.shape[1], corner.shape[1]
    begin, count = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
    for q in range(0, 1 + structure.lens, LANES):
        u, v, w = load(mixed, q), load(mixed, span + q), load(mixed, 2 * span + q)
        for a in range(3):
            store(less, span * a + q, along(none(), -1.0, inverse, j, a, u, v, w))
    for n in range(count):
        i = design.ray_image[begin + n]
        k, column = design.image_lens[i], design.image_column[i]
        for q in range(0, 1 + structure.lens, LANES):
            u, v, w = load(less, q), load(less, span + q), load(less, 2 * span + q)
            for x in range(2):
                part = load(lens, span * (2 * n + x) + q)
                store(free, span * x + q, along(part, 1.0, point, n, x, u, v, w))
        first = 1 + design.active_column[k]
        last = first + design.active_count[k]
        for q in range(0, last, LANES):
            x, y = load(free, q), load(free, span + q)
            for s in range(max(first, q), last):
                part = plus(load(corner, edge * s + q), lens[n, 0, s], x)
                store(corner, edge * s + q, plus(part, lens[n, 1, s], y))
        strip = column // wide
        top = tall * (base + structure.offset[strip])
        foot = top + tall * (structure.last[strip] - column)
        for q in range(0, tall, LANES):
            x, y = load(image, tall * 2 * n + q), load(image, tall * (2 * n + 1) + q)
            for s in range(1 + structure.lens):
                part = plus(load(strips, foot + tall * s + q), free[0, s], x)
                store(strips, foot + tall * s + q, plus(part, free[1, s], y))
            u, v, w = none(), none(), none()
            u, v, w = across(u, point, n, 0, x, y), across(v, point, n, 1, x, y), across(w, point, n, 2, x, y)
            store(near, q, u)
            store(near, tall + q, v)
            store(near, 2 * tall + q, w)
            a = along(none(), -1.0, inverse, j, 0, u, v, w)
            b = along(none(), -1.0, inverse, j, 1, u, v, w)
            c = along(none(), -1.0, inverse, j, 2, u, v, w)
            for m in range(count):
                to = top + tall * (design.image_column[design.ray_image[begin + m]] - column) + q
                if to < top:
                    continue
                own = 1.0 if m == n else 0.0
                of_x = along(plus(none(), own, x), 1.0, point, m, 0, a, b, c)
                of_y = along(plus(none(), own, y), 1.0, point, m, 1, a, b, c)
                for s in range(wide):
                    part = plus(load(strips, to + tall * s), image[m, 0, s], of_x)
                    store(strips, to + tall * s, plus(part, image[m, 1, s], of_y))
        for s in range(wide):
            for x in range(3):
                kept.mixed[begin + n, x, s] = near[x, s]


@inlined
def retain(
    design: Design, structure: Structure, j: int, block: Floats, sums: Contribution, kept: Eliminated
) -> None:
    """Add the normal equations of a point that stays among the unknowns of the border."""
    base, strips, corner = sums
    width, at = columns(design), 1 + design.point_column[j]
    for a in range(3):
        corner[at + a, 0] += kept.gradient[j, a]
        for b in range(a + 1):
            corner[at + a, at + b] += block[a, b]
        # The cameras' columns come before those of the points.
        for s in range(structure.lens):
            corner[at + a, 1 + s] += kept.mixed_border[j, a, s]
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            column = design.image_column[design.ray_image[r]]
            foot = base + structure.offset[column // width] + structure.last[column // width] - column
            for b in range(width):
                strips[foot + at + a, b] += kept.mixed[r, a, b]


@compiled
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
        fetch(design.ray_start, design.order[min(nth + 2 * AHEAD, end - 1)])
        fetch_point(design, values, kept, design.order[min(nth + AHEAD, end - 1)])
        total += own_block(design, values, j, block, kept.gradient[j])
        first = design.ray_start[j]
        for r in range(first, design.ray_start[j + 1]):
            vx, vy = ray_rows(design, values, r, design.ray_image[r], j, rows.ray)
            total += design.weight[r, 0] * vx * vx + design.weight[r, 1] * vy * vy
            if not rows.ray.depth[0] > 0.0:
                total = np.inf
            put_ray(design, structure, r, r - first, (vx, vy), rows)
        relate(structure, j, design.ray_start[j + 1] - first, rows, kept)
        stays = design.point_column[j] >= 0
        for a in range(3):
            block[a, a] *= 1.0 if stays else 1.0 + damping
            for b in range(3):
                kept.inverse[j, a, b] = 0.0
        kept.singular[j] = not stays and not inverse3(block, kept.inverse, j)
        eliminate(design, structure, j, sums, kept, rows)
        if stays:
            retain(design, structure, j, block, sums, kept)
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
    rays, lens, wide = most_rays(design), padded(1 + structure.lens), padded(width(design))

    def work(piece: int) -> None:
        """One piece of the rays, or one share of the strips: they run side by side."""
        shapes = [
            (3, 3),
            (rays, 2, 3),
            (rays, 2, wide),
            (rays, 2, lens),
            *[(3, lens)] * 2,
            (2, lens),
            (3, wide),
        ]
        rows = Rows(scratch(width(design)), *map(np.zeros, shapes))
        totals[piece] = accumulate_piece(design, values, structure, damping, piece, parts[piece], kept, rows)

    each_piece(len(parts), work)
    return float(totals.sum())


@compiled
def join_strips(
    design: Design, strips: Structure, reduced: Reduced, start: Integers, pieces: Floats, begin: int, end: int
) -> None:
    """Add what the pieces have given to the columns of some images, see `join`."""
    structure, matrix, gradient = reduced
    wide, border = columns(design), structure.border
    for strip in range(begin, end):
        column, rows = strip * wide, strips.last[strip] - strip * wide
        corner, foot, step = corner_of(structure, column)
        for piece in range(len(design.reach)):
            if strip < design.reach[piece, 0] or strip >= design.reach[piece, 1]:
                continue
            at = start[piece] - strips.offset[design.reach[piece, 0]] + strips.offset[strip]
            for row in range(rows):
                for b in range(wide):
                    matrix[corner + row * step + b] += pieces[at + row, b]
            at += rows
            for b in range(wide):
                gradient[column + b] += pieces[at, b]
                for row in range(border):
                    matrix[foot + row * step + b] += pieces[at + 1 + row, b]


def join(design: Design, strips: Structure, reduced: Reduced, start: Integers, pieces: Floats) -> None:
    """Add what the pieces have given to the images, in their order, to the reduced normal equations.

    strips: structure of the pieces' values: a panel for each image.
    """
    shares = np.linspace(0, len(strips.last), len(design.pieces)).astype(np.int64)

    def work(share: int) -> None:
        """One piece of the rays, or one share of the strips: they run side by side."""
        join_strips(design, strips, reduced, start, pieces, shares[share], shares[share + 1])

    each_piece(len(shares) - 1, work)

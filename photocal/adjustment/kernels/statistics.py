"""Covariance of the points and redundancy numbers of the rays."""

from typing import Any, NamedTuple

import numpy as np

from photocal.adjustment.kernels.data import Cofactors, Design, Values, columns, width
from photocal.adjustment.kernels.elimination import AHEAD, most_rays
from photocal.adjustment.kernels.lanes import (
    LANES,
    filled,
    load,
    none,
    padded,
    plus,
    plus_each,
    store,
    summed,
)
from photocal.adjustment.kernels.ray import corner_of, element_address, ray_rows
from photocal.base.arrays import Floats, Integers
from photocal.base.compiled import compiled, each_piece, fetch, inlined
from photocal.geometry.lens import Scratch, scratch

# So many images of points that follow each other: their covariance stays near the processor.
NEIGHBOURS = 40


class Neighbours(NamedTuple):
    """Covariance among the images that some points see, and the cameras: all of it, in whole lanes.

    place (images,): place of each image among the neighbours; -1 for all others.
    image (neighbours,): which they are; -1 where there is none.
    local (neighbours * columns of an image + lens, the same in whole lanes for each): rows and columns of the
        images, then those of the cameras.
    """

    place: Integers
    image: Integers
    local: Floats


class PointRows(NamedTuple):
    """What one point's rays see of the unknowns, in whole lanes for each image, then for the cameras.

    near: the images among which it is.
    ray: derivatives of one ray.
    place (rays,): of each ray's image among the neighbours.
    residual (rays, 2).
    rows (rays, 2, n): rows of the design matrix: the ray's own image, then the cameras.
    point (rays, 2, 3): the same of the point.
    mixed, spread (3, m): V^-1 W' and V^-1 W' Q_uu, with V and W' the normal equations of the point, and
        between it and the others; Q_pu = -spread.
    block (3, 3): covariance of the point, Q_pp = V^-1 + spread W V^-1.
    """

    near: Neighbours
    ray: Scratch
    place: Integers
    residual: Floats
    rows: Floats
    point: Floats
    mixed: Floats
    spread: Floats
    block: Floats


def room_of(design: Design, cofactors: Cofactors) -> PointRows:
    """Make room for neighbours and for any point and all that its rays touch."""
    images, rays, wide, lens = (
        len(design.image_column),
        most_rays(design),
        width(design),
        cofactors.structure.lens,
    )
    most, tall, border = max(min(NEIGHBOURS, images), rays), padded(wide), padded(lens)
    near = Neighbours(
        np.full(images, -1), np.full(most, -1), np.zeros((most * wide + lens, most * tall + border))
    )
    shapes = (rays, 2), (rays, 2, tall + border), (rays, 2, 3), *[(3, rays * tall + border)] * 2, (3, 3)
    return PointRows(near, scratch(wide), np.zeros(rays, dtype=np.int64), *map(np.zeros, shapes))


@inlined
def let_in(design: Design, nth: int, end: int, near: Neighbours) -> int:
    """Make the images of points from the nth on neighbours; returns the first point that finds no room."""
    place, image, _ = near
    for s in range(len(image)):
        if image[s] >= 0:
            place[image[s]] = image[s] = -1
    count = 0
    while nth < end:
        first, last = design.ray_start[design.order[nth]], design.ray_start[design.order[nth] + 1]
        if count + last - first > len(image):
            break
        for r in range(first, last):
            i = design.ray_image[r]
            if place[i] < 0:
                place[i], image[count] = count, i
                count += 1
        nth += 1
    return nth


@inlined
def gather(design: Design, cofactors: Cofactors, near: Neighbours) -> None:
    """Copy the covariance among the neighbours and the cameras."""
    (structure, inverse, _), (_, image, local) = cofactors, near
    wide, tall, most, lens = columns(design), filled(columns(design)), len(image), structure.lens
    for s in range(most):
        if image[s] < 0:
            break
        column = design.image_column[image[s]]
        corner, foot, step = corner_of(structure, column)
        last = structure.last[column // structure.panel]
        for t in range(most):
            other = design.image_column[image[t]] if image[t] >= 0 else last
            # Neighbours that no point sees together may have no element.
            if other < column or other >= last:
                continue
            start = corner + (other - column) * step
            for a in range(wide):
                for b in range(wide):
                    z = inverse[start + a * step + b]
                    local[wide * t + a, tall * s + b] = z
                    local[wide * s + b, tall * t + a] = z
        for c in range(lens):
            for b in range(wide):
                z = inverse[foot + c * step + b]
                local[wide * most + c, tall * s + b] = z
                local[wide * s + b, tall * most + c] = z
    base = structure.offset[len(structure.width) - 1]
    for s in range(lens):
        for t in range(s + 1):
            z = inverse[base + s * structure.border + t]
            local[wide * most + s, tall * most + t] = z
            local[wide * most + t, tall * most + s] = z


@inlined
def fetch_rays(design: Design, values: Values, cofactors: Cofactors, j: int) -> None:
    """Ask the memory for what a point's work takes."""
    begin, end = design.ray_start[j], design.ray_start[j + 1]
    fetch(values.points, 3 * j)
    fetch(design.point_free, 3 * j)
    fetch(cofactors.kept.inverse, 9 * j)
    fetch(cofactors.kept.inverse, 9 * j + 8)
    for r in range(begin, end, 4):
        fetch(design.plane, 2 * r)
        fetch(design.weight, 2 * r)
        fetch(design.ray_image, r)


@inlined
def put_rows(design: Design, values: Values, cofactors: Cofactors, j: int, room: PointRows) -> None:
    """Put the rows of a point's rays into the room, and V^-1 W' of them."""
    ray, rows, mixed, inverse = room.ray, room.rows, room.mixed, cofactors.kept.inverse
    wide, tall, lens = columns(design), filled(columns(design)), cofactors.structure.lens
    begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
    span, size, edge = rows.shape[2], mixed.shape[1], tall * n
    for q in range(0, lens, LANES):
        for a in range(3):
            store(mixed, size * a + edge + q, none())
    for r in range(n):
        i = design.ray_image[begin + r]
        k = design.image_lens[i]
        at, count = design.active_column[k], design.active_count[k]
        room.place[r] = room.near.place[i]
        room.residual[r, 0], room.residual[r, 1] = ray_rows(design, values, begin + r, i, j, ray)
        for x in range(2):
            for q in range(tall, tall + lens, LANES):
                store(rows, span * (2 * r + x) + q, none())
            for b in range(wide):
                rows[r, x, b] = ray.by_image[x, b]
            for c in range(count):
                rows[r, x, tall + at + c] = ray.by_camera[x, design.active[k, c]]
            for a in range(3):
                room.point[r, x, a] = ray.by_point[x, a]
        top = 2 * span * r
        for a in range(3):
            i0, i1, i2 = inverse[j, a, 0], inverse[j, a, 1], inverse[j, a, 2]
            b0, b1, b2 = ray.by_point[0, 0], ray.by_point[0, 1], ray.by_point[0, 2]
            x = design.weight[begin + r, 0] * (i0 * b0 + i1 * b1 + i2 * b2)
            b0, b1, b2 = ray.by_point[1, 0], ray.by_point[1, 1], ray.by_point[1, 2]
            y = design.weight[begin + r, 1] * (i0 * b0 + i1 * b1 + i2 * b2)
            for q in range(0, tall, LANES):
                part = plus(plus(none(), x, load(rows, top + q)), y, load(rows, top + span + q))
                store(mixed, size * a + tall * r + q, part)
            for q in range(at // LANES * LANES, at + count, LANES):
                part = load(mixed, size * a + edge + q)
                part = plus(part, x, load(rows, top + tall + q))
                store(mixed, size * a + edge + q, plus(part, y, load(rows, top + span + tall + q)))


@inlined
def put_spread(design: Design, cofactors: Cofactors, j: int, room: PointRows) -> None:
    """Put the covariance of a point, whose rows are in the room, and of it with the others into the room."""
    (structure, inverse, kept), (_, image, local), place = cofactors, room.near, room.place
    mixed, spread, block = room.mixed, room.spread, room.block
    wide, tall, lens, most = columns(design), filled(columns(design)), structure.lens, len(image)
    begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
    step, size, edge = local.shape[1], mixed.shape[1], tall * n
    for q in range(0, edge + lens, LANES):
        column = tall * place[q // tall] + q % tall if q < edge else tall * most + q - edge
        x, y, z = none(), none(), none()
        for r in range(n):
            at = step * wide * place[r] + column
            for b in range(wide):
                row = load(local, at + step * b)
                x = plus(x, mixed[0, tall * r + b], row)
                y = plus(y, mixed[1, tall * r + b], row)
                z = plus(z, mixed[2, tall * r + b], row)
        at = step * wide * most + column
        for c in range(lens):
            row = load(local, at + step * c)
            x = plus(x, mixed[0, edge + c], row)
            y = plus(y, mixed[1, edge + c], row)
            z = plus(z, mixed[2, edge + c], row)
        store(spread, q, x)
        store(spread, size + q, y)
        store(spread, 2 * size + q, z)
    for a in range(3):
        for b in range(a + 1):
            total = none()
            for q in range(0, edge + lens, LANES):
                total = plus_each(total, load(spread, size * a + q), load(mixed, size * b + q))
            block[a, b] = block[b, a] = kept.inverse[j, a, b] + summed(total)
    # A point that stays among the unknowns has its covariance in the inverse.
    own = structure.band + design.point_column[j]
    for a in range(3 if own >= structure.band else 0):
        for r in range(n):
            first = design.image_column[design.ray_image[begin + r]]
            for b in range(wide):
                spread[a, tall * r + b] = -inverse[element_address(structure, own + a, first + b)]
        for c in range(lens):
            spread[a, edge + c] = -inverse[element_address(structure, own + a, structure.band + c)]
        for b in range(a + 1):
            block[a, b] = block[b, a] = inverse[element_address(structure, own + a, own + b)]
    for a in range(3):
        if design.point_free[j, a] == 0.0:
            for b in range(3):
                block[a, b] = block[b, a] = 0.0


@inlined
def with_point(room: PointRows, r: int, x: int, q: int) -> Any:
    """Covariance of unknowns with the point's part of a coordinate of ray r."""
    spread, point = room.spread, room.point
    total = plus(none(), -point[r, x, 0], load(spread, q))
    total = plus(total, -point[r, x, 1], load(spread, spread.shape[1] + q))
    return plus(total, -point[r, x, 2], load(spread, 2 * spread.shape[1] + q))


@inlined
def variances(design: Design, r: int, n: int, room: PointRows) -> tuple[float, float]:
    """Variances a Q a' of both adjusted coordinates of the ray r of the n of a point."""
    rows, point, block, (_, image, local) = room.rows, room.point, room.block, room.near
    wide, tall, most, s = columns(design), filled(columns(design)), len(image), room.place[r]
    k = design.image_lens[image[s]]
    at, count = design.active_column[k], design.active_count[k]
    step, top, next_top = local.shape[1], rows.shape[2] * 2 * r, rows.shape[2] * (2 * r + 1)
    own, cameras = step * wide * s, step * (wide * most + at)
    x, y = none(), none()
    for q in range(0, tall, LANES):
        part_x, part_y = with_point(room, r, 0, tall * r + q), with_point(room, r, 1, tall * r + q)
        for c in range(count):
            row = load(local, cameras + step * c + tall * s + q)
            part_x = plus(part_x, rows[r, 0, tall + at + c], row)
            part_y = plus(part_y, rows[r, 1, tall + at + c], row)
        part_x, part_y = plus(none(), 2.0, part_x), plus(none(), 2.0, part_y)
        for b in range(wide):
            row = load(local, own + step * b + tall * s + q)
            part_x = plus(part_x, rows[r, 0, b], row)
            part_y = plus(part_y, rows[r, 1, b], row)
        x = plus_each(x, part_x, load(rows, top + q))
        y = plus_each(y, part_y, load(rows, next_top + q))
    for q in range(at // LANES * LANES, at + count, LANES):
        part_x = plus(none(), 2.0, with_point(room, r, 0, tall * n + q))
        part_y = plus(none(), 2.0, with_point(room, r, 1, tall * n + q))
        for c in range(count):
            row = load(local, cameras + step * c + tall * most + q)
            part_x = plus(part_x, rows[r, 0, tall + at + c], row)
            part_y = plus(part_y, rows[r, 1, tall + at + c], row)
        x = plus_each(x, part_x, load(rows, top + tall + q))
        y = plus_each(y, part_y, load(rows, next_top + tall + q))
    of_x, of_y = summed(x), summed(y)
    for a in range(3):
        for b in range(3):
            of_x += point[r, 0, a] * block[a, b] * point[r, 0, b]
            of_y += point[r, 1, a] * block[a, b] * point[r, 1, b]
    return of_x, of_y


@compiled
def statistics_piece(
    design: Design,
    values: Values,
    cofactors: Cofactors,
    piece: int,
    point_covariance: Floats,
    residuals: Floats,
    redundancy: Floats,
    room: PointRows,
) -> None:
    """Statistics of one piece's points, see `statistics`."""
    begin, end = design.pieces[piece], design.pieces[piece + 1]
    while begin < end:
        stop = let_in(design, begin, end, room.near)
        gather(design, cofactors, room.near)
        for nth in range(begin, stop):
            j = design.order[nth]
            fetch_rays(design, values, cofactors, design.order[min(nth + AHEAD, end - 1)])
            put_rows(design, values, cofactors, j, room)
            put_spread(design, cofactors, j, room)
            for a in range(3):
                for b in range(3):
                    point_covariance[j, a, b] = room.block[a, b]
            first, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
            for r in range(n):
                of_x, of_y = variances(design, r, n, room)
                redundancy[first + r, 0] = 1.0 - design.weight[first + r, 0] * of_x
                redundancy[first + r, 1] = 1.0 - design.weight[first + r, 1] * of_y
                residuals[first + r, 0], residuals[first + r, 1] = room.residual[r, 0], room.residual[r, 1]
        begin = stop


def statistics(
    design: Design,
    values: Values,
    cofactors: Cofactors,
    point_covariance: Floats,
    residuals: Floats,
    redundancy: Floats,
) -> None:
    """Covariance of each point, and residual and redundancy number of each image coordinate.

    point_covariance (points, 3, 3).
    residuals, redundancy (rays, 2): receive the results. r = 1 - p a Q a' with a the row of the design matrix
        (Foerstner 1979).
    """

    def work(piece: int) -> None:
        """Residuals and redundancy of one piece; pieces run side by side."""
        room = room_of(design, cofactors)
        statistics_piece(design, values, cofactors, piece, point_covariance, residuals, redundancy, room)

    each_piece(len(design.pieces) - 1, work)

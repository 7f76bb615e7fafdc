"""Reduced normal equations without some images: what their points give is taken back and given anew."""

from typing import NamedTuple

from photocal.adjustment.kernels.data import Design, Eliminated, PointRoom, Reduced, Values, columns
from photocal.adjustment.kernels.elimination import own_block
from photocal.adjustment.kernels.ray import corner_of, inverse3, ray_rows
from photocal.base.arrays import Flags, Integers
from photocal.base.compiled import compiled, inlined
from photocal.geometry.lens import Scratch


class Removed(NamedTuple):
    """What is left out.

    out (images,): these images.
    stays (rays,): rays that are left, neither of these images nor of lost points.
    points (n,): points that these images see.
    lost (points,): points that nothing determines any more.
    """

    out: Flags
    stays: Flags
    points: Integers
    lost: Flags


@inlined
def take_back_ray(
    design: Design,
    reduced: Reduced,
    r: int,
    j: int,
    residual: tuple[float, float],
    out: Flags,
    room: Scratch,
) -> None:
    """Take what a ray gives to its camera, and to its image if that stays, and to a point in the border."""
    structure, matrix, gradient = reduced
    i, (vx, vy) = design.ray_image[r], residual
    by_image, by_point, by_camera = room.by_image, room.by_point, room.by_camera
    border, band, k = structure.border, structure.band, design.image_lens[i]
    at, count, point = design.active_column[k], design.active_count[k], design.point_column[j]
    px, py = design.weight[r, 0], design.weight[r, 1]
    base = structure.offset[len(structure.width) - 1]
    for s in range(count):
        cx, cy = px * by_camera[0, design.active[k, s]], py * by_camera[1, design.active[k, s]]
        gradient[band + at + s] -= cx * vx + cy * vy
        for t in range(s + 1):
            n = design.active[k, t]
            matrix[base + (at + s) * border + at + t] -= cx * by_camera[0, n] + cy * by_camera[1, n]
        if point >= 0:
            for a in range(3):
                to = base + (point + a) * border + at + s
                matrix[to] -= cx * by_point[0, a] + cy * by_point[1, a]
    if point >= 0:
        for a in range(3):
            ax, ay = px * by_point[0, a], py * by_point[1, a]
            gradient[band + point + a] -= ax * vx + ay * vy
            for b in range(a + 1):
                to = base + (point + a) * border + point + b
                matrix[to] -= ax * by_point[0, b] + ay * by_point[1, b]
    if out[i]:
        return
    column = design.image_column[i]
    corner, foot, step = corner_of(structure, column)
    for b in range(columns(design)):
        bx, by = px * by_image[0, b], py * by_image[1, b]
        gradient[column + b] -= bx * vx + by * vy
        for a in range(columns(design)):
            matrix[corner + a * step + b] -= bx * by_image[0, a] + by * by_image[1, a]
        for s in range(count):
            n = design.active[k, s]
            matrix[foot + (at + s) * step + b] -= bx * by_camera[0, n] + by * by_camera[1, n]
        if point >= 0:
            for a in range(3):
                matrix[foot + (point + a) * step + b] -= bx * by_point[0, a] + by * by_point[1, a]


@inlined
def eliminate_anew(
    design: Design,
    reduced: Reduced,
    j: int,
    nth: int,
    out: Flags,
    kept: Eliminated,
    left: Eliminated,
    room: PointRoom,
) -> None:
    """Eliminate a point from what stays with what is left of its rays, in place of all of them."""
    structure, matrix, gradient = reduced
    before, after = room.mixed, room.spread
    lens, border, width = structure.lens, structure.border, columns(design)
    mixed, old, new = kept.mixed, kept.mixed_border[j], left.mixed_border[nth]
    base = structure.offset[len(structure.width) - 1]
    for s in range(lens):
        for a in range(3):
            before[a, s], after[a, s] = 0.0, 0.0
            for b in range(3):
                before[a, s] += kept.inverse[j, a, b] * old[b, s]
                after[a, s] += left.inverse[nth, a, b] * new[b, s]
        for a in range(3):
            gradient[structure.band + s] += (
                before[a, s] * kept.gradient[j, a] - after[a, s] * left.gradient[nth, a]
            )
    for s in range(lens):
        for t in range(s + 1):
            for a in range(3):
                matrix[base + s * border + t] += old[a, s] * before[a, t] - new[a, s] * after[a, t]
    begin, end = design.ray_start[j], design.ray_start[j + 1]
    for r in range(begin, end):
        i = design.ray_image[r]
        if out[i]:
            continue
        column = design.image_column[i]
        corner, foot, step = corner_of(structure, column)
        for a in range(3):
            u0, u1, u2 = kept.inverse[j, a, 0], kept.inverse[j, a, 1], kept.inverse[j, a, 2]
            v0, v1, v2 = left.inverse[nth, a, 0], left.inverse[nth, a, 1], left.inverse[nth, a, 2]
            g, h = kept.gradient[j, a], left.gradient[nth, a]
            for b in range(width):
                m0, m1, m2 = mixed[r, 0, b], mixed[r, 1, b], mixed[r, 2, b]
                before[a, b], after[a, b] = u0 * m0 + u1 * m1 + u2 * m2, v0 * m0 + v1 * m1 + v2 * m2
                gradient[column + b] += before[a, b] * g - after[a, b] * h
        for s in range(lens):
            o0, o1, o2, n0, n1, n2 = old[0, s], old[1, s], old[2, s], new[0, s], new[1, s], new[2, s]
            row = foot + s * step
            for b in range(width):
                matrix[row + b] += o0 * before[0, b] + o1 * before[1, b] + o2 * before[2, b]
                matrix[row + b] -= n0 * after[0, b] + n1 * after[1, b] + n2 * after[2, b]
        for a in range(3):
            for b in range(width):
                before[a, b] -= after[a, b]
        for t in range(begin, end):
            other = design.image_column[design.ray_image[t]]
            if other < column or out[design.ray_image[t]]:
                continue
            for a in range(width):
                m0, m1, m2 = mixed[t, 0, a], mixed[t, 1, a], mixed[t, 2, a]
                row = corner + (other - column + a) * step
                for b in range(width):
                    matrix[row + b] += m0 * before[0, b] + m1 * before[1, b] + m2 * before[2, b]


@compiled
def remove_images(
    design: Design,
    values: Values,
    reduced: Reduced,
    removed: Removed,
    kept: Eliminated,
    left: Eliminated,
    room: PointRoom,
) -> None:
    """Take the rays of images from the reduced normal equations, but for their own rows and columns.

    left: receives, but for `mixed`, what elimination of the points that they see leaves, (n, ...).
    """
    out, stays, points, lost = removed
    ray, block, lens = room.ray, room.block, reduced.structure.lens
    for nth in range(len(points)):
        j = points[nth]
        own_block(design, values, j, block, left.gradient[nth])
        for a in range(3):
            for s in range(lens):
                left.mixed_border[nth, a, s] = 0.0
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            i = design.ray_image[r]
            vx, vy = ray_rows(design, values, r, i, j, ray)
            if not stays[r]:
                take_back_ray(design, reduced, r, j, (vx, vy), out, ray)
                continue
            k = design.image_lens[i]
            for a in range(3):
                ax, ay = design.weight[r, 0] * ray.by_point[0, a], design.weight[r, 1] * ray.by_point[1, a]
                left.gradient[nth, a] += ax * vx + ay * vy
                for b in range(3):
                    block[a, b] += ax * ray.by_point[0, b] + ay * ray.by_point[1, b]
                for s in range(design.active_count[k]):
                    n = design.active[k, s]
                    left.mixed_border[nth, a, design.active_column[k] + s] += (
                        ax * ray.by_camera[0, n] + ay * ray.by_camera[1, n]
                    )
        left.singular[nth] = False
        if design.point_column[j] >= 0 or lost[j]:
            for a in range(3):
                for b in range(3):
                    left.inverse[nth, a, b] = 0.0
        else:
            left.singular[nth] = not inverse3(block, left.inverse, nth)
        if design.point_column[j] < 0:
            eliminate_anew(design, reduced, j, nth, out, kept, left, room)

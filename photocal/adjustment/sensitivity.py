"""Kernels that tell how unknowns follow a change of one ray's measurement."""

from typing import NamedTuple

import numpy as np

from photocal.adjustment.kernels.data import Cofactors, Design, Structure, Values, columns, width
from photocal.adjustment.kernels.lanes import filled
from photocal.adjustment.kernels.ray import ray_rows
from photocal.adjustment.kernels.statistics import (
    PointRows,
    gather,
    let_in,
    put_rows,
    put_spread,
    room_of,
)
from photocal.base.arrays import Floats
from photocal.base.compiled import compiled, each_piece, inlined
from photocal.geometry.lens import Scratch, scratch


@compiled
def along_piece(
    design: Design,
    values: Values,
    structure: Structure,
    piece: int,
    step: Floats,
    point_step: Floats,
    change: Floats,
    room: Scratch,
) -> None:
    """Changes of one piece's rays, see `along`."""
    for j in range(design.spans[piece], design.spans[piece + 1]):
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            i = design.ray_image[r]
            k = design.image_lens[i]
            ray_rows(design, values, r, i, j, room)
            column, border = design.image_column[i], structure.band + design.active_column[k]
            for t in range(len(step)):
                for a in range(2):
                    total = 0.0
                    for b in range(columns(design)):
                        total += room.by_image[a, b] * step[t, column + b]
                    for b in range(3):
                        total += room.by_point[a, b] * point_step[t, j, b]
                    for s in range(design.active_count[k]):
                        total += room.by_camera[a, design.active[k, s]] * step[t, border + s]
                    change[t, r, a] = total


def _each(matrix: Floats) -> Floats:
    """View of one matrix, or of several along the first axis, as several."""
    return matrix.reshape(-1, *matrix.shape[-2:])


def along(
    design: Design, values: Values, structure: Structure, step: Floats, point_step: Floats, change: Floats
) -> None:
    """Change of every computed image coordinate along a direction of the unknowns, or along several.

    step (n,) or (t, n): directions in the reduced system.
    point_step (points, 3) or (t, points, 3).
    change (rays, 2) or (t, rays, 2): receives A d.
    """
    step, point_step, change = step.reshape(-1, step.shape[-1]), _each(point_step), _each(change)

    def work(piece: int) -> None:
        """The rays of one piece; pieces run side by side."""
        along_piece(design, values, structure, piece, step, point_step, change, scratch(width(design)))

    each_piece(len(design.pieces) - 1, work)


class RightSides(NamedTuple):
    """Right-hand sides of the normal equations: reduced (t, n), and of the points (t, points, 3)."""

    reduced: Floats
    points: Floats


@inlined
def add_pull(
    design: Design,
    structure: Structure,
    t: int,
    r: int,
    j: int,
    change: tuple[float, float],
    room: Scratch,
    right: RightSides,
) -> None:
    """Add what a change of ray r, whose derivatives are in the scratch room, gives to right-hand side t."""
    by_image, by_point, by_camera = room.by_image, room.by_point, room.by_camera
    reduced, points = right
    i = design.ray_image[r]
    k = design.image_lens[i]
    px, py = design.weight[r, 0] * change[0], design.weight[r, 1] * change[1]
    column, border = design.image_column[i], structure.band + design.active_column[k]
    for b in range(columns(design)):
        reduced[t, column + b] += by_image[0, b] * px + by_image[1, b] * py
    for b in range(3):
        points[t, j, b] += by_point[0, b] * px + by_point[1, b] * py
    for s in range(design.active_count[k]):
        n = design.active[k, s]
        reduced[t, border + s] += by_camera[0, n] * px + by_camera[1, n] * py


@compiled
def across_piece(
    design: Design,
    values: Values,
    structure: Structure,
    piece: int,
    change: Floats,
    room: Scratch,
    reduced: Floats,
    points: Floats,
) -> None:
    """What one piece's rays give to the right-hand side, see `across`."""
    right = RightSides(reduced, points)
    for j in range(design.spans[piece], design.spans[piece + 1]):
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            i, derived = design.ray_image[r], False
            for t in range(len(change)):
                dx, dy = change[t, r, 0], change[t, r, 1]
                if dx == 0.0 and dy == 0.0:
                    continue
                if not derived:
                    ray_rows(design, values, r, i, j, room)
                    derived = True
                add_pull(design, structure, t, r, j, (dx, dy), room, right)


def across(
    design: Design, values: Values, structure: Structure, change: Floats, reduced: Floats, points: Floats
) -> None:
    """Right-hand side A'P d of the normal equations for a change d of all image coordinates, or for several.

    change (rays, 2) or (t, rays, 2).
    reduced (pieces, n) or (pieces, t, n), points (points, 3) or (t, points, 3): receive what they add up to.
    """
    change, points = _each(change), _each(points)
    reduced = reduced.reshape(len(reduced), -1, reduced.shape[-1])

    def work(piece: int) -> None:
        """The rays of one piece; pieces run side by side."""
        room = scratch(width(design))
        across_piece(design, values, structure, piece, change, room, reduced[piece], points)

    each_piece(len(reduced), work)


@compiled
def pulls_piece(
    design: Design,
    values: Values,
    structure: Structure,
    piece: int,
    room: Scratch,
    reduced: Floats,
    points: Floats,
) -> float:
    """What the residuals of one piece's rays give, see `pulls`."""
    total, right = 0.0, RightSides(reduced, points)
    for j in range(design.spans[piece], design.spans[piece + 1]):
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            if design.weight[r, 0] > 0.0 or design.weight[r, 1] > 0.0:
                i = design.ray_image[r]
                vx, vy = ray_rows(design, values, r, i, j, room)
                total += design.weight[r, 0] * vx * vx + design.weight[r, 1] * vy * vy
                if not room.depth[0] > 0.0:
                    total = np.inf
                add_pull(design, structure, 0, r, j, (vx, vy), room, right)
    return total


def pulls(
    design: Design, values: Values, structure: Structure, totals: Floats, reduced: Floats, points: Floats
) -> None:
    """Right-hand side A'P v of the normal equations and v'Pv, infinite for a point behind a camera."""
    reduced, points = reduced[:, None], points[None]

    def work(piece: int) -> None:
        """The rays of one piece; pieces run side by side."""
        room = scratch(width(design))
        totals[piece] = pulls_piece(design, values, structure, piece, room, reduced[piece], points)

    each_piece(len(totals), work)


@compiled
def point_effects_piece(
    design: Design,
    values: Values,
    cofactors: Cofactors,
    piece: int,
    effect: Floats,
    room: PointRows,
) -> None:
    """Effects of one piece's rays, see `point_effects`."""
    rows, block, spread, point = room.rows, room.block, room.spread, room.point
    tall = filled(columns(design))
    begin, end = design.pieces[piece], design.pieces[piece + 1]
    while begin < end:
        stop = let_in(design, begin, end, room.near)
        gather(design, cofactors, room.near)
        for nth in range(begin, stop):
            j = design.order[nth]
            put_rows(design, values, cofactors, j, room)
            put_spread(design, cofactors, j, room)
            first, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
            for r in range(n):
                for x in range(2):
                    for d in range(3):
                        total = 0.0
                        for b in range(3):
                            total += block[d, b] * point[r, x, b]
                        for b in range(tall):
                            total -= spread[d, tall * r + b] * rows[r, x, b]
                        for c in range(cofactors.structure.lens):
                            total -= spread[d, tall * n + c] * rows[r, x, tall + c]
                        free = design.point_free[j, d]
                        effect[first + r, x, d] = free * total * design.weight[first + r, x]
        begin = stop


def point_effects(design: Design, values: Values, cofactors: Cofactors, effect: Floats) -> None:
    """Change of the point that a ray belongs to per unit of change of the ray's coordinates."""

    def work(piece: int) -> None:
        """The rays of one piece; pieces run side by side."""
        room = room_of(design, cofactors)
        point_effects_piece(design, values, cofactors, piece, effect, room)

    each_piece(len(design.pieces) - 1, work)

"""Covariance of the points and redundancy numbers of the rays."""

from photocal.adjustment.kernels.data import (
    Cofactors,
    Design,
    PointRoom,
    Values,
    columns,
    point_room,
    width,
)
from photocal.adjustment.kernels.elimination import most_rays
from photocal.adjustment.kernels.ray import corner_of, ray_rows
from photocal.base.arrays import Floats
from photocal.base.compiled import compiled, each_piece, inlined


@inlined
def gather(design: Design, cofactors: Cofactors, j: int, local: Floats) -> int:
    """Copy the covariance among all that a point's rays touch; returns its size."""
    structure, inverse = cofactors.structure, cofactors.inverse
    border = structure.border
    # Only a point that stays among the unknowns has columns behind those of the cameras.
    reach = border if design.point_column[j] >= 0 else structure.lens
    begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
    edge = columns(design) * n
    for r in range(n):
        column = design.image_column[design.ray_image[begin + r]]
        corner, foot, step = corner_of(structure, column)
        for t in range(n):
            other = design.image_column[design.ray_image[begin + t]]
            if other < column:
                continue
            start = corner + (other - column) * step
            for a in range(columns(design)):
                for b in range(columns(design)):
                    z = inverse[start + a * step + b]
                    local[columns(design) * t + a, columns(design) * r + b] = z
                    local[columns(design) * r + b, columns(design) * t + a] = z
        for s in range(reach):
            for b in range(columns(design)):
                z = inverse[foot + s * step + b]
                local[edge + s, columns(design) * r + b] = z
                local[columns(design) * r + b, edge + s] = z
    base = structure.offset[len(structure.width) - 1]
    for s in range(reach):
        for t in range(s + 1):
            local[edge + s, edge + t] = inverse[base + s * border + t]
            local[edge + t, edge + s] = inverse[base + s * border + t]
    return int(edge + reach)


@inlined
def eliminated_spread(design: Design, cofactors: Cofactors, j: int, m: int, room: PointRoom) -> None:
    """Relate a point to the m unknowns of its rays, whose covariance Q_uu is `local` of the room.

    Its `mixed` and `spread` receive V^-1 W' and V^-1 W' Q_uu: Q_pu = -spread, Q_pp = V^-1 + spread W V^-1.
    A point that stays among the unknowns has its covariance in `local`.
    """
    kept, lens, mixed, spread, local = (
        cofactors.kept,
        cofactors.structure.lens,
        room.mixed,
        room.spread,
        room.local,
    )
    begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
    edge, stays = columns(design) * n, design.point_column[j]
    for a in range(3):
        q0, q1, q2 = kept.inverse[j, a, 0], kept.inverse[j, a, 1], kept.inverse[j, a, 2]
        for r in range(n):
            for b in range(columns(design)):
                mixed[a, columns(design) * r + b] = (
                    q0 * kept.mixed[begin + r, 0, b]
                    + q1 * kept.mixed[begin + r, 1, b]
                    + q2 * kept.mixed[begin + r, 2, b]
                )
        for s in range(edge, m):
            mixed[a, s] = 0.0
        for s in range(lens):
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
    if stays >= 0:
        for a in range(3):
            for b in range(m):
                spread[a, b] = -local[edge + stays + a, b]


@compiled
def statistics_piece(
    design: Design,
    values: Values,
    cofactors: Cofactors,
    piece: int,
    point_covariance: Floats,
    residuals: Floats,
    redundancy: Floats,
    space: PointRoom,
) -> None:
    """Statistics of one piece's points, see `statistics`."""
    room, cov, mixed, spread, local, row = space
    kept = cofactors.kept
    for nth in range(design.pieces[piece], design.pieces[piece + 1]):
        j = design.order[nth]
        begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
        edge = columns(design) * n
        m = gather(design, cofactors, j, local)
        eliminated_spread(design, cofactors, j, m, space)
        stays = design.point_column[j]
        for a in range(3):
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
            k = design.image_lens[i]
            residuals[r, 0], residuals[r, 1] = ray_rows(design, values, r, i, j, room)
            at, first = edge + design.active_column[k], columns(design) * (r - begin)
            count = design.active_count[k]
            for a in range(2):
                b0, b1, b2 = room.by_point[a, 0], room.by_point[a, 1], room.by_point[a, 2]
                variance = 0.0
                for b in range(3):
                    variance += room.by_point[a, b] * (cov[b, 0] * b0 + cov[b, 1] * b1 + cov[b, 2] * b2)
                for s in range(count):
                    row[s] = room.by_camera[a, design.active[k, s]]
                for b in range(columns(design)):
                    part = -2.0 * (
                        spread[0, first + b] * b0 + spread[1, first + b] * b1 + spread[2, first + b] * b2
                    )
                    for c in range(columns(design)):
                        part += local[first + b, first + c] * room.by_image[a, c]
                    for s in range(count):
                        part += 2.0 * local[first + b, at + s] * row[s]
                    variance += room.by_image[a, b] * part
                for b in range(count):
                    part = -2.0 * (spread[0, at + b] * b0 + spread[1, at + b] * b1 + spread[2, at + b] * b2)
                    for s in range(count):
                        part += local[at + b, at + s] * row[s]
                    variance += row[b] * part
                redundancy[r, a] = 1.0 - design.weight[r, a] * variance


def room_of(design: Design, cofactors: Cofactors) -> PointRoom:
    """Make room for any point and all that its rays touch."""
    size = width(design) * most_rays(design) + cofactors.structure.border
    return point_room(width(design), size)


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

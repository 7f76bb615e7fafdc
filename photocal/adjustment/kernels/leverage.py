"""What groups of rays give to the cameras when their points are intersected anew without them."""

import math
from typing import NamedTuple

import numpy as np

from photocal.adjustment.kernels.data import Design, Values, width
from photocal.adjustment.kernels.ray import ray_rows
from photocal.base.arrays import Floats, Integers
from photocal.base.compiled import compiled, each_piece, inlined
from photocal.geometry.lens import Scratch, scratch

# Of the information of a point, in any direction, so much is left or nothing is.
LEFT_OF_POINT = 1e-6


class OfGroup(NamedTuple):
    """What a group's rays give to the normal equations of a point, and between it and the cameras.

    sums (k, k + 1): what the group gives to the cameras, X'DX below and on the diagonal; last X'Dv.
    root (3, 3): lower one of the point's covariance; in its axes the point's normal matrix is the unit.
    left (3, 3): what is left of that without the group.
    across (3, k + 1): between the point and the cameras; last, what the residuals pull.
    ray (2, k + 1): changes of both coordinates of a ray; last, its residuals.
    """

    sums: Floats
    root: Floats
    left: Floats
    across: Floats
    ray: Floats


def room_of_group(count: int) -> OfGroup:
    """Make room for one group, a point of it and so many parameters of cameras."""
    sums, of_rays = np.zeros((count, count + 1)), (np.zeros((3, count + 1)), np.zeros((2, count + 1)))
    return OfGroup(sums, np.zeros((3, 3)), np.zeros((3, 3)), *of_rays)


@inlined
def put_root(inverse: Floats, j: int, root: Floats) -> bool:
    """Take the root of a point's covariance; False where the point is not eliminated."""
    for a in range(3):
        for b in range(a + 1):
            total = inverse[j, a, b]
            for c in range(b):
                total -= root[a, c] * root[b, c]
            if a > b:
                root[a, b] = total / root[b, b]
            elif total > 0.0:
                root[a, a] = math.sqrt(total)
            else:
                return False
    return True


@inlined
def eliminate(left: Floats, across: Floats, sums: Floats) -> None:
    """Eliminate a point, the largest pivot first; where nothing is left of it, it had no pull either."""
    count = across.shape[1] - 1
    for _ in range(3):
        p = 0
        for a in range(1, 3):
            if left[a, a] > left[p, p]:
                p = a
        pivot = left[p, p]
        if not pivot > LEFT_OF_POINT:
            return
        for a in range(3):
            if a != p:
                share = left[a, p] / pivot
                for b in range(3):
                    if b != p:
                        left[a, b] -= share * left[p, b]
                for s in range(count + 1):
                    across[a, s] -= share * across[p, s]
        for s in range(count):
            scaled = across[p, s] / pivot
            sums[s, count] += scaled * across[p, count]
            for t in range(s + 1):
                sums[s, t] += scaled * across[p, t]
        for a in range(3):
            left[a, p] = left[p, a] = 0.0


@compiled
def left_out_group(
    design: Design,
    values: Values,
    rays: Integers,
    ray_point: Integers,
    changes: Floats,
    inverse: Floats,
    room: Scratch,
    of_group: OfGroup,
) -> None:
    """Sums over one group's rays, see `left_out_groups`."""
    sums, root, left, across, ray = of_group
    count, at, end = changes.shape[2], 0, len(rays)
    while at < end:
        j = ray_point[rays[at]]
        stays = not put_root(inverse, j, root)
        left[:] = 0.0
        across[:] = 0.0
        for a in range(3):
            left[a, a] = 1.0
        while at < end and ray_point[rays[at]] == j:
            r = rays[at]
            at += 1
            ray[0, count], ray[1, count] = ray_rows(design, values, r, design.ray_image[r], j, room)
            for a in range(2):
                weight, by_point = design.weight[r, a], room.by_point
                for s in range(count):
                    weighted = weight * changes[r, a, s]
                    ray[a, s] = changes[r, a, s]
                    sums[s, count] += weighted * ray[a, count]
                    for t in range(s + 1):
                        sums[s, t] += weighted * ray[a, t]
                if stays:
                    continue
                for b in range(3):
                    turned = 0.0
                    for c in range(b, 3):
                        turned += root[c, b] * by_point[a, c]
                    by_point[a, b] = turned
                for b in range(3):
                    weighted = weight * by_point[a, b]
                    for c in range(3):
                        left[b, c] -= weighted * by_point[a, c]
                    for s in range(count + 1):
                        across[b, s] += weighted * ray[a, s]
        if not stays:
            eliminate(left, across, sums)


def left_out_groups(
    design: Design,
    values: Values,
    order: Integers,
    starts: Integers,
    ray_point: Integers,
    changes: Floats,
    inverse: Floats,
) -> tuple[Floats, Floats]:
    """X'Dv and X'DX of the rays of groups, (groups, k) and (groups, k, k); see `leverage`.

    order: rays by group and, within it, by point; starts (groups + 1,): where each group begins.
    changes (rays, 2, k): X.
    inverse (points, 3, 3): of each point's own normal matrix; zero where it is not eliminated.
    """
    groups, count = len(starts) - 1, changes.shape[2]
    sums = np.zeros((groups, count, count + 1))

    def work(group: int) -> None:
        """The rays of one group; groups run side by side."""
        rays, own = order[starts[group] : starts[group + 1]], room_of_group(count)
        left_out_group(design, values, rays, ray_point, changes, inverse, scratch(width(design)), own)
        sums[group] = own.sums

    each_piece(groups, work)
    pull, hold = sums[:, :, count], sums[:, :, :count]
    return pull, hold + np.swapaxes(np.tril(hold, -1), 1, 2)

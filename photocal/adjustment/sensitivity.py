"""Kernels that tell how unknowns follow a change of one ray's measurement."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.kernels import (
    Design,
    Eliminated,
    Structure,
    Values,
    gather,
    most_rays,
    ray_rows,
)
from photocal.compiled import compiled, compiled_parallel
from photocal.geometry.lens import Scratch, scratch

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


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
    """Changes of one thread's rays, see `along`."""
    for j in range(design.pieces[piece], design.pieces[piece + 1]):
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            i = design.ray_image[r]
            k = design.image_camera[i]
            ray_rows(design, values, r, i, j, room)
            column, border = design.image_column[i], structure.band + design.active_column[k]
            for a in range(2):
                total = 0.0
                for b in range(6):
                    total += room.by_pose[a, b] * step[column + b]
                for b in range(3):
                    total += room.by_point[a, b] * point_step[j, b]
                for s in range(design.active_count[k]):
                    total += room.by_camera[a, design.active[k, s]] * step[border + s]
                change[r, a] = total


@compiled_parallel
def along(
    design: Design, values: Values, structure: Structure, step: Floats, point_step: Floats, change: Floats
) -> None:
    """Change of every computed image coordinate along a direction of the unknowns.

    Parameters
    ----------
    design, values, structure
        As in `kernels.accumulate`.
    step : ndarray, shape (n,)
        Direction in the reduced system.
    point_step : ndarray, shape (points, 3)
    change : ndarray, shape (rays, 2)
        Receives A d.
    """
    for piece in numba.prange(len(design.pieces) - 1):
        along_piece(design, values, structure, piece, step, point_step, change, scratch())


@compiled
def point_effects_piece(
    design: Design,
    values: Values,
    structure: Structure,
    piece: int,
    inverse: Floats,
    kept: Eliminated,
    covariance: Floats,
    effect: Floats,
    room: Scratch,
    mixed: Floats,
    spread: Floats,
    local: Floats,
) -> None:
    """Effects of one thread's rays, see `point_effects`."""
    for j in range(design.pieces[piece], design.pieces[piece + 1]):
        begin, n = design.ray_start[j], design.ray_start[j + 1] - design.ray_start[j]
        edge, stays = 6 * n, design.point_column[j]
        m = gather(design, structure, j, inverse, local)
        # spread = -Q_pu, see `kernels.statistics`.
        for a in range(3):
            for c in range(m):
                mixed[a, c] = 0.0
                spread[a, c] = 0.0
            for b in range(3):
                q = kept.inverse[j, a, b]
                for r in range(n):
                    for c in range(6):
                        mixed[a, 6 * r + c] += q * kept.mixed[begin + r, b, c]
                for c in range(structure.lens):
                    mixed[a, edge + c] += q * kept.mixed_border[j, b, c]
            for c in range(m):
                for b in range(m):
                    spread[a, b] += mixed[a, c] * local[c, b]
            if stays >= 0:
                for b in range(m):
                    spread[a, b] = -local[edge + stays + a, b]
        for r in range(begin, begin + n):
            i = design.ray_image[r]
            k = design.image_camera[i]
            ray_rows(design, values, r, i, j, room)
            at, first = edge + design.active_column[k], 6 * (r - begin)
            for a in range(2):
                for d in range(3):
                    total = 0.0
                    for b in range(3):
                        total += covariance[j, d, b] * room.by_point[a, b]
                    for b in range(6):
                        total -= spread[d, first + b] * room.by_pose[a, b]
                    for s in range(design.active_count[k]):
                        total -= spread[d, at + s] * room.by_camera[a, design.active[k, s]]
                    # The residual is computed minus measured: the measurement enters with the weight only.
                    effect[r, a, d] = total * design.weight[r, a] * design.point_free[j, d]


@compiled_parallel
def point_effects(
    design: Design,
    values: Values,
    structure: Structure,
    inverse: Floats,
    kept: Eliminated,
    covariance: Floats,
    effect: Floats,
) -> None:
    """Change of the point that a ray belongs to per unit of change of the ray's coordinates.

    Parameters
    ----------
    design, values, structure, inverse, kept
        As in `kernels.statistics`.
    covariance : ndarray, shape (points, 3, 3)
        Of the points, of the same (minimally constrained) datum.
    effect : ndarray, shape (rays, 2, 3)
        Receives Q_p a p: rows of Q A'P.
    """
    for piece in numba.prange(len(design.pieces) - 1):
        size = 6 * most_rays(design, piece) + structure.border
        point_effects_piece(
            design,
            values,
            structure,
            piece,
            inverse,
            kept,
            covariance,
            effect,
            scratch(),
            np.zeros((3, size)),
            np.zeros((3, size)),
            np.zeros((size, size)),
        )

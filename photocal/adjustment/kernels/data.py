"""What the kernels read and keep: network, values, structure, and what elimination leaves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Design(NamedTuple):
    """What stays the same while the unknowns change; arrays that kernels read.

    Attributes
    ----------
    pieces : ndarray of int, shape (threads + 1,)
        First point of each thread's piece.
    ray_start : ndarray of int, shape (points + 1,)
        First ray of each point.
    ray_image : ndarray of int, shape (rays,)
    plane, weight : ndarray, shape (rays, 2)
        Measured coordinates and their weights 1 / sigma^2.
    image_camera, image_column : ndarray of int, shape (images,)
        Camera and first column of each image.
    pose_free : ndarray, shape (images, 6)
        1 where a pose unknown is free, else 0.
    optics : ndarray, shape (cameras, 11)
        From `lens.optics`.
    active : ndarray of int, shape (cameras, 13)
        Positions of the estimated parameters, the first `active_count` of each row.
    active_count, active_column : ndarray of int, shape (cameras,)
        Number of estimated parameters and the first of their columns within the border.
    point_column : ndarray of int, shape (points,)
        First column, within the border, of a point that is not eliminated; -1 for all others.
    point_free : ndarray, shape (points, 3)
        1 where a coordinate is free, else 0.
    prior_points, prior_weight : ndarray, shape (points, 3) and (points, 3, 3)
        Observed coordinates and their weights.
    """

    pieces: Integers
    ray_start: Integers
    ray_image: Integers
    plane: Floats
    weight: Floats
    image_camera: Integers
    image_column: Integers
    pose_free: Floats
    optics: Floats
    active: Integers
    active_count: Integers
    active_column: Integers
    point_column: Integers
    point_free: Floats
    prior_points: Floats
    prior_weight: Floats


class Values(NamedTuple):
    """What the unknowns are now.

    Attributes
    ----------
    cameras : ndarray, shape (cameras, 13)
    rotation, basis : ndarray, shape (images, 3, 3)
        Object to camera axes; the turn that each rotation unknown makes.
    centre : ndarray, shape (images, 3)
    points : ndarray, shape (points, 3)
    """

    cameras: Floats
    rotation: Floats
    basis: Floats
    centre: Floats
    points: Floats


class Structure(NamedTuple):
    """Structure of the reduced matrix, see `envelope.Envelope`.

    The first `lens` columns of the border belong to the cameras: the only ones that rays touch.
    """

    panel: int
    last: Integers
    width: Integers
    offset: Integers
    band: int
    border: int
    lens: int


class Eliminated(NamedTuple):
    """What elimination of the points leaves behind, so that their steps can be found afterwards.

    Attributes
    ----------
    mixed : ndarray, shape (rays, 3, 6)
        Normal matrix between the point and the exposure of each ray.
    mixed_border : ndarray, shape (points, 3, lens)
        Between each point and the cameras.
    inverse : ndarray, shape (points, 3, 3)
        Inverse of each point's own block; zero where its rays do not determine it.
    gradient : ndarray, shape (points, 3)
    """

    mixed: Floats
    mixed_border: Floats
    inverse: Floats
    gradient: Floats

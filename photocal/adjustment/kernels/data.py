"""What the kernels read and keep: network, values, structure, and what elimination leaves."""

from __future__ import annotations

from typing import NamedTuple

from drivers.arrays import Floats, Integers
from photocal.compiled import inlined
from photocal.geometry.camera import MOTION, OWN

# Columns that an image may have: its exterior orientation, and room for parameters of its own. Kernels
# are compiled for each of them, for loops of a known length are much faster.
POSE = 6
WIDTHS = (POSE, POSE + len(MOTION), POSE + len(OWN))


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
    width : ndarray
        Its number of axes, which the compiler knows, tells the columns of an image: see `columns`.
    image_lens, image_column : ndarray of int, shape (images,)
        Lens and first column of each image. Images share the lens of their camera; with parameters of their
        own, or a rolling shutter, each image has its own.
    pose_free : ndarray, shape (images, 6)
        1 where a pose unknown is free, else 0.
    own, own_count : ndarray of int, shape (lenses, n) and (lenses,)
        Positions of the parameters of an image's own, the first `own_count` of each row.
    optics : ndarray, shape (lenses, 20)
        From `lens.optics`, and velocity and rate of the image.
    active : ndarray of int, shape (lenses, 14)
        Positions of the estimated parameters, the first `active_count` of each row.
    active_count, active_column : ndarray of int, shape (lenses,)
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
    width: Floats
    image_lens: Integers
    image_column: Integers
    pose_free: Floats
    own: Integers
    own_count: Integers
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
    lenses : ndarray, shape (lenses, 20)
        Parameters of the camera, and movement of the image during the readout.
    rotation, basis : ndarray, shape (images, 3, 3)
        Object to camera axes; the turn that each rotation unknown makes.
    centre : ndarray, shape (images, 3)
    points : ndarray, shape (points, 3)
    """

    lenses: Floats
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
    mixed : ndarray, shape (rays, 3, columns of an image)
        Normal matrix between the point and the image of each ray.
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


@inlined
def columns(design: Design) -> int:
    """Columns of an image, a constant of the compiled kernel."""
    return WIDTHS[design.width.ndim - 1]

"""What the kernels read and keep: network, values, structure, and what elimination leaves."""

from typing import NamedTuple

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.compiled import inlined
from photocal.geometry.camera import MOTION, OWN, SHAKE
from photocal.geometry.lens import Scratch, scratch

# Columns that an image may have: its exterior orientation, and room for parameters of its own (c, K1 and K2
# of a camera that took one image, say). Kernels are compiled for each of them, for loops of a known length
# are much faster; the first is that of networks of Brown's lenses alone, all lines at one pose, whose kernels
# know no others.
POSE = 6
WIDTHS = (POSE, POSE, POSE + 3, POSE + len(MOTION), POSE + len(MOTION + SHAKE), POSE + len(OWN))


class Design(NamedTuple):
    """What stays the same while the unknowns change; arrays that kernels read.

    order (points,): points that the same images see stand close together, as their elements of the matrix do.
    pieces (pieces + 1,): first of each piece's points, in that order. Pieces are what threads work on; they
        do not depend on the number of threads: sums have the same digits with any.
    spans (pieces + 1,): the same for work that touches no matrix, in the order of the points themselves.
    reach (pieces, 2): first image, in the order of their columns, that a piece's points touch, and one past
        the last.
    ray_start (points + 1,): first ray of each point.
    ray_image (rays,).
    plane, weight (rays, 2): measured coordinates and their weights 1 / sigma^2.
    width: its number of axes, which the compiler knows, tells the columns of an image and whether lenses are
        plain: see `columns`, `plain`.
    image_lens, image_column (images,): lens and first column of each image. Images share the lens of their
        camera; with parameters of their own, or a rolling shutter, each image has its own.
    pose_free (images, 6): 1 where a pose unknown is free, else 0.
    variant, variant_count (lenses, n): positions of the parameters whose columns stand with the image's, the
        first so many of each row.
    optics (lenses, 20 or 35): from `lens.optics`, and the given motion of the image.
    active (lenses, 20): positions of the estimated parameters in the border, the first `active_count` of each
        row.
    active_count, active_column (lenses,): number of estimated parameters and the first of their columns
        within the border.
    point_column (points,): first column, within the border, of a point that is not eliminated; -1 for all
        others.
    point_free (points, 3): 1 where a coordinate is free, else 0.
    prior_points, prior_weight (points, 3): observed coordinates and their weights.
    """

    order: Integers
    pieces: Integers
    spans: Integers
    reach: Integers
    ray_start: Integers
    ray_image: Integers
    plane: Floats
    weight: Floats
    width: Floats
    image_lens: Integers
    image_column: Integers
    pose_free: Floats
    variant: Integers
    variant_count: Integers
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

    lenses (lenses, 26 or 41): parameters of the camera, and movement of the image during the readout, see
        `shutter.rolling_residual`.
    rotation, basis (images, 3, 3): object to camera axes; the turn that each rotation unknown makes.
    centre (images, 3).
    points (points, 3).
    """

    lenses: Floats
    rotation: Floats
    basis: Floats
    centre: Floats
    points: Floats


class Structure(NamedTuple):
    """Structure of a matrix with a band and a border, in panels of columns, see `envelope`.

    panel: columns in a panel (the last one may have fewer).
    last (panels,): one past the last row of the band part of each panel.
    width (panels + 1,): columns of each panel; the border is the last.
    offset (panels + 2,): where each panel begins in the array of values; the border is the last but one.
    band, border: columns of the band and of the border.
    lens: of the border, the first ones, which belong to the cameras: the only ones that rays touch.
    """

    panel: int
    last: Integers
    width: Integers
    offset: Integers
    band: int
    border: int
    lens: int = 0

    @property
    def size(self) -> int:
        """Order of the matrix."""
        return self.band + self.border

    def panels(self, values: Floats) -> list[Floats]:
        """Views of the panels, each (rows, columns); the border's own panel is the last."""
        return [
            values[self.offset[j] : self.offset[j + 1]].reshape(-1, w) if w else np.zeros((0, 0))
            for j, w in enumerate(self.width)
        ]

    def start(self, j: int) -> int:
        """First column of panel j."""
        return j * self.panel

    def zeros(self) -> Floats:
        """Make the array of values of a matrix of this structure."""
        return np.zeros(int(self.offset[-1]))


class Eliminated(NamedTuple):
    """What elimination of the points leaves behind, so that their steps can be found afterwards.

    mixed (rays, 3, columns of an image): normal matrix between the point and the image of each ray.
    mixed_border (points, 3, lens): between each point and the cameras.
    inverse (points, 3, 3): inverse of each point's own block; zero where its rays do not determine it.
    gradient (points, 3).
    singular (points,): whether their rays do not determine them.
    """

    mixed: Floats
    mixed_border: Floats
    inverse: Floats
    gradient: Floats
    singular: Flags


class Reduced(NamedTuple):
    """Reduced normal equations: values of the matrix within its structure, and A'Pv."""

    structure: Structure
    matrix: Floats
    gradient: Floats


class Cofactors(NamedTuple):
    """The selected inverse of the reduced matrix, and what leads from it to the points."""

    structure: Structure
    inverse: Floats
    kept: Eliminated


class PointRoom(NamedTuple):
    """Room for the work on one point and the m unknowns that its rays touch; made once for many points.

    ray: derivatives of one of its rays.
    block (3, 3): normal equations of the point.
    mixed, spread (3, m): what relates it to the others.
    """

    ray: Scratch
    block: Floats
    mixed: Floats
    spread: Floats


def point_room(wide: int, size: int) -> PointRoom:
    """Make room for points that touch so many unknowns, with so many columns of each image."""
    return PointRoom(scratch(wide), np.zeros((3, 3)), np.zeros((3, size)), np.zeros((3, size)))


def width(design: Design) -> int:
    """Columns of an image, a constant of the compiled kernel."""
    return WIDTHS[design.width.ndim - 1]


columns = inlined(width)


@inlined
def plain(design: Design) -> bool:
    """Whether all lenses are Brown's, with one pose for all lines, a constant of the compiled kernel."""
    return design.width.ndim == 1

"""GNSS antenna and inertial unit beside the camera: positions and attitudes as observations.

The antenna of image i is observed at  X0 + M' B l - v dt + f + g h z + s + d t,  with l the lever arm from
the projection centre to the antenna in body axes, B the rotation from body to camera axes, v the velocity
and dt the time by which exposures happen later than their stamps, f the shift of the whole flight, g the
scale of the heights h above the base station (what the troposphere leaves), s and d shift and drift of the
strip.
The attitude R (object to body axes) obeys  M = exp([r]x) B R  with r the residual in camera axes.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from photocal.adjustment.equations import Equations
from photocal.adjustment.kernels.placing import OF_ATTITUDE, OF_POSITION, attitude_rows, position_rows
from photocal.base.arrays import Columns, Floats, Integers
from photocal.geometry.rotation import NADIR, turned

_UP = np.array([0.0, 0.0, 1.0])

# What is common to all exposures: 3 lever arm (m), 3 boresight (rad), 1 time offset (s), 3 shift (m) and 1
# scale of the heights (m/m) of the flight, then 3 shift (m) and 3 drift (m/s) of each strip.
LEVER, BORESIGHT, TIME, SHIFT, HEIGHT_SCALE, STRIPS = slice(0, 3), slice(3, 6), 6, slice(7, 10), 10, 11
# What belongs to the flight, not to the rig.
OF_FLIGHT = slice(SHIFT.start, STRIPS)
COMMON = (
    *("lever_arm_x", "lever_arm_y", "lever_arm_z", "boresight_x", "boresight_y", "boresight_z"),
    *("time_offset", "shift_x", "shift_y", "shift_z", "height_scale"),
)


@dataclass(frozen=True)
class Mounting:
    """The common unknowns of positions and attitudes.

    rotation (3, 3): nominal rotation from body to camera axes.
    values, sigma (11 + 6 strips,): lever arm, boresight (a rotation vector in camera axes), time offset,
        shift and height scale of the flight, shift and drift of each strip. A sigma of 0 holds a value, a
        positive one weights it, infinity leaves it free.
    """

    rotation: Floats
    values: Floats
    sigma: Floats


@dataclass(frozen=True)
class Positions(Columns):
    """Observed antenna positions.

    image (n,).
    values (n, 3): m, in the object frame.
    covariance (n, 3, 3).
    velocity (n, 3): m/s; zero where unknown.
    strip (n,).
    time (n,): seconds since the middle of the strip, for the drift.
    above (n,): height above the base station, m, for the height scale.
    """

    image: Integers
    values: Floats
    covariance: Floats
    velocity: Floats
    strip: Integers
    time: Floats
    above: Floats

    @cached_property
    def whitening(self) -> Floats:
        """L^-1 of covariance = L L', (n, 3, 3): it makes unit weights."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    def stated(self) -> Floats:
        """Medians of the stated standard deviations of a position, (3,), m; NaN without any."""
        sigma = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return np.asarray(np.median(sigma, axis=0) if len(sigma) else np.full(3, np.nan))


@dataclass(frozen=True)
class Attitudes(Columns):
    """Observed attitudes of the body.

    image (n,).
    rotation (n, 3, 3): object to body axes.
    covariance (n, 3, 3): of small turns about the body axes, rad^2.
    rate, rate_sigma (n, 3): angular velocity about the body axes, rad/s; NaN where it is not known.
    """

    image: Integers
    rotation: Floats
    covariance: Floats
    rate: Floats | None = None
    rate_sigma: Floats | None = None

    @cached_property
    def whitening(self) -> Floats:
        """See `Positions.whitening`."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))


NO_MOUNTING = Mounting(NADIR, np.zeros(STRIPS), np.zeros(STRIPS))
_NONE = np.zeros(0, dtype=np.int64)
_NOTHING = np.zeros(0)
NO_POSITIONS = Positions(
    _NONE, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), _NONE, _NOTHING, _NOTHING
)
NO_ATTITUDES = Attitudes(_NONE, np.zeros((0, 3, 3)), np.zeros((0, 3, 3)))


def body_to_camera(mounting: Mounting, values: Floats) -> Floats:
    """Rotation from body to camera axes with the boresight of the common values, shape (3, 3)."""
    return np.asarray(turned(mounting.rotation[None], values[None, BORESIGHT])[0])


def antennas(
    positions: Positions, matrix: Floats, values: Floats, rotation: Floats, centre: Floats
) -> Floats:
    """Where the antenna was by the poses of the images and the common values, shape (n, 3), object frame.

    matrix (3, 3): of `body_to_camera` with these values.
    """
    arm = matrix @ values[LEVER]
    of_strip = values[(STRIPS + 6 * positions.strip)[:, None] + np.arange(6)]
    shift, drift = of_strip[:, :3], of_strip[:, 3:]
    to_object = np.swapaxes(rotation[positions.image], 1, 2)
    computed = centre[positions.image] + to_object @ arm - positions.velocity * values[TIME] + shift
    computed = computed + drift * positions.time[:, None] + values[SHIFT]
    # Heights are those along the Z axis: the frame of a block is level in its middle.
    return np.asarray(computed + positions.above[:, None] * _UP * values[HEIGHT_SCALE])


def position_equations(
    positions: Positions,
    body: tuple[Floats, Floats],
    values: Floats,
    rotation: Floats,
    centre: Floats,
    image_columns: Integers,
    basis: Floats,
    common_columns: Integers,
) -> Equations:
    """Linearise the antenna positions.

    body: matrix as in `antennas`, and the turn of the camera by a unit of the boresight, (3, 3) each.
    """
    image, (matrix, by_boresight) = positions.image, body
    miss = antennas(positions, matrix, values, rotation, centre) - positions.values
    rows = np.empty((len(image), 3, OF_POSITION + 1))
    position_rows(
        rotation[image],
        basis[image],
        positions.whitening,
        matrix,
        by_boresight,
        matrix @ values[LEVER],
        np.column_stack([miss, positions.velocity, positions.above, positions.time]),
        rows,
    )
    of_flight = np.broadcast_to(common_columns[:STRIPS], (len(image), STRIPS))
    of_strip = common_columns[(STRIPS + 6 * positions.strip)[:, None] + np.arange(6)]
    return _in_rows(np.hstack([image_columns[image], of_flight, of_strip]), rows)


def attitude_equations(
    attitudes: Attitudes,
    body: tuple[Floats, Floats],
    rotation: Floats,
    image_columns: Integers,
    basis: Floats,
    common_columns: Integers,
) -> Equations:
    """Linearise the attitudes; parameters and result as in `position_equations`."""
    image, observed = attitudes.image, np.ascontiguousarray(attitudes.rotation)
    rows = np.empty((len(image), 3, OF_ATTITUDE + 1))
    attitude_rows(rotation[image], basis[image], attitudes.whitening, *body, observed, rows)
    of_boresight = np.broadcast_to(common_columns[BORESIGHT], (len(image), 3))
    return _in_rows(np.hstack([image_columns[image, :3], of_boresight]), rows)


def common_equations(given: Floats, sigma: Floats, values: Floats, common_columns: Integers) -> Equations:
    """Common values as observations of what is given, where that has a sigma."""
    weighted = np.flatnonzero(np.isfinite(sigma) & (sigma > 0) & (common_columns >= 0))
    column = common_columns[weighted]
    residual = (values - given)[weighted]
    return Equations(
        np.arange(len(column) + 1), column, np.ones(len(column)), residual, sigma[weighted] ** -2.0
    )


def whitened(parts: list[tuple[Integers, Floats]], residual: Floats, root: Floats) -> Equations:
    """Equations of unit weight from blocks of columns and coefficients; unused columns drop out.

    root (n, 3, 3): with covariance = L L' the rows L^-1 A have unit weight.
    """
    columns = np.hstack([columns for columns, _ in parts])
    coefficient = root @ np.concatenate([block for _, block in parts], axis=2)
    residual = np.einsum("nab,nb->na", root, residual)
    return _in_rows(columns, np.concatenate([coefficient, residual[:, :, None]], axis=2))


def _in_rows(columns: Integers, rows: Floats) -> Equations:
    """Equations of unit weight from columns (n, k), and coefficients and residuals (n, 3, k + 1)."""
    column = np.repeat(columns, 3, axis=0)
    used = column >= 0
    residual = rows[:, :, -1].ravel()
    return Equations(
        np.concatenate([[0], np.cumsum(used.sum(axis=1))]),
        column[used],
        rows[:, :, :-1].reshape(column.shape)[used],
        residual,
        np.ones(len(residual)),
    )

"""Direct georeferencing from GNSS and inertial unit alone, also line by line, and with a calibration."""

from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.covariance import blocks
from photocal.adjustment.envelope import border_inverse
from photocal.adjustment.factored import Factored, factored
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import (
    BORESIGHT,
    HEIGHT_SCALE,
    LEVER,
    OF_FLIGHT,
    SHIFT,
    STRIPS,
    TIME,
    Mounting,
    body_to_camera,
)
from photocal.adjustment.readout import READOUT
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import ConfigurationError
from photocal.block.model import Block
from photocal.block.network import assemble, observed_pixels
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.oriented_images import oriented_images, turned
from photocal.geometry.rotation import left_jacobian, matrix_from_angles, skew, turn_per_angle


@dataclass(frozen=True)
class Calibration:
    """Camera and mounting as one adjustment has found them.

    They are correlated, often nearly fully (principal point and boresight, principal distance and vertical
    lever arm): what one takes from the other cancels on the ground. Diagonals alone would predict errors many
    times too large.

    cameras (n, parameters): in the order of the block's cameras.
    mounting (11,): lever arm (m), boresight (rad), time offset (s); shift (m) and height scale of its flight.
    covariance (11 + n parameters, 11 + n parameters): of the mounting, then of the cameras; zero for what was
        held.
    """

    cameras: Floats
    mounting: Floats
    covariance: Floats

    def on_flight(self, mounting: Mounting) -> "Calibration":
        """Give the calibration for another flight, whose positions have errors of their own."""
        values, covariance = self.mounting.copy(), self.covariance.copy()
        values[OF_FLIGHT] = mounting.values[OF_FLIGHT]
        covariance[OF_FLIGHT], covariance[:, OF_FLIGHT] = 0.0, 0.0
        stated = mounting.sigma[OF_FLIGHT]
        at = np.arange(len(covariance))[OF_FLIGHT]
        covariance[at, at] = np.where(np.isfinite(stated), stated, 0.0) ** 2
        return Calibration(self.cameras, values, covariance)


def calibrate(block: Block) -> Calibration:
    """Adjust a block and keep camera and mounting; raises PhotocalError as the adjustment does."""
    network = assemble(block).network
    with because("calibration on the job"):
        return calibration_of(factored(network, adjust(network).state))


def calibration_of(at: Factored) -> Calibration:
    """Keep camera and mounting of an adjusted network, with their joint covariance."""
    columns = [at.problem.layout.common_columns[:STRIPS]]
    for active, where in at.problem.layout.camera_columns:
        camera_columns = np.full(len(PARAMETERS), -1)
        camera_columns[active] = where
        columns.append(camera_columns)
    column = np.concatenate(columns)
    unknown = np.flatnonzero(column >= 0)
    covariance = np.zeros((len(column), len(column)))
    if len(unknown):
        inverse = border_inverse(at.problem.layout.envelope, at.normal.matrix)
        square = np.ix_(unknown, unknown)
        covariance[square] = blocks(column[unknown][None, :], at.problem.structure, inverse)[0]
    return Calibration(at.state.cameras, at.state.common[:STRIPS], covariance)


def leaves_open(block: Block) -> bool:
    """Whether nothing states a value of mounting or camera, or how well it is known: then it is unknown."""
    mounted = bool(len(block.positions.image) and len(block.attitudes.image))
    unknown = [camera.estimated & np.isinf(camera.prior_sigma) for camera in block.cameras]
    return bool(np.any(unknown)) or (mounted and bool(np.isinf(block.mounting.sigma[:STRIPS]).any()))


def with_calibration(block: Block, calibration: Calibration) -> Block:
    """Return a block with camera and mounting of a calibration of its own flight, or one made `on_flight`."""
    if len(calibration.cameras) != len(block.cameras):
        raise ConfigurationError(
            f"the calibration has {len(calibration.cameras)} cameras, the block {len(block.cameras)}",
            where=block.name,
            remedy="take the calibration of the same rig",
        )
    cameras = tuple(
        camera.with_values(values) for camera, values in zip(block.cameras, calibration.cameras, strict=True)
    )
    values = block.mounting.values.copy()
    values[:STRIPS] = calibration.mounting
    return replace(block, cameras=cameras, mounting=replace(block.mounting, values=values))


def joint_covariance(calibration: Calibration, common: int) -> Floats:
    """Give the covariance of all common values of a block and its cameras."""
    size = len(calibration.covariance)
    at = np.concatenate([np.arange(STRIPS), common + np.arange(size - STRIPS)])
    joint = np.zeros((common + size - STRIPS, common + size - STRIPS))
    joint[np.ix_(at, at)] = calibration.covariance
    return joint


@dataclass(frozen=True)
class DirectOrientation:
    """Exterior orientation that no image observation has touched.

    rotation (n, 3, 3): object to camera axes.
    covariance (n, 6, 6): of a small turn in camera axes (rad) and of the centre (m), from each exposure's own
        errors.
    by_common (n, 6, k): derivative with respect to the common values of the mounting.
    common_covariance (k, k): of those, from the sigmas that the block states.
    """

    known: Flags
    rotation: Floats
    centre: Floats
    covariance: Floats
    by_common: Floats
    common_covariance: Floats


def direct_orientation(block: Block) -> DirectOrientation:
    """Exterior orientation of the images of a block from its position and attitude observations.

    returns: X0 = A - M' B l + v dt - s - d t and M = B R, see `photocal.adjustment.mounting`.
    """
    count, common = len(block.images.names), len(block.mounting.values)
    rotation = matrix_from_angles(block.images.values[:, :3])
    centre = block.images.values[:, 3:].copy()
    complete = np.asarray(np.isfinite(block.images.sigma).all(axis=1))
    covariance = np.zeros((count, 6, 6))
    sigma = np.where(complete[:, None], block.images.sigma, 0.0)
    turn = turn_per_angle(block.images.values[:, :3])
    covariance[:, :3, :3] = turn @ (sigma[:, :3, None] ** 2 * np.swapaxes(turn, 1, 2))
    covariance[:, range(3, 6), range(3, 6)] = sigma[:, 3:] ** 2
    by_common = np.zeros((count, 6, common))
    known = complete
    positions, attitudes, mounting = block.positions, block.attitudes, block.mounting
    row_p = {int(i): k for k, i in enumerate(positions.image)}
    row_a = {int(i): k for k, i in enumerate(attitudes.image)}
    matrix = body_to_camera(mounting, mounting.values)
    arm = matrix @ mounting.values[LEVER]
    for i in sorted(row_p.keys() & row_a.keys()):
        p, a = row_p[i], row_a[i]
        m = matrix @ attitudes.rotation[a]
        at = STRIPS + 6 * int(positions.strip[p])
        velocity, elapsed = positions.velocity[p], positions.time[p]
        raised = np.array([0.0, 0.0, positions.above[p]])
        shift = mounting.values[at : at + 3] + elapsed * mounting.values[at + 3 : at + 6]
        shift = shift + mounting.values[SHIFT] + raised * mounting.values[HEIGHT_SCALE]
        rotation[i] = m
        centre[i] = positions.values[p] - m.T @ arm + velocity * mounting.values[TIME] - shift
        # Rows: the turn of the camera, the projection centre; columns: turn of the body, antenna.
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = matrix
        jacobian[3:, :3] = -m.T @ skew(arm) @ matrix
        jacobian[3:, 3:] = np.eye(3)
        measured = np.zeros((6, 6))
        measured[:3, :3], measured[3:, 3:] = attitudes.covariance[a], positions.covariance[p]
        covariance[i] = jacobian @ measured @ jacobian.T
        by_common[i, :3, BORESIGHT] = left_jacobian(mounting.values[BORESIGHT])
        by_common[i, 3:, LEVER] = -m.T @ matrix
        by_common[i, 3:, TIME] = velocity
        by_common[i, 3:, SHIFT] = -np.eye(3)
        by_common[i, 3:, HEIGHT_SCALE] = -raised
        by_common[i, 3:, at : at + 3] = -np.eye(3)
        by_common[i, 3:, at + 3 : at + 6] = -elapsed * np.eye(3)
        known[i] = True
    stated = np.where(np.isfinite(mounting.sigma), mounting.sigma, 0.0)
    return DirectOrientation(known, rotation, centre, covariance, by_common, np.diag(stated**2))


@dataclass(frozen=True)
class MovedRays:
    """Poses of a block's observations.

    rotation (n, 3, 3), centre (n, 3): of the line in which each was recorded.
    late (n,): when it was read, in readouts from the middle.
    by_readout (n, 6): derivative of turn (camera axes) and centre with respect to the readout.
    spread (images, 6): sigmas of turn and centre during the whole readout.
    """

    rotation: Floats
    centre: Floats
    late: Floats
    by_readout: Floats
    spread: Floats


def moved_rays(block: Block, orientation: DirectOrientation) -> MovedRays:
    """Poses of all observations, moved as their images move."""
    image, camera = block.observations.image, block.images.camera
    readout = np.array([interior.values[READOUT] for interior in block.cameras])[camera][:, None]
    motion, sigma = (np.nan_to_num(part) for part in (block.images.motion, block.images.motion_sigma))
    views = oriented_images(block.cameras, camera, orientation.rotation, orientation.centre)
    views = replace(views, movement=motion * readout)
    pixels = observed_pixels(block)
    rotation, centre = views.at_lines(image, pixels)
    late = views.late(image, pixels)
    by_readout = np.hstack([turned(motion[image], late[:, None]), late[:, None] * motion[image][:, :3]])
    return MovedRays(rotation, centre, late, by_readout, (sigma * np.abs(readout))[:, np.r_[3:6, :3]])

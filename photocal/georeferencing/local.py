"""A block in its own local Cartesian frame, its exteriors as antenna positions and body attitudes."""

from dataclasses import replace

import numpy as np

from photocal.adjustment.mounting import NO_MOUNTING, STRIPS, Attitudes, Mounting, Positions, body_to_camera
from photocal.adjustment.network import covariance_matrices
from photocal.block.model import Block, ObjectPoints
from photocal.block.network import block_frame, local_positions
from photocal.geometry.frames import LocalFrame
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles, turn_per_angle


def in_local_frame(block: Block) -> Block:
    """Return the block in topocentric coordinates (east, north, up) at its middle.

    Everything that is compared here is in metres along axes at right angles: differences of map
    coordinates would carry the scale of the projection.

    returns: the same block when its frame is local already.
    raises ConfigurationError: for an unknown system, or heights of a kind that does not fit it.
    """
    if block.frame == "local":
        return block
    frame = block_frame(block)
    given = block.images.values
    # Velocities along other axes; rates are about those of the camera.
    motion = block.images.motion.copy()
    motion[:, :3] = np.einsum("nab,nb->na", frame.derivative(given[:, 3:]), motion[:, :3])
    return replace(
        block,
        frame="local",
        height="local",
        images=replace(block.images, values=local_poses(frame, given), motion=motion),
        points=_points(block.points, frame),
        positions=local_positions(block.positions, frame),
    )


def _points(points: ObjectPoints, frame: LocalFrame) -> ObjectPoints:
    """Points with their covariance, where all three coordinates have a sigma."""
    whole = np.isfinite(points.sigma).all(axis=1) & np.isfinite(points.values).all(axis=1)
    given = np.zeros_like(points.values) if points.cross is None else points.cross
    by_given = frame.derivative(points.values[whole])
    matrix = by_given @ covariance_matrices(points.sigma[whole], given[whole]) @ np.swapaxes(by_given, 1, 2)
    sigma, cross = points.sigma.copy(), given.copy()
    sigma[whole] = np.sqrt(np.diagonal(matrix, axis1=1, axis2=2))
    cross[whole] = np.stack([matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2]], axis=1)
    held = (sigma == 0).any(axis=1)
    cross[held] = 0.0
    return replace(points, values=frame.to_local(points.values), sigma=sigma, cross=cross)


def as_mounted(block: Block) -> Block:
    """Return the block with observed elements of images.csv as positions and attitudes."""
    if len(block.positions.image) or len(block.attitudes.image):
        return block
    sigma, values = block.images.sigma, block.images.values
    weighted = np.isfinite(sigma) & (sigma > 0)
    placed, turned = (np.flatnonzero(weighted[:, part].all(axis=1)) for part in (slice(3, 6), slice(0, 3)))
    if not len(placed):
        return block
    count = len(placed)
    covariance = np.zeros((count, 3, 3))
    covariance[:, range(3), range(3)] = sigma[placed, 3:] ** 2
    zero = np.zeros(count, dtype=np.int64)
    none = np.zeros(count)
    positions = Positions(placed, values[placed, 3:], covariance, np.zeros((count, 3)), zero, none, none)
    to_body = NO_MOUNTING.rotation.T
    by_angle = to_body @ turn_per_angle(values[turned, :3])
    attitudes = Attitudes(
        turned,
        to_body @ matrix_from_angles(values[turned, :3]),
        by_angle @ (sigma[turned, :3, None] ** 2 * np.swapaxes(by_angle, 1, 2)),
    )
    left = sigma.copy()
    left[placed, 3:] = np.inf
    left[turned, :3] = np.inf
    held = np.zeros(STRIPS + 6)
    return replace(
        block,
        images=replace(block.images, sigma=left),
        positions=positions,
        attitudes=attitudes,
        mounting=Mounting(NO_MOUNTING.rotation, held, held),
    )


def with_attitude_angles(block: Block) -> Block:
    """Return the block with start angles of the images from their attitudes, where there are any."""
    if not len(block.attitudes.image):
        return block
    matrix = body_to_camera(block.mounting, block.mounting.values)
    values = block.images.values.copy()
    values[block.attitudes.image, :3] = angles_from_matrix(matrix @ block.attitudes.rotation)
    return replace(block, images=replace(block.images, values=values))

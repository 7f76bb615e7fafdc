"""A block of a coordinate reference system as one in its own local Cartesian frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.network import covariance_matrices
from photocal.block.model import Block, ObjectPoints
from photocal.block.network import block_frame
from photocal.geometry.frames import Frame, nearest_rotation
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles


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
    values = block.images.values.copy()
    by_image = frame.derivative(values[:, 3:])
    turn = nearest_rotation(by_image)
    values[:, :3] = angles_from_matrix(matrix_from_angles(values[:, :3]) @ np.swapaxes(turn, 1, 2))
    values[:, 3:] = frame.to_local(values[:, 3:])
    positions = block.positions
    if len(positions.image):
        by_given = frame.derivative(positions.values)
        positions = replace(
            positions,
            values=frame.to_local(positions.values),
            covariance=by_given @ positions.covariance @ np.swapaxes(by_given, 1, 2),
            velocity=np.einsum("nab,nb->na", by_given, positions.velocity),
        )
    return replace(
        block,
        frame="local",
        height="local",
        images=replace(block.images, values=values, motion=_turned(block.images.motion, by_image)),
        points=_points(block.points, frame),
        positions=positions,
    )


def _turned(motion: Floats, by_given: Floats) -> Floats:
    """Velocities along other axes; rates are about those of the camera."""
    return np.hstack([np.einsum("nab,nb->na", by_given, motion[:, :3]), motion[:, 3:]])


def _points(points: ObjectPoints, frame: Frame) -> ObjectPoints:
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

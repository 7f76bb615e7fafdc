"""The observed exteriors of a block as antenna positions and body attitudes, whatever table they stand in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from photocal.adjustment.mounting import (
    NO_MOUNTING,
    STRIPS,
    Attitudes,
    Mounting,
    Positions,
    body_to_camera,
)
from photocal.block.model import Block
from photocal.geometry.rotation import matrix_from_angles, turn_per_angle


def as_mounted(block: Block) -> Block:
    """Return the block with observed elements of images.csv as positions and attitudes.

    Only so can a lever arm, a boresight or a shift be estimated from them. Blocks that have
    positions or attitudes of their own are left as they are.
    """
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
    from photocal.geometry.rotation import angles_from_matrix

    if not len(block.attitudes.image):
        return block
    matrix = body_to_camera(block.mounting, block.mounting.values)
    values = block.images.values.copy()
    values[block.attitudes.image, :3] = angles_from_matrix(matrix @ block.attitudes.rotation)
    return replace(block, images=replace(block.images, values=values))

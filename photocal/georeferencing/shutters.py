"""Poses of rays whose lines a rolling shutter reads at different times."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Floats, Integers
from photocal.adjustment.readout import READOUT
from photocal.block.model import Block
from photocal.block.network import observed_plane
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.oriented_images import oriented_images
from photocal.georeferencing.direct import DirectOrientation


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
    readout = np.array([own.values[READOUT] for own in block.cameras])[camera][:, None]
    motion, sigma = (np.nan_to_num(part) for part in (block.images.motion, block.images.motion_sigma))
    views = oriented_images(block.cameras, camera, orientation.rotation, orientation.centre)
    views = replace(views, movement=motion * readout)
    pixels = _pixels(block, image, camera)
    rotation, centre = views.at_lines(image, pixels)
    late, turn_first = views.late(image, pixels), np.r_[3:6, :3]
    return MovedRays(
        rotation,
        centre,
        late,
        late[:, None] * motion[image][:, turn_first],
        (sigma * np.abs(readout))[:, turn_first],
    )


def _pixels(block: Block, image: Integers, camera: Integers) -> Floats:
    size = np.array([own.size_px for own in block.cameras], dtype=float)[camera[image]]
    pitch = np.array([own.pitch for own in block.cameras], dtype=float)[camera[image]]
    return plane_to_pixel(size, pitch, observed_plane(block)[0])

"""A whole project of another program: its block as it was measured, and what the program says of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from drivers.arrays import Floats
from photocal.block.model import ROLES, Block, Observations
from photocal.exchange.reconstruction import of_block
from photocal.geometry.camera import Camera

# Sigmas of control points that nobody has given, X, Y, Z, m.
ASSUMED_M = (0.02, 0.02, 0.03)
# Affinities below are what a quotient of equal focal lengths leaves.
_NOTHING = 1e-9


@dataclass(frozen=True)
class ForeignProject:
    """What was read.

    block: observations in px; cameras and orientations are the program's results, control is as surveyed.
    position (images, 3): observed by GNSS, in the block's frame; NaN without.
    position_sigma (images, 3): as typed or stated; NaN without.
    pose_sigma (images, 6): that the program promises (rad, m); NaN without.
    adjusted: coordinates of control and check points as the program adjusted them.
    cameras: as the program adjusted them, where the block has its start values; else empty.
    camera_sigma: that the program promises, by camera and parameter.
    weighted: whether the program states sigmas of image coordinates.
    """

    program: str
    block: Block
    position: Floats
    position_sigma: Floats
    pose_sigma: Floats
    adjusted: dict[str, Floats] = field(default_factory=dict)
    cameras: tuple[Camera, ...] = ()
    camera_sigma: dict[str, dict[str, float]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    weighted: bool = False


def bare_project(program: str, block: Block, *, weighted: bool) -> ForeignProject:
    """Take a block of which the program says nothing more."""
    none = np.full((len(block.images.names), 6), np.nan)
    return ForeignProject(program, in_pixels(block), none[:, :3], none[:, :3], none, weighted=weighted)


def in_pixels(block: Block) -> Block:
    """Give a block's observations in px of the stored grid, with their sigmas."""
    seen = block.observations
    if (seen.unit, seen.axes) == ("px", "pixel"):
        return block
    pitch = np.array([own.pitch for own in block.cameras])[block.images.camera[seen.image]]
    sigma = seen.sigma / pitch if seen.unit == "mm" else seen.sigma
    values = of_block(block).pixels
    return replace(block, observations=Observations("px", "pixel", seen.image, seen.point, values, sigma))


def estimating_what_it_has(block: Block, *, weighted: bool) -> Block:
    """Estimate what the program's camera has that is not zero; with set-ups what they say is estimated."""
    from photocal.geometry.camera import PARAMETERS

    rest = np.where([name in ("B1", "B2") for name in PARAMETERS], _NOTHING, 0.0)
    cameras = tuple(
        own if weighted and own.estimated.any() else replace(own, estimated=np.abs(own.values) > rest)
        for own in block.cameras
    )
    return replace(block, cameras=cameras)


def without_weak_points(block: Block) -> tuple[Block, int]:
    """Leave out tie and check points with one ray; control may have one."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    keep = (rays >= 2) | ((block.points.role == ROLES.index("control")) & (rays >= 1))
    seen = block.observations.only(keep[block.observations.point])
    seen = replace(seen, point=(np.cumsum(keep) - 1)[seen.point])
    return replace(block, points=block.points.only(keep), observations=seen), int((~keep).sum())

"""A project of another program, as it was read: what every reader of a format gives."""

from dataclasses import dataclass, field, replace

import numpy as np

from photocal.base.arrays import Floats
from photocal.block.model import ROLES, Block
from photocal.block.network import observed_pixels
from photocal.geometry.camera import Camera, among

# Sigmas of control points that nobody has given, X, Y, Z, m.
ASSUMED_M = (0.02, 0.02, 0.03)
# Affinities below are what a quotient of equal focal lengths leaves.
_NOTHING = 1e-9
# A principal point this near to the middle, px, was assumed there; what an adjustment then estimates.
_MIDDLE_PX, _USUAL = 0.501, ("c", "x0", "y0", "K1", "K2", "P1", "P2")


@dataclass(frozen=True)
class ForeignProject:
    """What was read; what a program does not say is NaN.

    block: cameras and orientations are the program's results, control is as surveyed.
    position (images, 3): observed by GNSS, in the block's frame.
    position_sigma (images, 3): as typed or stated.
    pose_sigma (images, 6): that the program promises (rad, m).
    adjusted: coordinates of control and check points as the program adjusted them.
    cameras: as the program adjusted them, where the block has its start values; else empty.
    camera_sigma: that the program promises, by camera and parameter.
    weighted: whether the program states sigmas of image coordinates.
    normalised: whether its distortion is one of coordinates divided by the principal distance.
    """

    program: str
    block: Block
    position: Floats = field(default_factory=lambda: np.empty((0, 3)))
    position_sigma: Floats = field(default_factory=lambda: np.empty((0, 3)))
    pose_sigma: Floats = field(default_factory=lambda: np.empty((0, 6)))
    adjusted: dict[str, Floats] = field(default_factory=dict)
    cameras: tuple[Camera, ...] = ()
    camera_sigma: dict[str, dict[str, float]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    weighted: bool = False
    normalised: bool = False

    def __post_init__(self) -> None:
        """Fill what is not known."""
        count = len(self.block.images.names)
        for name, columns in (("position", 3), ("position_sigma", 3), ("pose_sigma", 6)):
            if len(getattr(self, name)) != count:
                object.__setattr__(self, name, np.full((count, columns), np.nan))


def in_pixels(block: Block) -> Block:
    """Give a block's observations in px of the stored grid, with their sigmas."""
    seen = block.observations
    if (seen.unit, seen.axes) == ("px", "pixel"):
        return block
    pitch = np.array([camera.pitch for camera in block.cameras])[block.images.camera[seen.image]]
    sigma = seen.sigma / pitch if seen.unit == "mm" else seen.sigma
    seen = replace(seen, unit="px", axes="pixel", values=observed_pixels(block), sigma=sigma)
    return replace(block, observations=seen)


def never_estimated(block: Block) -> tuple[str, ...]:
    """Cameras that the program left as assumed: no distortion, the principal point in the middle."""
    return tuple(camera.id for camera in block.cameras if _as_assumed(camera))


def _as_assumed(camera: Camera) -> bool:
    middle = np.abs(camera.values[among("x0", "y0")]) < _MIDDLE_PX * np.array(camera.pitch)
    return bool(middle.all() and (np.abs(camera.values[~among("c", "x0", "y0")]) < _NOTHING).all())


def free_nonzero_parameters(block: Block, *, weighted: bool) -> Block:
    """Estimate what the program's camera has that is not zero; with set-ups what they say is estimated.

    Of a camera that was never estimated what is usual.
    """
    rest = np.where(among("B1", "B2"), _NOTHING, 0.0)
    cameras = tuple(
        camera
        if weighted and camera.estimated.any()
        else replace(
            camera, estimated=among(*_USUAL) if _as_assumed(camera) else np.abs(camera.values) > rest
        )
        for camera in block.cameras
    )
    return replace(block, cameras=cameras)


def without_weak_points(block: Block) -> tuple[Block, int]:
    """Leave out tie and check points with one ray; control may have one."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    keep = (rays >= 2) | ((block.points.role == ROLES.index("control")) & (rays >= 1))
    return block.of_points(keep), int((~keep).sum())

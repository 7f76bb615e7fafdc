"""What is written for other programs: a result as a block, and what formats are told beside it.

Cameras, orientations and points of such a block are the adjusted ones, with their standard deviations; its
observations are those that took part, in pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import GeodeticPlace
from photocal.block.model import ROLES, Block, Images, ObjectPoints
from photocal.block.network import frame_of
from photocal.exchange.parts import pixels as pixels_of
from photocal.geometry.camera import among, plane_to_pixel
from photocal.geometry.frames import parsed, reference_frame, require_geoid
from photocal.geometry.oriented_images import local_poses
from photocal.results.result import Result

Angle = Literal["deg", "gon"]


@dataclass(frozen=True)
class Choices:
    """What some formats must be told.

    origin: where a local frame touches the ellipsoid.
    changed_utc: time that a file may note as that of its making.
    residuals_px (rays, 2): of the block's observations, computed minus measured; empty where they are not
        known.
    """

    angle_unit: Angle | None = None
    origin: GeodeticPlace | None = None
    changed_utc: str = "1970-01-01T00:00:00.000Z"
    residuals_px: Floats = field(default_factory=lambda: np.empty((0, 2)))

    def residuals_of(self, given: Block) -> Floats:
        """Residuals of a block's observations, px; NaN where they are not known."""
        like = given.observations.values
        return self.residuals_px if len(self.residuals_px) == len(like) else np.full(like.shape, np.nan)


def of_result(result: Result) -> tuple[Block, Floats]:
    """Take what other programs know out of a result: a block, and the residuals of its observations, px.

    Others hold one pose for all lines: image coordinates of a rolling shutter become those at the pose of
    the middle line.

    raises ConfigurationError: for a lens that varies from image to image or with the distance.
    """
    for camera in result.cameras.values():
        if camera.photo_variant or camera.focus_m:
            what = (
                f"{', '.join(camera.photo_variant)} from image to image"
                if camera.photo_variant
                else "distortion with the distance"
            )
            raise ConfigurationError(
                f"camera {camera.id} varies its {what}: formats of other programs allow one lens only",
                "adjust with a lens that does not vary, then export that run",
            )
    images, points, rays = result.images, result.points, result.residuals.accepted
    place = {name: j for j, name in enumerate(points.names)}
    point = np.array([place.get(name, -1) for name in rays.point_names], dtype=np.int64)[rays.point]
    camera_of = images.camera[rays.image]
    size = np.array([camera.size_px for camera in images.cameras], dtype=float)[camera_of]
    pitch = np.array([camera.pitch for camera in images.cameras])[camera_of]
    per_px = pitch if result.block.observation_unit == "mm" else np.ones_like(pitch)
    residuals = rays.residual / per_px
    pixels = rays.measured / per_px
    if result.block.observation_axes == "photo":
        pixels, residuals = plane_to_pixel(size, per_px, rays.measured), residuals * [1.0, -1.0]
    if images.movement is not None:
        frame = frame_of(result.block.frame, result.block.height, images.station, points.values)
        moving, seen = images.in_local(frame), frame.to_local(points.values)[point]
        still = replace(moving, movement=None)
        pixels = pixels + still.project(rays.image, seen) - moving.project(rays.image, seen)
    # Cameras as they are when the effect of their readouts is taken off the observations.
    estimated = (camera.estimated & ~among("readout") for camera in images.cameras)
    cameras = tuple(
        replace(camera.changed(readout=0.0), estimated=free, shutter="global")
        for camera, free in zip(images.cameras, estimated, strict=True)
    )
    role = np.array([ROLES.index(word) for word in points.role], dtype=np.int64)
    block = result.block
    return Block(
        block.name,
        block.frame,
        block.height,
        "free" if block.datum == "free" else "control",
        cameras,
        Images(images.names, images.camera, images.values, images.sigma),
        ObjectPoints(points.names, points.values, points.sigma, role),
        pixels_of(rays.image, point, pixels),
    ), residuals


def to_cartesian(given: Block) -> Block:
    """Take a block to the topocentric frame at its middle; a local frame stays as it is."""
    if given.frame == "local":
        return given
    require_geoid(given.frame, given.height)
    frame = reference_frame(given.frame, given.height, middle(given))
    return replace(
        given,
        frame="local",
        height="",
        images=replace(given.images, values=local_poses(frame, given.images.values)),
        points=replace(given.points, values=frame.to_local(given.points.values)),
    )


def middle(given: Block) -> Floats:
    """Where the topocentric frame of a block has its origin, in the block's coordinates, shape (3,)."""
    return np.asarray(np.nanmean(np.vstack([given.images.values[:, 3:], given.points.values]), axis=0))


def to_wgs84(given: Block) -> Callable[[Floats], Floats]:
    """Make the way from the topocentric frame of `to_cartesian` to WGS 84."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    def turn(xyz: Floats) -> Floats:
        """Return coordinates (n, 3) of the other system."""
        x, y, z = frame.to_given(xyz).T
        return np.column_stack(transformer.transform(x, y, z, errcheck=True)).reshape(-1, 3)

    require_geoid(given.frame, given.height)
    frame = reference_frame(given.frame, given.height, middle(given))
    system = parsed(frame.crs)
    try:
        source = system if len(system.axis_info) == 3 else system.to_3d()
        transformer = Transformer.from_crs(
            source, "EPSG:4979", always_xy=True, allow_ballpark=False, only_best=True
        )
        turn(np.zeros((1, 3)))
    except ProjError as failure:
        raise ConfigurationError(
            f"no transformation is known from {given.frame} to WGS 84 ({failure})",
            "install the grids of PROJ, or export a format that keeps the block's own coordinates",
        ) from failure
    return turn


def file_name(name: str) -> str:
    """A name that stays inside the folder: letters, digits and a few signs."""
    kept = "".join(letter if letter.isalnum() or letter in "-_. " else "_" for letter in name)
    return kept.strip(". ") or "camera"

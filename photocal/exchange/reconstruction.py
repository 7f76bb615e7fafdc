"""What is written for other programs: cameras, oriented images, points and measurements of a result."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import GeodeticPlace
from photocal.block.model import ROLES, Block, Images, ObjectPoints
from photocal.block.network import frame_of, observed_pixels
from photocal.block.rig import Head
from photocal.exchange.parts import block, pixels
from photocal.geometry.camera import Camera, among, plane_to_pixel
from photocal.geometry.frames import parsed, reference_frame, require_geoid
from photocal.geometry.oriented_images import local_poses
from photocal.results.result import Result

Angle = Literal["deg", "gon"]


@dataclass(frozen=True)
class Choices:
    """What some formats must be told.

    origin: where a local frame touches the ellipsoid.
    changed_utc: time that a file may note as that of its making.
    """

    angle_unit: Angle | None = None
    origin: GeodeticPlace | None = None
    changed_utc: str = "1970-01-01T00:00:00.000Z"


@dataclass(frozen=True)
class Reconstruction:
    """Oriented images and the points that they see.

    image_camera (images,): index into the cameras; -1 when a file does not say.
    poses (images, 6): omega, phi, kappa in radians, X, Y, Z in m.
    xyz (points, 3): m.
    image, point (rays,).
    pixels (rays, 2): column and row as measured; the centre of the upper-left pixel is (0, 0).
    roles: control, check or tie for each point; empty when not known.
    pose_sigma, xyz_sigma, residuals_px: like `poses` (radians, m), `xyz` and `pixels`; residuals computed
        minus measured. NaN where unknown, and where they are not given.
    frame, height: "local", or a coordinate reference system with the kind of its heights, as in a block
        folder.
    heads, exposure: cameras on a frame, and the exposure of each image (empty for one by itself).
    """

    cameras: tuple[Camera, ...]
    image_names: tuple[str, ...]
    image_camera: Integers
    poses: Floats
    point_names: tuple[str, ...]
    xyz: Floats
    image: Integers
    point: Integers
    pixels: Floats
    roles: tuple[str, ...] = ()
    pose_sigma: Floats = field(default_factory=lambda: np.empty((0, 6)))
    xyz_sigma: Floats = field(default_factory=lambda: np.empty((0, 3)))
    residuals_px: Floats = field(default_factory=lambda: np.empty((0, 2)))
    frame: str = "local"
    height: str = ""
    name: str = "block"
    heads: tuple[Head, ...] = ()
    exposure: tuple[str, ...] = ()

    def of_role(self, *roles: str) -> list[int]:
        """Points that play one of some roles."""
        return [j for j, role in enumerate(self.roles) if role in roles]

    @property
    def rays_of_images(self) -> list[Integers]:
        """Rays of each image, in their order."""
        return _members(self.image, len(self.image_names))

    @property
    def rays_of_points(self) -> list[Integers]:
        """Rays of each point, in their order."""
        return _members(self.point, len(self.point_names))

    def of_rays(self, name: Literal["size_px", "pitch"]) -> Floats:
        """What the camera of each ray has, x and y, shape (rays, 2)."""
        each = np.array([getattr(camera, name) for camera in self.cameras], dtype=float).reshape(-1, 2)
        return np.asarray(each[self.image_camera[self.image]])

    def __post_init__(self) -> None:
        likes = {"pose_sigma": self.poses, "xyz_sigma": self.xyz, "residuals_px": self.pixels}
        for name, like in likes.items():
            if len(getattr(self, name)) != len(like):
                object.__setattr__(self, name, np.full(like.shape, np.nan))


def _members(group: Integers, count: int) -> list[Integers]:
    order = np.argsort(group, kind="stable")
    return np.split(order, np.searchsorted(group[order], np.arange(1, count))) if count else []


def as_block(given: Reconstruction, name: str, sigma_px: float, files: Sequence[Path]) -> Block:
    """Make a block of a reconstruction: orientations and points as start values."""
    role = np.array([ROLES.index(word) for word in given.roles], dtype=np.int64)
    made = block(
        name,
        given.cameras,
        Images(given.image_names, given.image_camera, given.poses, exposure=given.exposure),
        ObjectPoints(given.point_names, given.xyz, given.xyz_sigma, role),
        pixels(given.image, given.point, given.pixels, sigma_px),
        files,
    )
    return replace(made, frame=given.frame, height=given.height, heads=given.heads)


def of_block(given: Block) -> Reconstruction:
    """Take what other programs know out of a block, the inverse of `as_block`."""
    images, points, seen = given.images, given.points, given.observations
    return Reconstruction(
        given.cameras,
        images.names,
        images.camera,
        images.values,
        points.names,
        points.values,
        seen.image,
        seen.point,
        observed_pixels(given) if len(seen.image) else seen.values,
        tuple(ROLES[k] for k in points.role),
        xyz_sigma=np.where(np.isfinite(points.sigma), points.sigma, np.nan),
        frame=given.frame,
        height=given.height,
        name=given.name,
        heads=given.heads,
        exposure=images.exposure,
    )


def of_result(result: Result) -> Reconstruction:
    """Take what other programs know out of a result: the observations that took part, in pixels.

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
    return Reconstruction(
        cameras,
        images.names,
        images.camera,
        images.values,
        points.names,
        points.values,
        rays.image,
        point,
        pixels,
        points.role,
        images.sigma,
        points.sigma,
        residuals,
        result.block.frame,
        result.block.height,
        result.block.name,
    )


def to_cartesian(given: Reconstruction) -> Reconstruction:
    """Take a block to the topocentric frame at its middle; a local frame stays as it is."""
    if given.frame == "local":
        return given
    require_geoid(given.frame, given.height)
    frame = reference_frame(given.frame, given.height, middle(given))
    return replace(
        given, frame="local", height="", poses=local_poses(frame, given.poses), xyz=frame.to_local(given.xyz)
    )


def middle(given: Reconstruction) -> Floats:
    """Where the topocentric frame of a block has its origin, in the block's coordinates, shape (3,)."""
    return np.asarray(np.nanmean(np.vstack([given.poses[:, 3:], given.xyz]), axis=0))


def to_wgs84(given: Reconstruction) -> Callable[[Floats], Floats]:
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

"""What programs pass around: cameras, oriented images, points and measurements; read from a run folder."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.model import ROLES, Block, Images, InputFile, ObjectPoints, Observations
from photocal.block.network import frame_of, observed_pixels
from photocal.block.rig import Head
from photocal.exchange.source import fingerprint
from photocal.geometry.camera import Camera, among, plane_to_pixel
from photocal.geometry.frames import parsed, reference_frame
from photocal.geometry.oriented_images import local_poses
from photocal.results.result import Result

Angle = Literal["deg", "gon"]
UNIT_SIGMA_PX = 1.0
# Sigmas of control points that nobody has given, X, Y, Z, m.
ASSUMED_M = (0.02, 0.02, 0.03)
# Affinities below are what a quotient of equal focal lengths leaves.
_NOTHING = 1e-9


@dataclass(frozen=True)
class Origin:
    """Where a local frame touches the ellipsoid; `height_m`: ellipsoidal."""

    latitude_deg: float
    longitude_deg: float
    height_m: float


@dataclass(frozen=True)
class Choices:
    """What some formats must be told.

    changed_utc: time that a file may note as that of its making.
    """

    angle_unit: Angle | None = None
    origin: Origin | None = None
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

    def __post_init__(self) -> None:
        likes = {"pose_sigma": self.poses, "xyz_sigma": self.xyz, "residuals_px": self.pixels}
        for name, like in likes.items():
            if len(getattr(self, name)) != len(like):
                object.__setattr__(self, name, np.full(like.shape, np.nan))


def as_block(given: Reconstruction, name: str, sigma_px: float, inputs: tuple[InputFile, ...]) -> Block:
    """Make a block of a reconstruction: orientations and points as start values."""
    count = len(given.point_names)
    role = np.array([ROLES.index(word) for word in given.roles or ("tie",) * count], dtype=np.int64)
    sigma = np.full((count, 3), np.inf)
    surveyed = (role != ROLES.index("tie")) & np.isfinite(given.xyz).all(axis=1)
    known = surveyed & np.isfinite(given.xyz_sigma).all(axis=1)
    sigma[known] = given.xyz_sigma[known]
    # What is called control without a standard deviation holds nothing.
    bare = (role == ROLES.index("control")) & ~np.isfinite(sigma).all(axis=1)
    role[bare] = ROLES.index("tie")
    return Block(
        name,
        given.frame,
        given.height,
        "control" if (role == ROLES.index("control")).any() else "free",
        given.cameras,
        Images(given.image_names, given.image_camera, given.poses, exposure=given.exposure),
        ObjectPoints(given.point_names, given.xyz, sigma, role),
        Observations(
            "px", "pixel", given.image, given.point, given.pixels, np.full(given.pixels.shape, sigma_px)
        ),
        inputs,
        heads=given.heads,
    )


def of_block(block: Block) -> Reconstruction:
    """Take what other programs know out of a block, the inverse of `as_block`."""
    return Reconstruction(
        block.cameras,
        block.images.names,
        block.images.camera,
        block.images.values,
        block.points.names,
        block.points.values,
        block.observations.image,
        block.observations.point,
        observed_pixels(block),
        tuple(ROLES[k] for k in block.points.role),
        xyz_sigma=np.where(np.isfinite(block.points.sigma), block.points.sigma, np.nan),
        frame=block.frame,
        height=block.height,
        name=block.name,
        heads=block.heads,
        exposure=block.images.exposure,
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
                f"camera {camera.id} varies its {what}: other programs' formats hold one lens for all",
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


def cameras_alone(cameras: Sequence[Camera]) -> Reconstruction:
    """What a file of cameras holds: no images, no points."""
    none = np.empty(0, dtype=np.int64)
    return Reconstruction(
        tuple(cameras), (), none, np.empty((0, 6)), (), np.empty((0, 3)), none, none, np.empty((0, 2))
    )


def orientations_alone(names: Sequence[str], poses: Floats) -> Reconstruction:
    """What a table of exterior orientations holds: images of unknown cameras."""
    nothing = cameras_alone(())
    return replace(
        nothing, image_names=tuple(names), image_camera=np.full(len(names), -1, dtype=np.int64), poses=poses
    )


def vision_block(name: str, given: Reconstruction, files: list[Path]) -> Block:
    """Make a block of a vision program's model, which has no standard deviations of image coordinates."""
    if not len(given.pixels):
        raise InputMalformedError("has no measurements of points", "export them too", where=files[0])
    return as_block(given, name, UNIT_SIGMA_PX, tuple(fingerprint(path) for path in files))


def to_cartesian(given: Reconstruction) -> Reconstruction:
    """Take a block to the topocentric frame at its middle; a local frame stays as it is."""
    if given.frame == "local":
        return given
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
        x, y, z = frame.to_given(xyz).T
        return np.column_stack(transformer.transform(x, y, z, errcheck=True)).reshape(-1, 3)

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
            f"no way leads from {given.frame} to WGS 84 ({failure})",
            "install the grids of PROJ, or export a format that keeps the block's own coordinates",
        ) from failure
    return turn


def file_name(name: str) -> str:
    """A name that stays inside the folder: letters, digits and a few signs."""
    kept = "".join(letter if letter.isalnum() or letter in "-_. " else "_" for letter in name)
    return kept.strip(". ") or "camera"


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
    pitch = np.array([camera.pitch for camera in block.cameras])[block.images.camera[seen.image]]
    sigma = seen.sigma / pitch if seen.unit == "mm" else seen.sigma
    values = of_block(block).pixels
    return replace(block, observations=Observations("px", "pixel", seen.image, seen.point, values, sigma))


def estimating_what_it_has(block: Block, *, weighted: bool) -> Block:
    """Estimate what the program's camera has that is not zero; with set-ups what they say is estimated."""
    rest = np.where(among("B1", "B2"), _NOTHING, 0.0)
    cameras = tuple(
        camera
        if weighted and camera.estimated.any()
        else replace(camera, estimated=np.abs(camera.values) > rest)
        for camera in block.cameras
    )
    return replace(block, cameras=cameras)


def without_weak_points(block: Block) -> tuple[Block, int]:
    """Leave out tie and check points with one ray; control may have one."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    keep = (rays >= 2) | ((block.points.role == ROLES.index("control")) & (rays >= 1))
    seen = block.observations.rows(keep[block.observations.point])
    seen = replace(seen, point=(np.cumsum(keep) - 1)[seen.point])
    return replace(block, points=block.points.only(keep), observations=seen), int((~keep).sum())

"""Pictures by casting rays: from the pixel through the lens to the ground and the plates on it.

Rays are cast on a grid of every eighth pixel, and cubic splines go through what they hit: ground and lens are
so smooth that this moves nothing by a thousandth of a pixel. (Straight lines between the nodes would move
patches of the ground by some hundredths, all alike where the lens is: a calibration feels that.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.world.camera import Camera
from acquire.simulate.world.exposures import TO_OPENCV, Pose, pose_at
from acquire.simulate.world.observations import row_time, seen_rolling
from acquire.simulate.world.plates import SAMPLES, Plate, make_plate
from acquire.simulate.world.texture import Ground, paint
from acquire.simulate.world.world import STREAMS, World
from drivers.arrays import Bytes, Floats

GRID_PX = 8


@dataclass(frozen=True)
class Scene:
    """What is to be pictured, painted once.

    grounds: for each pass, as soft as its pixels are large.
    """

    world: World
    plates: tuple[Plate, ...]
    grounds: tuple[Ground, ...]

    @cached_property
    def directions(self) -> dict[Camera, Floats]:
        """Directions of the grid of rays of each camera, OpenCV's axes, shape (rows, columns, 3)."""
        found = {}
        for camera in dict.fromkeys(self.world.exposures.cameras):
            rows, columns = np.meshgrid(_grid(camera.height), _grid(camera.width), indexing="ij")
            found[camera] = camera.directions(np.stack([columns, rows], axis=-1))
        return found


def make_scene(world: World) -> Scene:
    """Paint the ground and make the plates of a world."""
    given, targets = world.configuration, world.targets
    plates = tuple(
        make_plate(centre, turn, code, given.targets.dictionary, given.targets.side_m)
        for centre, turn, code in zip(
            targets.centre_m, targets.turn.tolist(), targets.codes.tolist(), strict=True
        )
    )
    ground = paint(world.terrain, _reach(world), given.pictures.texel_m, world.random("texture"))
    sizes = [one.height_m * given.camera.pitch_mm / given.camera.nominal_mm for one in given.plan.passes]
    return Scene(world, plates, tuple(ground.softened(size) for size in sizes))


def _reach(world: World) -> float:
    """Give how far from the origin the corners of pictures see."""
    farthest = 0.0
    pose = world.exposures.pose
    for number, camera in enumerate(world.exposures.cameras):
        corners = np.array([[c, r] for c in (0, camera.width - 1) for r in (0, camera.height - 1)])
        rays = camera.directions(corners) @ TO_OPENCV @ pose.rotation[number]
        hits = world.terrain.intersect(np.broadcast_to(pose.centre_m[number], rays.shape), rays)
        farthest = max(farthest, float(np.abs(hits[:, :2]).max()))
    return farthest + 2.0


def render(scene: Scene, number: int) -> Bytes:
    """Take a picture.

    returns (height, width, 3): blue, green, red.
    """
    import cv2

    world = scene.world
    given, exposures = world.configuration.pictures, world.exposures
    camera = exposures.cameras[number]
    grid = _cast(scene, number)
    hits = world.terrain.intersect(grid.start_m.reshape(-1, 3), grid.direction.reshape(-1, 3))
    places = hits.reshape(grid.direction.shape)
    every_row, every_column = (np.arange(size, dtype=float) for size in (camera.height, camera.width))
    east, north = (
        _between(places[..., k], every_row, every_column).astype(np.float32, order="C") for k in (0, 1)
    )
    picture = scene.grounds[int(exposures.covers[number])].seen_at(east, north)
    for plate in scene.plates:
        _lay(picture, plate, scene, number)
    picture = np.asarray(cv2.filter2D(picture, -1, _spread(scene, number)), np.uint8)
    random = np.random.default_rng([world.configuration.seed, STREAMS.index("pictures"), number])
    noise = random.standard_normal(picture.shape[:2], dtype=np.float32) * np.float32(given.noise_grey)
    exposed = picture * _light(camera, given.vignetting)[..., None]
    exposed += noise[..., None]
    return np.asarray(np.clip(np.rint(exposed), 0, 255), np.uint8)


@dataclass(frozen=True)
class _Rays:
    start_m: Floats
    direction: Floats


def _grid(size: int) -> Floats:
    """Give the nodes of the grid along one side: the last lies on or beyond the last pixel."""
    return np.arange(0, size - 1 + GRID_PX, GRID_PX, dtype=float)


def _cast(scene: Scene, number: int) -> _Rays:
    camera = scene.world.exposures.cameras[number]
    local = scene.directions[camera]
    pose = _poses(scene.world, number, _grid(camera.height))
    turned = local @ (TO_OPENCV @ pose.rotation)
    start = np.broadcast_to(pose.centre_m[:, None], turned.shape)
    return _Rays(start, turned)


def _poses(world: World, number: int, rows: Floats) -> Pose:
    """Give the pose of each row."""
    readout, pose = world.configuration.camera.readout_s, world.exposures.pose
    if readout > 0:
        return pose_at(world.motion, world.rig, row_time(world.exposures, number, rows, readout))
    count = len(rows)
    return Pose(
        np.broadcast_to(pose.centre_m[number], (count, 3)),
        np.broadcast_to(pose.rotation[number], (count, 3, 3)),
    )


def _lay(picture: Bytes, plate: Plate, scene: Scene, number: int) -> None:
    """Draw a plate into a picture."""
    world, camera = scene.world, scene.world.exposures.cameras[number]
    readout = world.configuration.camera.readout_s
    corners = seen_rolling(plate.corners_m, world.exposures, number, world.motion, world.rig, readout)
    if np.isnan(corners).any():
        return
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 2, [camera.width, camera.height])
    if (high <= low).any():
        return
    (left, top), (right, bottom) = low.tolist(), high.tolist()
    fine = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    rows = (np.arange(top, bottom)[:, None] + fine).ravel()
    columns = (np.arange(left, right)[:, None] + fine).ravel()
    nodes = scene.directions[camera]
    local = np.stack([_between(nodes[..., k], rows, columns) for k in range(3)], axis=-1)
    pose = _poses(world, number, rows)
    turned = local @ (TO_OPENCV @ pose.rotation)
    greys = plate.grey(np.broadcast_to(pose.centre_m[:, None], turned.shape), turned)
    boxes = greys.reshape(bottom - top, SAMPLES, right - left, SAMPLES)
    covered = np.isfinite(boxes).mean(axis=(1, 3))
    shown = np.nansum(boxes, axis=(1, 3)) / SAMPLES**2
    beneath = picture[top:bottom, left:right]
    mixed = beneath * (1 - covered)[..., None] + shown[..., None]
    picture[top:bottom, left:right] = np.rint(mixed).astype(np.uint8)


def _between(nodes: Floats, rows: Floats, columns: Floats) -> Floats:
    """Interpolate values at the nodes of the grid at rows and columns, shape (rows, columns)."""
    from scipy.interpolate import RectBivariateSpline

    down, across = (np.arange(size) * GRID_PX for size in nodes.shape)
    return np.asarray(RectBivariateSpline(down, across, nodes)(rows, columns))


def _spread(scene: Scene, number: int) -> NDArray[np.float32]:
    """Give how a point of light is spread: by the lens, and along its way during the exposure."""
    world = scene.world
    camera, time = world.exposures.cameras[number], world.exposures.middle_s[number]
    half = world.configuration.camera.exposure_s / 2
    pose = world.exposures.pose
    ray = np.array([[0.0, 0.0, 1.0]]) @ TO_OPENCV @ pose.rotation[number]
    ground = world.terrain.intersect(pose.centre_m[number : number + 1], ray)
    ends = pose_at(world.motion, world.rig, np.array([time - half, time + half]))
    rays = np.squeeze(ends.rotation @ (ground - ends.centre_m)[..., None], axis=-1) @ TO_OPENCV
    begin, end = camera.project(rays)
    way = (end - begin) * np.linspace(-0.5, 0.5, 21)[:, None]
    at = np.arange(-4, 5)
    sigma = max(world.configuration.pictures.blur_px, 0.05)
    columns, rows = np.meshgrid(at, at)
    apart = (columns[..., None] - way[:, 0]) ** 2 + (rows[..., None] - way[:, 1]) ** 2
    kernel = np.exp(-apart / (2 * sigma**2)).sum(axis=-1)
    return np.asarray(kernel / kernel.sum(), np.float32)


def _light(camera: Camera, fall: float) -> NDArray[np.float32]:
    """Give how much light reaches each pixel; `fall` is what is missing in the corners."""
    rows = (np.arange(camera.height) - (camera.height - 1) / 2)[:, None]
    columns = np.arange(camera.width) - (camera.width - 1) / 2
    r2 = (rows**2 + columns**2) / (((camera.height - 1) / 2) ** 2 + ((camera.width - 1) / 2) ** 2)
    return np.asarray(1 - fall * r2, np.float32)

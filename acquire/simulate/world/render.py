"""Pictures by casting rays: from the pixel through the lens to the ground and the plates on it.

Rays are cast on a grid of every eighth pixel, and cubic splines go through what they hit: ground and lens are
so smooth that this moves nothing by a thousandth of a pixel. (Straight lines between the nodes would move
patches of the ground by some hundredths, all alike where the lens is: a calibration feels that.)
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.world.camera import TrueCamera
from acquire.simulate.world.exposures import TO_OPENCV, Pose, pose_at
from acquire.simulate.world.observations import row_time, seen, seen_rolling
from acquire.simulate.world.terrain import HeightField
from acquire.simulate.world.world import STREAMS, World
from photocal.base.arrays import Bytes, Floats
from photocal.base.errors import ConfigurationError

COLOUR_M = 0.25
# Blue, green, red at the mean grey of the detail.
_SOIL, _GRASS = np.array([95.0, 125.0, 150.0]), np.array([62.0, 118.0, 96.0])
_SUN = np.array([-0.45, 0.45, 0.77])
_STONES_PER_M2, _STONE_M = 0.6, (0.03, 0.2)
_FADE, _CONTRAST = 0.82, 15.0
MEAN_GREY = 128
BLACK, WHITE = 25.0, 225.0
GRID_PX = 8


@dataclass(frozen=True)
class PaintedGround:
    """A painted square around the origin, rows from north to south.

    detail (n, n): brightness, 128 where it is that of the colour.
    texel_m: size of an element of the detail.
    colour (m, m, 3): blue, green, red at steps of `COLOUR_M`.
    """

    detail: Bytes
    texel_m: float
    colour: Bytes
    half_m: float

    def softened(self, seen_m: float) -> "PaintedGround":
        """Give the ground without detail finer than a pixel of `seen_m` on the ground can show."""
        import cv2

        sigma = 0.4 * seen_m / self.texel_m
        soft: Any = cv2.GaussianBlur(self.detail, (0, 0), sigma)
        return PaintedGround(np.asarray(soft, np.uint8), self.texel_m, self.colour, self.half_m)

    def seen_at(self, east_m: NDArray[np.float32], north_m: NDArray[np.float32]) -> Bytes:
        """Give blue, green, red at places, shape (h, w, 3)."""
        import cv2

        parts: list[Any] = []
        for picture, step in ((self.detail, self.texel_m), (self.colour, COLOUR_M)):
            column = (east_m + self.half_m) / np.float32(step) - np.float32(0.5)
            row = (self.half_m - north_m) / np.float32(step) - np.float32(0.5)
            parts.append(cv2.remap(picture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))
        detail, colour = parts
        return np.asarray(cv2.multiply(colour, cv2.merge([detail] * 3), scale=1 / MEAN_GREY), np.uint8)


def paint(terrain: HeightField, half_m: float, texel_m: float, random: np.random.Generator) -> PaintedGround:
    """Paint the ground."""
    count = int(np.ceil(2 * half_m / texel_m))
    side = count * texel_m / 2
    detail = _detail(count, random)
    _scatter(detail, texel_m, random)
    return PaintedGround(detail, texel_m, _colour(terrain, side, random), side)


def _detail(count: int, random: np.random.Generator) -> Bytes:
    """Add noise of equal strength at every octave, from a few metres down to one element."""
    import cv2

    size = 16
    noise: Any = random.standard_normal((size, size), dtype=np.float32)
    while size < count:
        size = min(2 * size, count)
        # The older octaves fade: patches of metres belong to the colours.
        noise = cv2.resize(noise * np.float32(_FADE), (size, size), interpolation=cv2.INTER_LINEAR)
        noise += random.standard_normal((size, size), dtype=np.float32)
    np.clip(noise, -4, 4, out=noise)
    return np.asarray(cv2.convertScaleAbs(noise, alpha=_CONTRAST, beta=MEAN_GREY), np.uint8)


def _scatter(detail: Bytes, texel_m: float, random: np.random.Generator) -> None:
    """Lay stones and tufts on the ground, and tracks of vehicles across it."""
    # Paths that cross the ground.
    tracks = 6
    import cv2

    count = detail.shape[0]
    stones = int(_STONES_PER_M2 * (count * texel_m) ** 2)
    centres = random.integers(0, count * 16, (stones, 2))
    low, high = np.log(_STONE_M).tolist()
    radii = np.exp(random.uniform(low, high, stones)) / texel_m
    greys = np.clip(MEAN_GREY + random.choice([-1, 1], stones) * random.uniform(25, 75, stones), 30, 225)
    for centre, radius, grey in zip(centres.tolist(), radii.tolist(), greys.tolist(), strict=True):
        cv2.circle(detail, centre, max(round(radius * 16), 8), grey, -1, cv2.LINE_AA, 4)
    for _ in range(tracks):
        ends = random.integers(0, count, (2, 2))
        middle = ends.mean(axis=0) + random.normal(0, count / 10, 2)
        share = np.linspace(0, 1, 60)[:, None]
        curve = (1 - share) ** 2 * ends[0] + 2 * share * (1 - share) * middle + share**2 * ends[1]
        width = max(round(0.25 / texel_m), 1)
        cv2.polylines(detail, [np.rint(curve).astype(np.int32)], False, 160, width, cv2.LINE_AA)


def _colour(terrain: HeightField, half_m: float, random: np.random.Generator) -> Bytes:
    import cv2

    count = int(np.ceil(2 * half_m / COLOUR_M))
    at = (np.arange(count) + 0.5) * COLOUR_M - half_m
    east, north = np.meshgrid(at, -at)
    heights = terrain.height(east.ravel(), north.ravel()).reshape(east.shape)
    fall, rise = np.gradient(heights, COLOUR_M)
    normal = np.stack([-rise, fall, np.ones_like(rise)], axis=-1)
    light = normal @ _SUN / np.linalg.norm(normal, axis=-1) / _SUN[2]
    coarse = random.standard_normal((14, 14))
    patches: Any = cv2.resize(coarse, (count, count), interpolation=cv2.INTER_CUBIC)
    grass = 1 / (1 + np.exp(-2.5 * patches))[..., None]
    colour = (grass * _GRASS + (1 - grass) * _SOIL) * np.clip(light, 0.5, 1.3)[..., None]
    return np.asarray(np.clip(colour, 0, 255), np.uint8)


@dataclass(frozen=True)
class Plate:
    """A horizontal square plate.

    centre_m (3,).
    turn: direction of its upper edge, from east towards north, rad.
    cells (k, k): grey values, the first row at the upper edge, with the light margin.
    """

    centre_m: Floats
    turn: float
    cell_m: float
    cells: Floats

    @property
    def half_m(self) -> float:
        """Half of its side."""
        return float(self.cells.shape[0] * self.cell_m / 2)

    @property
    def corners_m(self) -> Floats:
        """Its corners, shape (4, 3)."""
        corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * self.half_m
        return np.asarray(self.centre_m + np.pad(corners @ self._axes, ((0, 0), (0, 1))))

    @property
    def _axes(self) -> Floats:
        """Rows: direction of the upper edge and of the sides, in east and north."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cos, sin], [-sin, cos]])

    def grey(self, start_m: Floats, direction: Floats) -> Floats:
        """Give what rays see of it, NaN where they pass beside it, shape (n,)."""
        along = (self.centre_m[2] - start_m[..., 2]) / direction[..., 2]
        place = start_m[..., :2] + along[..., None] * direction[..., :2] - self.centre_m[:2]
        in_cells = place @ self._axes.T / self.cell_m
        count = self.cells.shape[0]
        column = np.floor(in_cells[..., 0] + count / 2).astype(np.int64)
        row = np.floor(count / 2 - in_cells[..., 1]).astype(np.int64)
        inside = (column >= 0) & (column < count) & (row >= 0) & (row < count)
        greys = self.cells[np.clip(row, 0, count - 1), np.clip(column, 0, count - 1)]
        return np.asarray(np.where(inside, greys, np.nan))


def make_plate(centre_m: Floats, turn: float, code: int, dictionary: str, side_m: float) -> Plate:
    """Make the plate of a code; `side_m` is the side of the dark border, as surveyors give it."""
    # A white margin of one cell around the code.
    margin_cells = 1
    codes = dictionary_of(dictionary)
    if code >= len(codes.bytesList):
        raise ConfigurationError(
            f"{dictionary} has no more than {len(codes.bytesList) - 1} codes for plates",
            "use fewer, or a larger dictionary",
            where="[targets]",
        )
    cells = int(codes.markerSize) + 2
    marker = codes.generateImageMarker(code, cells)
    pattern = np.where(np.asarray(marker) > 0, WHITE, BLACK)
    pattern = np.pad(pattern, margin_cells, constant_values=WHITE)
    return Plate(centre_m, turn, side_m / cells, pattern)


def dictionary_of(name: str) -> Any:
    """Give OpenCV's dictionary of a name such as ``apriltag_36h11``."""
    import cv2

    number = getattr(cv2.aruco, f"DICT_{name.upper()}", None)
    if number is None:
        raise ConfigurationError(
            f"there is no dictionary {name!r}", "for example apriltag_36h11", where="[targets]"
        )
    return cv2.aruco.getPredefinedDictionary(number)


@dataclass(frozen=True)
class PaintedScene:
    """What is to be pictured, painted once; `grounds`: for each pass, as soft as its pixels are large."""

    world: World
    plates: tuple[Plate, ...]
    grounds: tuple[PaintedGround, ...]

    @cached_property
    def directions(self) -> dict[TrueCamera, Floats]:
        """Directions of the grid of rays of each camera, OpenCV's axes, shape (rows, columns, 3)."""
        directions = {}
        for camera in dict.fromkeys(self.world.exposures.cameras):
            rows, columns = np.meshgrid(_grid(camera.height), _grid(camera.width), indexing="ij")
            directions[camera] = camera.directions(np.stack([columns, rows], axis=-1))
        return directions


def make_scene(world: World) -> PaintedScene:
    """Paint the ground and make the plates of a world."""
    given, targets = world.configuration, world.targets
    plates = tuple(
        make_plate(centre, turn, code, given.targets.dictionary, given.targets.side_m)
        for centre, turn, code in zip(
            targets.centre_m, targets.turn.tolist(), targets.codes.tolist(), strict=True
        )
    )
    ground = paint(world.terrain, _reach(world), given.pictures.texel_m, world.random("texture"))
    sizes = [pass_.height_m * given.camera.pitch_mm / given.camera.nominal_mm for pass_ in given.plan.passes]
    return PaintedScene(world, plates, tuple(ground.softened(size) for size in sizes))


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


def render(scene: PaintedScene, number: int) -> Bytes:
    """Take a picture, (height, width, 3): blue, green, red."""
    import cv2

    world = scene.world
    given, exposures = world.configuration.pictures, world.exposures
    camera = exposures.cameras[number]
    pose = _poses(world, number, _grid(camera.height))
    rays = scene.directions[camera] @ (TO_OPENCV @ pose.rotation)
    start = np.broadcast_to(pose.centre_m[:, None], rays.shape)
    places = world.terrain.intersect(start.reshape(-1, 3), rays.reshape(-1, 3)).reshape(rays.shape)
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
    row, column = ((np.arange(size) - (size - 1) / 2) for size in (camera.height, camera.width))
    r2 = (row[:, None] ** 2 + column**2) / (row[0] ** 2 + column[0] ** 2)
    exposed = picture * np.asarray(1 - given.vignetting * r2, np.float32)[..., None]
    exposed += noise[..., None]
    return np.asarray(np.clip(np.rint(exposed), 0, 255), np.uint8)


def _grid(size: int) -> Floats:
    """Give the nodes of the grid along one side: the last lies on or beyond the last pixel."""
    return np.arange(0, size - 1 + GRID_PX, GRID_PX, dtype=float)


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


def _lay(picture: Bytes, plate: Plate, scene: PaintedScene, number: int) -> None:
    """Draw a plate into a picture."""
    # Samples along the side of a pixel.
    samples = 5
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
    fine = (np.arange(samples) + 0.5) / samples - 0.5
    rows = (np.arange(top, bottom)[:, None] + fine).ravel()
    columns = (np.arange(left, right)[:, None] + fine).ravel()
    nodes = scene.directions[camera]
    local = np.stack([_between(nodes[..., k], rows, columns) for k in range(3)], axis=-1)
    pose = _poses(world, number, rows)
    turned = local @ (TO_OPENCV @ pose.rotation)
    greys = plate.grey(np.broadcast_to(pose.centre_m[:, None], turned.shape), turned)
    boxes = greys.reshape(bottom - top, samples, right - left, samples)
    covered = np.isfinite(boxes).mean(axis=(1, 3))
    shown = np.nansum(boxes, axis=(1, 3)) / samples**2
    beneath = picture[top:bottom, left:right]
    mixed = beneath * (1 - covered)[..., None] + shown[..., None]
    picture[top:bottom, left:right] = np.rint(mixed).astype(np.uint8)


def _between(nodes: Floats, rows: Floats, columns: Floats) -> Floats:
    """Interpolate values at the nodes of the grid at rows and columns, shape (rows, columns)."""
    from scipy.interpolate import RectBivariateSpline

    down, across = (np.arange(size) * GRID_PX for size in nodes.shape)
    return np.asarray(RectBivariateSpline(down, across, nodes)(rows, columns))


def _spread(scene: PaintedScene, number: int) -> NDArray[np.float32]:
    """Give how a point of light is spread: by the lens, and along its way during the exposure."""
    world = scene.world
    camera, time = world.exposures.cameras[number], world.exposures.middle_s[number]
    half = world.configuration.camera.exposure_s / 2
    pose = world.exposures.pose
    ray = np.array([[0.0, 0.0, 1.0]]) @ TO_OPENCV @ pose.rotation[number]
    ground = world.terrain.intersect(pose.centre_m[number : number + 1], ray)
    ends = pose_at(world.motion, world.rig, np.array([time - half, time + half]))
    begin, end = seen(ground, ends, camera)
    way = (end - begin) * np.linspace(-0.5, 0.5, 21)[:, None]
    at = np.arange(-4, 5)
    sigma = max(world.configuration.pictures.blur_px, 0.05)
    columns, rows = np.meshgrid(at, at)
    apart = (columns[..., None] - way[:, 0]) ** 2 + (rows[..., None] - way[:, 1]) ** 2
    kernel = np.exp(-apart / (2 * sigma**2)).sum(axis=-1)
    return np.asarray(kernel / kernel.sum(), np.float32)

"""The flown block: what each image shows of the ground, overlaps, rays for each place, gaps, tilt, smear."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from photocal.adjustment.envelope import on_one_thread
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.geometry.oriented_images import OrientedImages
from photocal.geometry.smear import SMEAR_LIMIT_PX, smear_px

# Konecny: from here on tilt changes the overlap; 5 degrees is the conventional tolerance of vertical
# photographs (Alves Junior et al. 2015, section 4).
TILT_WITH_EFFECT_RAD = math.radians(3.0)
TILT_TOLERANCE_RAD = math.radians(5.0)
# Cells across a footprint: its area is then known to some thousandths.
CELLS_ACROSS = 60
# Strips are neighbours when their directions and heights differ by less.
_PARALLEL_RAD, _LEVEL = math.radians(20.0), 0.15
# A point in fewer images has no height that is checked.
FEWEST_RAYS = 3
# Corners and middles of the sides of an image, as shares of them, in order around it.
BORDER = np.array([[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]]) / 2.0


@dataclass(frozen=True, eq=False)
class GroundCells:
    """The ground as square cells in rows from the south, each from the west.

    places (rows * columns, 3): middles of the cells, local coordinates, m.
    """

    places: Floats
    cell_m: float
    columns: int


@dataclass(frozen=True, eq=False)
class FlownBlock:
    """What was flown; everything with one entry for each image is in the order of the images.

    height_m, gsd_m: above the ground below the image, and what a pixel is there, m.
    tilt_rad: of the optical axis against the vertical.
    forward: share of the image that the next one of its strip shows, too; NaN for the last one.
    side: for neighbouring strips: share of an image of the first that the second shows, median.
    smear_px: by the flight during the exposure; NaN where speed or exposure time are not known.
    rays, inside (cells,): how many images show a cell, and whether it lies within the hull of the stations.
    """

    names: tuple[str, ...]
    strip: Integers
    height_m: Floats
    gsd_m: Floats
    tilt_rad: Floats
    forward: Floats
    side: dict[tuple[int, int], float]
    smear_px: Floats
    ground: GroundCells
    rays: Integers
    inside: Flags


def flown_block(
    images: OrientedImages,
    strip: Integers,
    ground: GroundCells,
    speed_m_s: Floats | None = None,
    exposure_s: Floats | None = None,
) -> FlownBlock:
    """Measure a flown block.

    images: in local coordinates (Z up), in the order in which they were taken.
    strip (n,): from `block.motion.strips`.
    speed_m_s, exposure_s (n,): NaN where not known.
    """
    seen = cells_seen(images, ground)
    parts = _cells_of_pixels(images, ground)
    height = images.station[:, 2] - _ground_below(images.station, ground)
    pixel = np.array([math.sqrt(math.prod(camera.pitch)) / camera.values[0] for camera in images.cameras])
    gsd = height * pixel[images.camera]
    tilt = np.arccos(np.clip(images.rotation[:, 2, 2], -1.0, 1.0))
    unknown = np.full(len(images), np.nan)
    forward = unknown.copy()
    for i in np.flatnonzero(strip[1:] == strip[:-1]).tolist():
        forward[i] = _share(parts[i], seen[i + 1])
    exposure, speed = (unknown if values is None else values for values in (exposure_s, speed_m_s))
    smear = smear_px(exposure, speed, gsd)
    rays = np.bincount(np.concatenate([*seen, np.zeros(0, np.int64)]), minlength=len(ground.places))
    side = _side_overlaps(images.station, height, strip, seen, parts)
    inside = below_the_flight(images.station, ground)
    return FlownBlock(images.names, strip, height, gsd, tilt, forward, side, smear, ground, rays, inside)


@on_one_thread
def ground_through(images: OrientedImages, points: Floats) -> GroundCells:
    """Take the ground through measured points, shape (n, 3): linear between them, the nearest beyond.

    raises IllPosedError: for fewer than three points.
    """
    from scipy.spatial import cKDTree

    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 3:
        raise IllPosedError(
            "fewer than three points do not define the ground", remedy="give the height of the ground"
        )
    ground = level_ground(images, float(np.median(points[:, 2])))
    plane = ground.places[:, :2]
    between = _in_hull(plane, points[:, :2])
    ground.places[:, 2] = points[cKDTree(points[:, :2]).query(plane)[1], 2]
    inner = _between(points, plane[between])
    ground.places[between, 2] = np.where(np.isfinite(inner), inner, ground.places[between, 2])
    return ground


def _between(points: Floats, places: Floats) -> Floats:
    """Heights at places, linear in the triangles of Delaunay between points; NaN beyond them."""
    from scipy.spatial import Delaunay

    # scipy.interpolate does the same, and takes longer to be loaded.
    triangles = Delaunay(points[:, :2])
    own = triangles.find_simplex(places)
    way, origin = triangles.transform[own, :2], triangles.transform[own, 2]
    share = np.einsum("nij,nj->ni", way, places - origin)
    share = np.column_stack([share, 1.0 - share.sum(axis=1)])
    height = np.einsum("ni,ni->n", share, points[triangles.simplices[own], 2])
    return np.where(own >= 0, height, np.nan)


def _in_hull(places: Floats, points: Floats) -> Flags:
    """Places within the convex hull of points: a triangulation tries all of its triangles for each beyond.

    raises QhullError: for points in a line.
    """
    from scipy.spatial import ConvexHull

    side = ConvexHull(points).equations
    return np.asarray((places @ side[:, :2].T + side[:, 2] <= 0.0).all(axis=1))


def cells_seen(images: OrientedImages, ground: GroundCells) -> list[Integers]:
    """List the cells of the ground that each image shows."""
    size = images.sizes()
    low, high = ground.places[:, 2].min(), ground.places[:, 2].max()
    cells = []
    for i, border in enumerate(images.directions(BORDER)):
        # Within the corners' circle alone: beyond, a distortion polynomial may fold ground into the image.
        middle, reach = _circle(images.station[i], border, low, high)
        near = _window(middle, reach + ground.cell_m, ground)
        near = near[np.hypot(*(ground.places[near, :2] - middle).T) <= reach + ground.cell_m]
        pixel = images.project(np.full(len(near), i), ground.places[near])
        with np.errstate(invalid="ignore"):
            inside = ((pixel >= -0.5) & (pixel <= size[i] - 0.5)).all(axis=1)
        cells.append(near[inside])
    return cells


def figures_of(block: FlownBlock, **of_images: Floats) -> dict[str, Any]:
    """Give the figures of a flown block as a JSON value; overlaps are shares, what is not known is None.

    of_images (n,): further figures of the images by their names, such as exposure_ms and iso.
    """

    def spread(values: Floats) -> dict[str, float] | None:
        """Least, median and largest of the known values; None where none is known."""
        known = values[np.isfinite(values)]
        if not len(known):
            return None
        low, middle, high = np.percentile(known, [0, 50, 100]).tolist()
        return {"least": low, "median": middle, "most": high}

    pairs = np.array(list(block.side.values()))
    counted = block.rays[block.inside]
    area = block.ground.cell_m**2
    return {
        "images": len(block.names),
        "strips": len(np.unique(block.strip)),
        "height_m": spread(block.height_m),
        "gsd_m": spread(block.gsd_m),
        "tilt_deg": spread(np.degrees(block.tilt_rad)),
        "tilt_over_3_deg": int((block.tilt_rad > TILT_WITH_EFFECT_RAD).sum()),
        "tilt_over_5_deg": int((block.tilt_rad > TILT_TOLERANCE_RAD).sum()),
        "forward_overlap": spread(block.forward),
        "side_overlap": spread(pairs),
        "smear_px": spread(block.smear_px),
        "smear_over_limit": int((block.smear_px > SMEAR_LIMIT_PX).sum()),
        "rays": spread(counted.astype(np.float64)),
        **{name: spread(values) for name, values in of_images.items()},
        "gaps": [
            {"east_m": east, "north_m": north, "area_m2": cells * area} for east, north, cells in gaps(block)
        ],
    }


def gaps(block: FlownBlock, fewest: int = FEWEST_RAYS) -> list[tuple[float, float, int]]:
    """List places below the flight that too few images show: middle (m) and cells, largest first."""
    thin = (block.rays < fewest) & block.inside
    if not thin.any():
        return []
    from scipy import ndimage

    marked, count = ndimage.label(thin.reshape(-1, block.ground.columns))
    holes = []
    for number in range(1, count + 1):
        cells = block.ground.places[marked.ravel() == number]
        holes.append((*cells[:, :2].mean(axis=0).tolist(), len(cells)))
    return sorted(holes, key=lambda gap: -gap[2])


def _circle(station: Floats, border: Floats, low: float, high: float) -> tuple[Floats, float]:
    """Middle and radius of what an image shows between two heights; rays to the horizon reach 5 heights."""
    height = max(station[2] - low, 1e-6)
    corners = []
    for level in (low, high):
        slope = np.minimum(border[:, 2], -1e-9)
        away = border[:, :2] / -slope[:, None] * max(station[2] - level, 0.0)
        far = np.linalg.norm(away, axis=1)
        corners.append(away * np.minimum(1.0, 5.0 * height / np.maximum(far, 1e-9))[:, None])
    reach = np.vstack(corners)
    middle = reach.mean(axis=0)
    return station[:2] + middle, float(np.linalg.norm(reach - middle, axis=1).max())


def level_ground(images: OrientedImages, height_m: float) -> GroundCells:
    """Take the ground as level: before any point of it is known."""
    circles = [
        _circle(at, border, height_m, height_m)
        for at, border in zip(images.station, images.directions(BORDER), strict=True)
    ]
    middle, radius = np.array([c[0] for c in circles]), np.array([c[1] for c in circles])
    # The shorter side of the footprint is at least some half of the circle.
    cell = float(np.median(radius)) * 2.0 / CELLS_ACROSS / math.sqrt(2.0)
    low, high = (middle - radius[:, None]).min(axis=0), (middle + radius[:, None]).max(axis=0)
    x, y = (np.arange(a + cell / 2.0, b + cell, cell) for a, b in zip(low, high, strict=True))
    east, north = np.meshgrid(x, y)
    places = np.column_stack([east.ravel(), north.ravel(), np.full(east.size, float(height_m))])
    return GroundCells(places, cell, len(x))


def _cell_of(places: Floats, ground: GroundCells) -> Integers:
    """Cells below places, the nearest one for places beyond all of them."""
    column, row = np.rint((places - ground.places[0, :2]) / ground.cell_m).astype(np.int64).T
    last = len(ground.places) // ground.columns - 1
    return np.asarray(np.clip(row, 0, last) * ground.columns + np.clip(column, 0, ground.columns - 1))


def _window(middle: Floats, reach: float, ground: GroundCells) -> Integers:
    """Cells of the square about a place, so that a circle is not searched for in all of a large ground."""
    rows = len(ground.places) // ground.columns
    offset = middle - ground.places[0, :2]
    ends = np.array([offset - reach, offset + reach]) / ground.cell_m
    (west, south), (east, north) = np.clip(np.rint(ends), 0, [ground.columns - 1, rows - 1]).astype(np.int64)
    across, up = np.arange(west, east + 1), np.arange(south, north + 1)
    return np.asarray((up[:, None] * ground.columns + across).ravel())


def _ground_below(station: Floats, ground: GroundCells) -> Floats:
    return np.asarray(ground.places[_cell_of(station[:, :2], ground), 2])


def _cells_of_pixels(images: OrientedImages, ground: GroundCells) -> Integers:
    """Cells that pixels of a raster over each image show, shape (n, pixels)."""
    across = np.array([(k + 0.5) / CELLS_ACROSS for k in range(CELLS_ACROSS)])
    raster = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)
    seen = []
    # Steps in which a ray meets the ground.
    steps = 4
    for station, rays in zip(images.station, images.directions(raster), strict=True):
        slope = rays[:, :2] / -np.minimum(rays[:, 2], -1e-9)[:, None]
        height = np.full(len(rays), station[2] - _ground_below(station[None], ground)[0])
        for _ in range(steps):
            cells = _cell_of(station[:2] + slope * height[:, None], ground)
            height = station[2] - ground.places[cells, 2]
        seen.append(cells)
    return np.array(seen)


def _share(cells: Integers, others: Integers) -> float:
    """Share of an image, by the cells of its raster, that others show."""
    return float(np.isin(cells, others).mean())


def _side_overlaps(
    station: Floats, height: Floats, strip: Integers, seen: list[Integers], parts: Integers
) -> dict[tuple[int, int], float]:
    """Overlap of each strip with the nearest parallel one of the same height on either side."""
    numbers = [int(s) for s in np.unique(strip) if (strip == s).sum() > 1]
    run = {s: np.subtract(*station[strip == s, :2][[-1, 0]]) for s in numbers}
    way = {s: moved / max(float(np.linalg.norm(moved)), 1e-9) for s, moved in run.items()}
    level = {s: float(np.median(height[strip == s])) for s in numbers}
    overlaps = {}
    for s in numbers:
        images = np.flatnonzero(strip == s)
        along, across = way[s], np.array([way[s][1], -way[s][0]])
        nearest: dict[bool, tuple[float, int, Integers]] = {}
        for t in numbers:
            parallel = abs(float(along @ way[t])) > math.cos(_PARALLEL_RAD)
            if t == s or not parallel or abs(level[t] - level[s]) > _LEVEL * level[s]:
                continue
            reach = station[strip == t, :2] @ along
            progress = station[images, :2] @ along
            beside = images[(progress >= reach.min()) & (progress <= reach.max())]
            offset = float(np.median((station[strip == t, :2] - station[images, :2].mean(axis=0)) @ across))
            right = offset > 0
            if len(beside) and (right not in nearest or abs(offset) < nearest[right][0]):
                nearest[right] = abs(offset), t, beside
        for _, t, beside in nearest.values():
            shown = np.unique(np.concatenate([seen[j] for j in np.flatnonzero(strip == t)]))
            overlaps[s, t] = float(np.median([_share(parts[i], shown) for i in beside]))
    return overlaps


def below_the_flight(station: Floats, ground: GroundCells) -> Flags:
    """Cells within the hull of the stations; of a single strip, those within a cell of it."""
    from scipy.spatial import QhullError

    try:
        return _in_hull(ground.places[:, :2], station[:, :2])
    except (QhullError, ValueError):
        apart = np.linalg.norm(ground.places[:, None, :2] - station[None, :, :2], axis=2).min(axis=1)
        return np.asarray(apart <= ground.cell_m)

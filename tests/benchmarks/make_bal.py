"""Make a bundle adjustment problem of the size and ray count of one of BAL, and write it in BAL's form.

Usage: python -m tests.benchmarks.make_bal SHAPE OUTPUT.txt[.bz2|.gz] [--seed N]

The problems of Bundle Adjustment in the Large are real; where they cannot be fetched, these have as many
images, points and rays. `street`: a vehicle passes through the streets of a grid, some of them twice.
`collection`: people photograph the squares of a city from wherever they stand. `flight`: strips of an aerial
survey with oblique views over buildings. Each image has its own f, k1 and k2 unless one camera is asked for.
Observations have a standard deviation of 0.7 px; starts are disturbed so that they miss by some pixels, as
those of BAL do.
"""

from __future__ import annotations

import argparse
import bz2
import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from photocal.exchange.bal import BalProblem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
NOISE_PX = 0.7
# Distance of the streets' crossings, and of a vehicle's images.
BLOCK_M, STEP_M = 90.0, 1.5
# Places that are worked on at once, and images near one that are tried.
PORTION, TRIED = 100_000, 48
# Sine of the angle at which another ray crosses the first at least.
LEAST_PARALLAX = 0.02


class Shape(NamedTuple):
    """Size of a problem, and how its images lie."""

    images: int
    points: int
    rays: int
    kind: str


SHAPES = {
    "ladybug-49": Shape(49, 7_776, 31_843, "street"),
    "ladybug-372": Shape(372, 47_423, 204_472, "street"),
    "ladybug-1723": Shape(1_723, 156_502, 678_718, "street"),
    "venice-1778": Shape(1_778, 993_923, 5_001_946, "collection"),
    "final-13682": Shape(13_682, 4_456_117, 28_987_644, "flight"),
    "flight-1000": Shape(1_000, 250_000, 1_625_000, "flight"),
    "flight-3000": Shape(3_000, 750_000, 4_875_000, "flight"),
    "flight-10000": Shape(10_000, 2_500_000, 16_250_000, "flight"),
}


class Views(NamedTuple):
    """Where images were taken from, where they look, and how far what they see is.

    near, far: along their axes, m. half: half of the side of an image over f.
    """

    centre: Floats
    axis: Floats
    near: float
    far: float
    half: float
    focal: float


def street(count: int, chance: np.random.Generator) -> Views:
    """A drive through the streets of a grid, straight on more often than not."""
    heading, place, nodes = 0, np.zeros(2), [np.zeros(2)]
    each = round(BLOCK_M / STEP_M)
    for _ in range(count // each + 2):
        side = 1 + int(np.sqrt(count / each))
        turns = [heading, (heading + 1) % 4, (heading - 1) % 4]
        ways = [np.array([(1, 0), (0, 1), (-1, 0), (0, -1)][turn]) for turn in turns]
        inside = [k for k, way in enumerate(ways) if np.abs(place + way).max() <= side / 2]
        weights = np.array([0.6, 0.2, 0.2])[inside]
        chosen = inside[int(chance.choice(len(inside), p=weights / weights.sum()))] if inside else 0
        heading, place = turns[chosen], place + ways[chosen]
        nodes.append(place)
    corner = BLOCK_M * np.array(nodes)
    along = np.arange(count) / each
    leg = along.astype(np.int64)
    way = corner[leg + 1] - corner[leg]
    centre = corner[leg] + (along - leg)[:, None] * way
    axis = np.column_stack([way / BLOCK_M, np.zeros(count)])
    turned = Rotation.from_rotvec(chance.normal(0, 0.35, (count, 1)) * [0.0, 0.0, 1.0]).as_matrix()
    axis = np.einsum("nij,nj->ni", turned, axis)
    height = 2.5 + chance.normal(0, 0.05, count)
    centre = np.column_stack([centre + chance.normal(0, 0.3, (count, 2)), height])
    return Views(centre, axis, 4.0, 40.0, 0.9, 600.0)


def collection(count: int, chance: np.random.Generator) -> Views:
    """Photographs of the squares of a city, from places around them."""
    squares = chance.uniform(-150, 150, (max(count // 60, 1), 2))
    middle = squares[chance.integers(len(squares), size=count)]
    centre = np.column_stack([middle + chance.normal(0, 30, (count, 2)), chance.uniform(1, 8, count)])
    towards = (
        np.column_stack([middle + chance.normal(0, 12, (count, 2)), chance.uniform(2, 14, count)]) - centre
    )
    return Views(centre, towards / np.linalg.norm(towards, axis=1)[:, None], 8.0, 90.0, 0.6, 1200.0)


def flight(count: int, chance: np.random.Generator) -> Views:
    """Strips of a survey at 100 m above ground, one image in two oblique."""
    strips = max(round(np.sqrt(count / 2)), 1)
    each = int(np.ceil(count / strips))
    k = np.arange(count)
    plane = np.column_stack([25.0 * (k % each), 40.0 * (k // each)])
    centre = np.column_stack([plane + chance.normal(0, 1, (count, 2)), 100 + chance.normal(0, 4, count)])
    tilt, way = np.where(k % 2, np.radians(35), np.radians(3)), chance.uniform(0, 2 * np.pi, count)
    axis = np.column_stack([np.sin(tilt) * np.cos(way), np.sin(tilt) * np.sin(way), -np.cos(tilt)])
    return Views(centre, axis, 60.0, 130.0, 0.7, 3000.0)


KINDS: dict[str, Callable[[int, np.random.Generator], Views]] = {
    "street": street,
    "collection": collection,
    "flight": flight,
}


def rotations(axis: Floats, chance: np.random.Generator) -> Floats:
    """Matrices from object to camera axes (x right, y up, z backwards) of images that look along axes."""
    up = np.where(np.abs(axis[:, 2:]) > 0.8, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    right = np.cross(axis, up)
    right /= np.linalg.norm(right, axis=1)[:, None]
    level = np.stack([right, np.cross(right, axis), -axis], axis=1)
    return np.asarray(
        Rotation.from_rotvec(chance.normal(0, 0.05, (len(axis), 1)) * [0.0, 0.0, 1.0]).as_matrix() @ level
    )


def _places(views: Views, matrix: Floats, count: int, chance: np.random.Generator) -> tuple[Integers, Floats]:
    """Points, each in the field of an image that is returned first."""
    image = chance.integers(len(matrix), size=count)
    deep = chance.uniform(views.near, views.far, count)
    seen = np.column_stack([chance.uniform(-views.half, views.half, (count, 2)), np.full(count, -1.0)])
    points = np.einsum("nji,nj->ni", matrix[image], deep[:, None] * seen) + views.centre[image]
    if views.axis[:, 2].mean() < -0.5:
        # From the air: ground and roofs, no higher than 25 m.
        height = np.where(chance.random(count) < 0.5, 0.0, 25 * chance.random(count))
        away = points - views.centre[image]
        points = views.centre[image] + away * ((height - views.centre[image, 2]) / away[:, 2])[:, None]
    return image, points


def _viewers(
    views: Views, matrix: Floats, image: Integers, points: Floats, tree: cKDTree, middle: float
) -> Integers:
    """Images that see each point, (points, 1 + TRIED), the nearest first; -1 for none.

    That in whose field it lies, and those that see it from elsewhere.
    """
    tried = min(TRIED, len(matrix))
    _, other = tree.query(points, tried, workers=1)
    other = np.asarray(other, dtype=np.int64).reshape(len(points), tried)
    other = np.column_stack([image, np.where(other == image[:, None], -1, other)])
    away = points[:, None] - views.centre[other]
    seen = np.einsum("nkij,nkj->nki", matrix[other], away)
    deep = -seen[..., 2]
    inside = (deep > views.near / 2) & (deep < 1.5 * views.far)
    inside &= (np.abs(seen[..., :2]) < views.half * deep[..., None]).all(axis=2) & (other >= 0)
    ray = away / np.linalg.norm(away, axis=2)[..., None]
    across = np.linalg.norm(np.cross(ray[:, :1], ray), axis=2)
    inside[:, 1:] &= across[:, 1:] > LEAST_PARALLAX
    found = np.where(inside, other, -1)
    return np.take_along_axis(found, np.argsort(~inside, axis=1, kind="stable"), axis=1)


def _wanted(shape: Shape, chance: np.random.Generator) -> Integers:
    """How many rays each point should have: two at least, few of them many."""
    more = shape.rays / shape.points - 2
    return np.asarray(2 + chance.geometric(1 / (1 + more), shape.points) - 1)


def _even(count: Integers, most: Integers, total: int, chance: np.random.Generator) -> Integers:
    """Change counts, from two up to their limits, so that they have a sum."""
    count = np.minimum(count, most)
    while (lack := total - int(count.sum())) != 0:
        able = np.flatnonzero(count < most if lack > 0 else count > 2)
        if not len(able):
            raise ValueError(f"{total} rays are more than these images see")
        chosen = chance.permutation(able)[: abs(lack)]
        count[chosen] += int(np.sign(lack))
    return count


def make(shape: Shape, seed: int = 1, *, one_camera: bool = False, start: float = 1.0) -> BalProblem:
    """Make a problem.

    start: by how much start values are disturbed, of what is usual; 0 for the truth.
    """
    chance = np.random.default_rng(seed)
    views = KINDS[shape.kind](shape.images, chance)
    matrix = rotations(views.axis, chance)
    middle = (views.near + views.far) / 2
    tree = cKDTree(views.centre + middle / 2 * views.axis)
    kept, places, missing = [], [], shape.points
    while missing:
        image, points = _places(views, matrix, min(PORTION, missing + missing // 5 + 10), chance)
        found = _viewers(views, matrix, image, points, tree, middle)
        enough = np.flatnonzero((found >= 0).sum(axis=1) >= 2)[:missing]
        kept.append(found[enough].astype(np.int32))
        places.append(points[enough])
        missing -= len(enough)
    viewers, points = np.concatenate(kept), np.concatenate(places)
    del kept, places
    count = _even(_wanted(shape, chance), (viewers >= 0).sum(axis=1), shape.rays, chance)
    image = viewers[np.arange(viewers.shape[1]) < count[:, None]].astype(np.int64)
    point = np.repeat(np.arange(shape.points), count)
    del viewers
    lens = np.array([views.focal, -0.03, 0.005]) * np.ones((shape.images, 1))
    if not one_camera:
        lens *= 1 + chance.normal(0, [0.02, 0.2, 0.2], (shape.images, 3))
    translation = -np.einsum("nij,nj->ni", matrix, views.centre)
    cameras = np.hstack([Rotation.from_matrix(matrix).as_rotvec(), translation, lens])
    plane = project(cameras, points, image, point) + chance.normal(0, NOISE_PX, (shape.rays, 2))
    # Of a file: as many digits as BAL has.
    plane = np.round(plane, 3)
    started = _disturbed(cameras, matrix, views, start, one_camera, chance)
    spread = start * 2e-3 * middle
    return BalProblem(started, points + chance.normal(0, spread, points.shape), image, point, plane)


def _disturbed(
    cameras: Floats, matrix: Floats, views: Views, start: float, one_camera: bool, chance: np.random.Generator
) -> Floats:
    count, middle = len(cameras), (views.near + views.far) / 2
    turn = Rotation.from_rotvec(chance.normal(0, start * 1e-3, (count, 3))).as_matrix() @ matrix
    centre = views.centre + chance.normal(0, start * 1e-3 * middle, (count, 3))
    off = chance.normal(0, [0.005, 0.3, 0.5], (1 if one_camera else count, 3))
    lens = cameras[:, 6:] * (1 + start * off)
    return np.hstack([Rotation.from_matrix(turn).as_rotvec(), -np.einsum("nij,nj->ni", turn, centre), lens])


def project(cameras: Floats, points: Floats, image: Integers, point: Integers) -> Floats:
    """Image points by BAL's own model, (rays, 2)."""
    plane = np.empty((len(image), 2))
    matrix = Rotation.from_rotvec(cameras[:, :3]).as_matrix()
    for begin in range(0, len(image), 10 * PORTION):
        part = slice(begin, begin + 10 * PORTION)
        own = cameras[image[part]]
        seen = np.einsum("nij,nj->ni", matrix[image[part]], points[point[part]]) + own[:, 3:6]
        p = -seen[:, :2] / seen[:, 2:]
        square = np.sum(p**2, axis=1)
        plane[part] = (own[:, 6] * (1 + square * (own[:, 7] + square * own[:, 8])))[:, None] * p
    return plane


def write(problem: BalProblem, path: Path) -> None:
    """Write a problem in BAL's form, compressed as its name says."""
    opened: dict[str, Any] = {".bz2": bz2.open, ".gz": gzip.open}
    with opened.get(path.suffix, Path.open)(path, "wb") as out:
        counts = len(problem.cameras), len(problem.points), len(problem.image)
        out.write(" ".join(map(str, counts)).encode() + b"\n")
        for begin in range(0, len(problem.image), PORTION):
            part = slice(begin, begin + PORTION)
            rows = zip(
                problem.image[part].tolist(),
                problem.point[part].tolist(),
                *problem.plane[part].T.tolist(),
                strict=True,
            )
            out.write("".join(f"{i} {j} {x:.6e} {y:.6e}\n" for i, j, x, y in rows).encode())
        for numbers in (problem.cameras, problem.points):
            flat = numbers.ravel()
            for begin in range(0, len(flat), PORTION):
                out.write("".join(f"{n:.16e}\n" for n in flat[begin : begin + PORTION].tolist()).encode())


def main() -> None:
    """Make the problem that the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("shape", choices=SHAPES)
    parser.add_argument("output", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    write(make(SHAPES[arguments.shape], arguments.seed), arguments.output)


if __name__ == "__main__":
    main()

"""A laboratory: coded targets of four corners, rendered pictures of them, readings by hand, three tapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, Relations, point_weights
from photocal.base.arrays import Floats
from photocal.geometry.camera import Camera, camera, pixel_to_plane, plane_to_pixel
from photocal.geometry.distortion import projected, undistorted
from photocal.geometry.rotation import angles_from_matrix

SIZE, DICTIONARY, SIDE_M = (1600, 1200), "4x4_100", 0.16
LENS = {"c": 1500.0, "x0": 8.0, "y0": -6.0, "K1": -4e-8, "K2": 1.5e-14, "P1": 2e-7, "P2": -3e-7}
ESTIMATED = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")
TARGETS, PICTURES, TAPE_SIGMA_M, SIGMA_PX = 60, 20, 0.0005, 0.3
DARK, LIGHT = 40.0, 220.0
_STEP = 2


@dataclass(frozen=True)
class Laboratory:
    """What is true: corners (targets, 4, 3), and of each picture its rotation and centre."""

    lens: Camera
    corners: Floats
    rotation: Floats
    centre: Floats


def laboratory(targets: int = TARGETS, pictures: int = PICTURES, seed: int = 5) -> Laboratory:
    """Targets in three depths, pictures that converge from twenty sides, rolled by right angles."""
    rng = np.random.default_rng(seed)
    lens = camera("lab", "brown-ideal", "px", SIZE, (1.0, 1.0), LENS, estimate=ESTIMATED, affinity="after")
    corners = []
    # Clockwise as printed, seen from the front: x right, y up in the target's plane.
    square = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * SIDE_M / 2
    places = [(i, j) for j in range(6) for i in range(10)]
    for i, j in places[:: TARGETS // targets]:
        middle = np.array([0.42 * (i - 4.5), 0.42 * (j - 2.5), 0.0]) + rng.uniform(-0.05, 0.05, 3)
        # Every third stands on a pillar before the wall.
        middle[2] = (0.9 if (i + j) % 3 == 0 else 0.35 if (i + j) % 3 == 1 else 0.0) + rng.uniform(0, 0.1)
        turn = Rotation.from_euler("zyx", rng.uniform(-12, 12, 3), degrees=True).as_matrix()
        corners.append(middle + square @ turn.T)
    rotation, centre = [], []
    for k in range(0, PICTURES, PICTURES // pictures):
        around, up = np.radians([(-40, -20, 0, 20, 40)[k % 5], (-25, -8, 8, 25)[k // 5]])
        distance = 3.4 if k % 2 else 4.1
        away = np.array([np.sin(around) * np.cos(up), np.sin(up), np.cos(around) * np.cos(up)])
        place = distance * away + np.array([0.0, 0.0, 0.4]) + rng.normal(0, 0.05, 3)
        back = place - np.array([0.0, 0.0, 0.4])
        back /= np.linalg.norm(back)
        right = np.cross([0.0, 1.0, 0.0], back)
        right /= np.linalg.norm(right)
        level = np.array([right, np.cross(back, right), back])
        roll = Rotation.from_euler("z", 90 * (k % 4), degrees=True).as_matrix()
        rotation.append(roll @ level)
        centre.append(place)
    return Laboratory(lens, np.array(corners), np.array(rotation), np.array(centre))


def tapes(lab: Laboratory, rng: np.random.Generator) -> list[tuple[str, str, float]]:
    """Three distances between corners of far targets, m."""
    last = len(lab.corners) - 1
    ends = (((0, 0), (last, 1)), ((last // 3, 3), (last, 2)), ((0, 2), (2 * last // 3, 0)))
    return [
        (
            f"{a[0]}.{a[1] + 1}",
            f"{b[0]}.{b[1] + 1}",
            float(np.linalg.norm(lab.corners[a] - lab.corners[b]) + rng.normal(0, TAPE_SIGMA_M)),
        )
        for a, b in ends
    ]


def picture(
    lab: Laboratory,
    k: int,
    rng: np.random.Generator,
    over: int = 3,
    covered: Sequence[int] = (),
    margin: float = 0.3,
) -> NDArray[np.uint8]:
    """Trace the rays of every pixel back to the targets' planes; blur and noise as of a camera.

    covered: targets over one corner of which a plate lies, on an eighth of two sides.
    margin: of a target's side, between it and the picture's border; nearer ones are not there.
    """
    width, height = SIZE
    sheet = _sheets()
    fine = np.full((height * over, width * over), LIGHT, dtype=np.float32)
    plates: list[list[Floats]] = []
    for code, corners in enumerate(lab.corners):
        q = (corners - lab.centre[k]) @ lab.rotation[k].T
        if (q[:, 2] > -0.3).any():
            continue
        seen = plane_to_pixel(SIZE, (1.0, 1.0), projected(lab.lens, q))
        side = np.linalg.norm(np.roll(seen, -1, axis=0) - seen, axis=1).max()
        apart = margin * side
        if (seen - apart < 2).any() or (seen + apart > np.array(SIZE) - 3).any():
            continue
        low = np.maximum(seen.min(axis=0) - 0.3 * side, 0.0)
        high = np.minimum(seen.max(axis=0) + 0.3 * side, np.array(SIZE) - 1.0)
        if code in covered:
            at, before, after = seen[0], seen[3] - seen[0], seen[1] - seen[0]
            plates.append([at + 0.13 * before, at - 0.2 * (before + after), at + 0.13 * after])
        # Where the rays meet the sheet, every second pixel, linear between: to half a thousandth of one.
        first = np.floor(low).astype(int)
        count = np.ceil((high - first) / _STEP).astype(int)
        x, y = (first[a] - 0.5 + _STEP * (np.arange(count[a]) + 0.5) for a in (0, 1))
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        ideal = undistorted(lab.lens, pixel_to_plane(SIZE, (1.0, 1.0), pixels))
        rays = np.column_stack([ideal, np.full(len(ideal), -lab.lens.values[0])])
        across, down = q[1] - q[0], q[3] - q[0]
        normal = np.cross(across, down)
        meet = rays * ((q[0] @ normal) / (rays @ normal))[:, None] - q[0]
        wide, tall = (int(n) * _STEP for n in count)
        maps = [
            cv2.resize(
                (meet @ axis / (axis @ axis) * 60 + 20 - 0.5).astype(np.float32).reshape(len(y), len(x)),
                (wide * over, tall * over),
                interpolation=cv2.INTER_LINEAR,
            )
            for axis in (across, down)
        ]
        # Not the nearest cell: an edge along the rows would lie up to a sixth of a pixel off as a whole.
        grey = cv2.remap(sheet[code], maps[0], maps[1], cv2.INTER_LINEAR, borderValue=(LIGHT,))
        wide, tall = min(wide, width - first[0]), min(tall, height - first[1])
        rows = slice(first[1] * over, (first[1] + tall) * over)
        columns = slice(first[0] * over, (first[0] + wide) * over)
        fine[rows, columns] = np.minimum(fine[rows, columns], grey[: tall * over, : wide * over])
    for plate in plates:
        outline = np.round((np.array(plate) + 0.5) * over - 0.5).astype(np.int32)
        cv2.fillPoly(fine, [outline], (LIGHT,))
    blurred = np.asarray(cv2.GaussianBlur(fine, (0, 0), 0.7 * over), dtype=np.float64)
    coarse = blurred.reshape(height, over, width, over).mean(axis=(1, 3))
    noisy = coarse + rng.normal(0.0, 2.0, coarse.shape)
    return np.asarray(np.clip(np.round(noisy), 0, 255), np.uint8)


def _sheets() -> list[NDArray[np.float32]]:
    """Grey values of the targets, 60 cells of the picture over the side and a white margin of 20."""
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    made = []
    for code in range(TARGETS):
        bits = cv2.aruco.generateImageMarker(codes, code, 60)
        grey = np.where(bits > 127, LIGHT, DARK).astype(np.float32)
        sheet = cv2.copyMakeBorder(grey, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=(LIGHT,))
        made.append(np.asarray(sheet, np.float32))
    return made


def write_pictures(lab: Laboratory, folder: Path, seed: int = 1) -> None:
    """Write all pictures without loss."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for k in range(len(lab.centre)):
        cv2.imwrite(str(folder / f"lab{k:02d}.png"), picture(lab, k, rng))


def observed(lab: Laboratory, seed: int, readings: int = 5) -> Network:
    """The laboratory read five times by hand: the mean of the readings, with the tapes, a free network."""
    rng = np.random.default_rng(seed)
    points = lab.corners.reshape(-1, 3)
    image, point, plane = [], [], []
    for k in range(len(lab.centre)):
        own = projected(lab.lens, (points - lab.centre[k]) @ lab.rotation[k].T)
        inside = np.flatnonzero((np.abs(own) < np.array(SIZE) / 2 - 5).all(axis=1))
        image.append(np.full(len(inside), k))
        point.append(inside)
        plane.append(own[inside])
    index, which, exact = np.concatenate(image), np.concatenate(point), np.vstack(plane)
    order = np.lexsort((index, which))
    read = exact + rng.normal(0.0, SIGMA_PX, (readings, *exact.shape)).mean(axis=0)
    held, weight = point_weights(np.full(points.shape, np.inf))
    names = tuple(f"{code}.{corner + 1}" for code in range(len(lab.corners)) for corner in range(4))
    measured = tapes(lab, rng)
    ends = np.array([[names.index(a), names.index(b)] for a, b, _ in measured])
    poses = np.hstack([angles_from_matrix(lab.rotation), lab.centre])
    return Network(
        (lab.lens,),
        ExteriorOrientations(np.zeros(len(poses), np.int64), poses, np.full(poses.shape, np.inf)),
        Points(points + rng.normal(0, 0.005, points.shape), held, weight),
        Rays(
            index[order],
            which[order],
            read[order],
            np.full(exact.shape, SIGMA_PX / np.sqrt(readings)),
        ),
        tuple(f"lab{k:02d}" for k in range(len(poses))),
        names,
        Relations(
            np.zeros(3, np.int64),
            ends[:, 0],
            ends[:, 1],
            np.array([value for _, _, value in measured]),
            np.full(3, TAPE_SIGMA_M),
        ),
        datum_points=np.zeros(0, np.int64),
    )

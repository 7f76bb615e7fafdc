"""Flights of a thermal camera with a laser over trees, at one height, with RTK positions and no control.

Made without the program's geometry: c, and with it all heights, is what such a flight hardly determines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from photocal.block.model import Block, Images, ObjectPoints, Observations
from photocal.geometry.camera import camera
from photocal.measurement.image_facts import ImageFacts

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# A Zenmuse H20T: 640 x 512 pixels of 12 micrometres, 13.5 mm.
SIZE, C, X0, Y0, K1 = (640, 512), 1125.0, 4.0, -3.0, -8e-8
HEIGHT_M, NOISE_PX, SIGMA_M, LEAVES_M = 90.0, 0.14, (0.02, 0.02, 0.03), 0.12
# What a maker states of a rangefinder, 0.2 m and 0.15 %, as three sigmas; and the noise of one distance.
OFFSET_M, SCALE, NOISE_M = 0.2 / 3, 0.0015 / 3, 0.05
ESTIMATE = ("c", "x0", "y0", "K1")


@dataclass(frozen=True)
class Canopy:
    """A flight and its truth: places of points and images, what pictures say, which shots fell into gaps."""

    block: Block
    points: Floats
    centre: Floats
    facts: tuple[ImageFacts, ...]
    gaps: frozenset[str]


def crowns(places: Floats, tall: float) -> Floats:
    """Crowns of some 6 m, up to 3 m high, on a slope, or so much less of both; 18 m above the ground."""
    x, y = places.T
    return np.asarray(18.0 + tall * (0.05 * x + 1.5 * np.sin(x / 3.1 + np.sin(y / 7.0)) * np.cos(y / 3.7)))


def fly(
    seed: int, bias_m: float = 0.0, gaps: float = 0.15, tall: float = 1.0, tilt_deg: float = 2.5,
    sigma_m: tuple[float, float, float] = SIGMA_M,
) -> Canopy:  # fmt: skip
    """Strips to and fro; laser distances with the maker's errors, a bias beyond, and shots through gaps.

    tall: of the crowns: over a field (0.05), with a steady gimbal, next to nothing tells c.
    sigma_m: of the positions.
    """
    lines, per_line, ties = 6, 9, 2600
    rng = np.random.default_rng(seed)
    count = lines * per_line
    line, along = np.divmod(np.arange(count), per_line)
    forth = np.where(line % 2 == 0, 1.0, -1.0)
    centre = np.column_stack(
        [
            (line - (lines - 1) / 2) * 12.0,
            forth * (along - (per_line - 1) / 2) * 7.0,
            np.full(count, HEIGHT_M),
        ]
    )
    centre += rng.normal(0, [0.5, 0.5, 0.4], centre.shape)
    angles = rng.normal(0, np.radians(tilt_deg), (count, 3))
    angles[:, 2] += np.where(forth > 0, 0.0, np.pi)
    matrix = np.array([_rotation(*one) for one in angles])
    reach = np.abs(centre[:, :2]).max(axis=0) + 16.0
    ground = rng.uniform(-reach, reach, (ties, 2))
    points = np.column_stack([ground, crowns(ground, tall) + rng.normal(0, tall * LEAVES_M, ties)])
    image, point, pixels = list[Integers](), list[Integers](), list[Floats]()
    for i in range(count):
        q = (points - centre[i]) @ matrix[i].T
        p = -C * q[:, :2] / q[:, 2:]
        plane = [X0, Y0] + p * (1 + K1 * np.sum(p**2, axis=1))[:, None]
        pixel = [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2] + plane * [1.0, -1.0]
        inside = np.flatnonzero((pixel > 3).all(axis=1) & (pixel < np.array(SIZE) - 4).all(axis=1))
        image.append(np.full(len(inside), i, dtype=np.int64))
        point.append(inside)
        pixels.append(pixel[inside] + rng.normal(0, NOISE_PX, (len(inside), 2)))
    seen = np.concatenate(point)
    good = np.bincount(seen, minlength=ties) >= 3
    place = np.cumsum(good) - 1
    keep = good[seen]
    rays = np.vstack(pixels)[keep]
    names = tuple(f"{i:03}.jpg" for i in range(count))
    distance, fell = _measured(rng, centre, -matrix[:, 2], gaps, tall)
    values = np.hstack([angles, centre + rng.normal(0, sigma_m, centre.shape)])
    values[:, :3] += rng.normal(0, np.radians(0.3), (count, 3))
    sigma = np.hstack([np.full((count, 3), np.inf), np.tile(sigma_m, (count, 1))])
    lens = camera("h20t", "brown-ideal", "px", SIZE, (1.0, 1.0), {"c": 1.01 * C}, estimate=ESTIMATE)
    block = Block(
        "canopy", "local", "", "control", (lens,),
        Images(names, np.zeros(count, np.int64), values, sigma, time=np.arange(float(count))),
        ObjectPoints(
            tuple(f"t{j}" for j in np.flatnonzero(good)),
            points[good] + rng.normal(0, 0.5, (int(good.sum()), 3)),
        ),
        Observations(
            "px", "pixel", np.concatenate(image)[keep], place[seen[keep]], rays,
            np.full(rays.shape, NOISE_PX),
        ),
    )  # fmt: skip
    facts = tuple(
        ImageFacts(name, SIZE, laser_m=round(far, 3))
        for name, far in zip(names, (distance + bias_m).tolist(), strict=True)
    )
    return Canopy(block, points[good], centre, facts, frozenset(names[i] for i in np.flatnonzero(fell)))


def _measured(
    rng: np.random.Generator, centre: Floats, axis: Floats, gaps: float, tall: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Distances along the axes to leaves, or through gaps to the ground below."""
    far = np.full(len(centre), 70.0)
    for _ in range(40):
        hit = centre + far[:, None] * axis
        far = far + 0.7 * (crowns(hit[:, :2], tall) - hit[:, 2]) / axis[:, 2]
    fell = rng.random(len(centre)) < gaps
    far = far + rng.normal(0, tall * LEAVES_M, len(far)) + fell * rng.uniform(4, 15, len(far))
    scale, offset = rng.normal(0, SCALE), rng.normal(0, OFFSET_M)
    return (1 + scale) * far + offset + rng.normal(0, NOISE_M, len(far)), fell


def _rotation(omega: float, phi: float, kappa: float) -> Floats:
    """R3(kappa) R2(phi) R1(omega), object to camera axes."""
    (sw, sp, sk), (cw, cp, ck) = np.sin([omega, phi, kappa]), np.cos([omega, phi, kappa])
    first = np.array([[1, 0, 0], [0, cw, sw], [0, -sw, cw]])
    second = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    third = np.array([[ck, sk, 0], [-sk, ck, 0], [0, 0, 1]])
    return np.asarray(third @ second @ first)

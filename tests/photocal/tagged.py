"""Flights of a multispectral camera with RTK positions, made by OpenCV, whose maker's tag is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.block.model import Block, Images, ObjectPoints, Observations
from photocal.block.writer import write_block
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.rotation import angles_from_matrix
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.maker_camera import StatedCamera, stated_camera
from tests.photocal.georeferencing.flights import CV_TO_PHOTO

Floats = NDArray[np.float64]

SIZE = (1600, 1300)
# Truth in OpenCV's terms: what a Phantom 4 Multispectral states, with square pixels and without P1 and P2.
FX, FY, CX, CY = 1964.0, 1964.0, -12.0, 11.4
K1, K2, K3 = -0.4227, 0.3691, -0.2643
SIGMA_M = (0.012, 0.015, 0.022)
HEIGHTS_M = (44.0, 57.0)
NOISE_PX = 0.25
PROJECT = """
[project]
name = "tagged"
crs = "local"
height = "local"
output = "work"
[measurements]
block = "block"
"""


def tag(ratio: float = 1.009, cy_sign: int = 1, p: float = 0.0, model: str = "FC6310R") -> ImageFacts:
    """Facts of a picture whose DewarpData has fx this much too long, cy of a sign, and p1 = p2."""
    values = (FX * ratio, FY, CX, cy_sign * CY, K1, K2, p, p, K3)
    text = "2022-03-02;" + ",".join(f"{value:.7f}" for value in values)
    return ImageFacts("a.jpg", SIZE, model=model, maker_camera={"DewarpData": text, "DewarpFlag": "0"})


def estimated(stated: StatedCamera) -> Camera:
    """The camera as `photocal new` writes it into a project: all that has a prior is estimated."""
    sigma = stated.prior_sigma()
    return Camera(
        stated.camera.id, stated.camera.model, "px", SIZE, (1.0, 1.0), stated.camera.values,
        np.array([name in sigma for name in PARAMETERS]),
        np.array([sigma.get(name, np.inf) for name in PARAMETERS]),
        affinity="after", stated_by=stated.camera.stated_by,
    )  # fmt: skip


def fly(facts: ImageFacts, seed: int, images: int = 32, points: int = 700) -> Block:
    """Four strips at one height and two crossing ones above, over hills; positions by RTK."""
    rng = np.random.default_rng(seed)
    per = images // 4
    places, headings = [], []
    for k in range(4):
        cross, height = k >= 2, HEIGHTS_M[k >= 2]
        along = (np.arange(per) - (per - 1) / 2) * 7.0 * (height / HEIGHTS_M[0])
        across = np.full(per, (k % 2 - 0.5) * 16.0)
        x, y = (across, along) if cross else (along, across)
        places.append(np.column_stack([x, y, np.full(per, height)]))
        headings.append(np.full(per, (np.pi / 2 if cross else 0.0) + (np.pi if k % 2 else 0.0)))
    centre = np.vstack(places) + rng.normal(0, [0.4, 0.4, 0.2], (4 * per, 3))
    heading = np.concatenate(headings) + rng.normal(0, 0.02, 4 * per)
    reach = np.abs(centre[:, :2]).max(axis=0) + 12.0
    ground = np.column_stack([rng.uniform(-reach, reach, (points, 2)), np.zeros(points)])
    ground[:, 2] = 2.0 * np.sin(ground[:, 0] / 9.0) + 1.5 * np.cos(ground[:, 1] / 7.0)
    matrix = np.array([[FX, 0, (SIZE[0] - 1) / 2 + CX], [0, FY, (SIZE[1] - 1) / 2 + CY], [0, 0, 1]])
    image, point, pixel, poses = [], [], [], []
    for i in range(4 * per):
        tilt = rng.normal(0, np.radians(2.0), 2)
        # The upper edge looks ahead.
        photo = Rotation.from_euler("xyz", [*tilt, heading[i] - np.pi / 2]).as_matrix().T
        down = CV_TO_PHOTO @ photo
        vector = -down @ centre[i]
        seen = cv2.projectPoints(
            ground, cv2.Rodrigues(down)[0], vector, matrix, np.array([K1, K2, 0.0, 0.0, K3])
        )[0][:, 0]
        slope = (ground - centre[i]) @ down.T
        near = np.hypot(slope[:, 0], slope[:, 1]) < 0.62 * slope[:, 2]
        inside = near & (seen > 5).all(axis=1) & (seen < np.array(SIZE) - 6).all(axis=1)
        rows = np.flatnonzero(inside)
        image += [i] * len(rows)
        point += rows.tolist()
        pixel.append(seen[rows] + rng.normal(0, NOISE_PX, (len(rows), 2)))
        poses.append(angles_from_matrix(photo))
    counts = np.bincount(point, minlength=points)
    used = np.flatnonzero(counts >= 3)
    number = np.full(points, -1)
    number[used] = np.arange(len(used))
    keep = number[np.array(point)] >= 0
    names = tuple(f"{i:03}.jpg" for i in range(4 * per))
    values = np.hstack([np.array(poses), centre + rng.normal(0, SIGMA_M, centre.shape)])
    sigma = np.hstack([np.full((4 * per, 3), np.inf), np.tile(SIGMA_M, (4 * per, 1))])
    pixels = np.vstack(pixel)[keep]
    return Block(
        "tagged", "local", "", "control", (estimated(stated_camera("p4m", facts)),),
        Images(names, np.zeros(4 * per, np.int64), values, sigma, time=np.arange(4.0 * per)),
        ObjectPoints(tuple(f"t{j}" for j in used), ground[used] + rng.normal(0, 0.1, (len(used), 3))),
        Observations(
            "px", "pixel", np.array(image)[keep], number[np.array(point)][keep],
            pixels, np.full(pixels.shape, NOISE_PX)
        ),
    )  # fmt: skip


def write_project(folder: Path, block: Block) -> Path:
    """Write a project of the ready block."""
    folder.mkdir(parents=True, exist_ok=True)
    write_block(folder / "block", block)
    (folder / "project.toml").write_text(PROJECT, encoding="utf-8")
    return folder / "project.toml"

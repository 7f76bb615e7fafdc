"""The block that tie points are added to: cameras and images, from what the images say of themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.arrays import Flags, Floats
from photocal.block.model import Block, Images, ObjectPoints, Observations
from photocal.geometry.camera import PARAMETERS
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.maker_camera import stated_camera
from photocal.measurement.start_camera import group_cameras

# Sigma of a position that the image does not state, m: single-frequency receivers in the air.
POSITION_SIGMA_M = (1.5, 1.5, 3.0)
# A level block without control says little about c, x0 and y0, which go with the heights and the
# positions: they are held until somebody asks for them.
ESTIMATE = ("K1", "K2")
# Fewer positions do not fix a datum.
FEWEST_POSITIONS = 3
NO_POINTS = ObjectPoints((), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
NO_OBSERVATIONS = Observations(
    "px",
    "pixel",
    np.zeros(0, dtype=np.int64),
    np.zeros(0, dtype=np.int64),
    np.zeros((0, 2)),
    np.zeros((0, 2)),
)


def start_block(facts: Sequence[ImageFacts], places: Floats, name: str) -> Block:
    """Make a block of images without points."""
    names, member = group_cameras(facts)
    cameras = []
    for k, camera_name in enumerate(names):
        one = facts[int(np.flatnonzero(member == k)[0])]
        stated = stated_camera(camera_name, one)
        estimated = np.array([name in ESTIMATE for name in PARAMETERS])
        cameras.append(replace(stated.camera, estimated=estimated, guessed=stated.guessed))
    poses = np.full((len(facts), 6), np.nan)
    poses[:, 3:] = places
    sigma = np.full((len(facts), 6), np.inf)
    sigma[:, 3:] = position_sigma(facts)
    sigma[np.isnan(places).any(axis=1)] = np.inf
    enough = np.isfinite(places).all(axis=1).sum() >= FEWEST_POSITIONS
    return Block(
        name,
        "local",
        "",
        "control" if enough else "free",
        (),
        tuple(cameras),
        Images(tuple(f.name for f in facts), member, poses, sigma),
        NO_POINTS,
        NO_OBSERVATIONS,
        (),
    )


def position_sigma(
    facts: Sequence[ImageFacts], assumed: tuple[float, float, float] = POSITION_SIGMA_M
) -> Floats:
    """Sigma of the positions, east, north, up, shape (n, 3): as stated, else assumed."""
    stated = np.array([f.position_sigma_m for f in facts])
    return np.where(np.isfinite(stated) & (stated > 0), stated, assumed)


def without_images(block: Block, gone: Flags) -> Block:
    """Take images out of a block, with their observations and the cameras of no other image; points stay.

    gone (images,).
    """
    keep = np.flatnonzero(~gone)
    images, seen = block.images, block.observations
    place = np.full(len(gone), -1)
    place[keep] = np.arange(len(keep))
    left = place[seen.image] >= 0
    cameras, camera = np.unique(images.camera[keep], return_inverse=True)
    return replace(
        block,
        cameras=tuple(block.cameras[k] for k in cameras),
        images=Images(
            tuple(images.names[k] for k in keep),
            camera.astype(np.int64),
            images.values[keep],
            images.sigma[keep],
        ),
        observations=replace(
            seen,
            image=place[seen.image[left]],
            point=seen.point[left],
            values=seen.values[left],
            sigma=seen.sigma[left],
        ),
    )

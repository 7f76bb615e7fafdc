"""The block that tie points are added to: cameras and images, from what the images say of themselves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers
from photocal.block.model import Block, Images
from photocal.geometry.camera import Camera, among
from photocal.measurement.image_facts import ImageFacts, camera_temperatures, clock_seconds
from photocal.measurement.maker_camera import group_cameras, stated_camera

# Sigma of a position that the image does not state, m: single-frequency receivers in the air.
POSITION_SIGMA_M = (1.5, 1.5, 3.0)
# A level block without control says little about c, x0 and y0, which go with the heights and the
# positions: they are held until somebody asks for them.
ESTIMATE = ("K1", "K2")


def stated_cameras(facts: Sequence[ImageFacts]) -> tuple[tuple[Camera, ...], Integers]:
    """Cameras as images state them, little of them estimated, and which of them took each image."""
    names, member = group_cameras(facts)
    cameras = []
    for k, camera_name in enumerate(names):
        image = facts[int(np.flatnonzero(member == k)[0])]
        stated = stated_camera(camera_name, image)
        free, guessed = among(*ESTIMATE), stated.guessed
        cameras.append(replace(stated.camera, estimated=free, guessed=guessed, shutter="unknown"))
    return tuple(cameras), member


def start_block(
    facts: Sequence[ImageFacts],
    places: Floats,
    name: str,
    assumed: tuple[float, float, float] | None = POSITION_SIGMA_M,
    given: tuple[tuple[Camera, ...], Integers] | None = None,
) -> Block:
    """Make a block of images without points.

    assumed: sigma of positions that the images do not state; None leaves all of them free.
    given: cameras, and which of them took each image; without, as the images state.
    """
    cameras, member = stated_cameras(facts) if given is None else given
    poses = np.full((len(facts), 6), np.nan)
    poses[:, 3:] = places
    sigma = np.full((len(facts), 6), np.inf)
    if assumed is not None:
        sigma[:, 3:] = position_sigma(facts, assumed)
    sigma[np.isnan(places).any(axis=1)] = np.inf
    # Fewer positions do not fix a datum.
    fewest_positions = 3
    enough = np.isfinite(places).all(axis=1).sum() >= fewest_positions
    images = Images(
        tuple(f.name for f in facts),
        member,
        poses,
        sigma,
        time=clock_seconds(facts),
        temperature=camera_temperatures(facts),
    )
    return Block(name, "local", "", "control" if enough else "free", cameras, images)


def position_sigma(
    facts: Sequence[ImageFacts], assumed: tuple[float, float, float] = POSITION_SIGMA_M
) -> Floats:
    """Sigma of the positions, east, north, up, shape (n, 3): as stated, else assumed."""
    stated = np.array([f.position_sigma_m for f in facts])
    return np.where(np.isfinite(stated) & (stated > 0), stated, assumed)


def without_images(block: Block, gone: Flags) -> Block:
    """Take images out of a block, with their observations and the cameras of no other image; points stay."""
    keep = np.flatnonzero(~gone)
    images, seen = block.images, block.observations
    place = np.full(len(gone), -1)
    place[keep] = np.arange(len(keep))
    left = place[seen.image] >= 0
    cameras, camera = np.unique(images.camera[keep], return_inverse=True)
    return replace(
        block,
        cameras=tuple(block.cameras[k] for k in cameras),
        images=replace(images.some(keep), camera=camera.astype(np.int64)),
        observations=replace(seen.rows(left), image=place[seen.image[left]]),
    )


def without_single_rays(block: Block) -> Block:
    """Take out what is measured in one image only: of a free block it determines nothing."""
    seen = block.observations
    count = np.bincount(seen.point, minlength=len(block.points.names))
    return replace(block, observations=seen.rows(count[seen.point] > 1))

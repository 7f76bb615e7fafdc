"""The block that tie points are added to: cameras and images, from what the images say of themselves."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Bytes, Flags, Floats
from photocal.base.errors import PhotocalError
from photocal.block.model import Block, Images
from photocal.geometry.camera import among
from photocal.measurement.image_facts import ImageFacts, clock_seconds
from photocal.measurement.image_file import as_eight_bit, read_grey
from photocal.measurement.maker_camera import group_cameras, stated_camera

# Shares of a picture that are white or black, of which nothing can be seen; and its sharpness beside that of
# the others when it is blurred.
WHITE, BLACK, BURNT = 250, 5, 0.4
BLURRED = 0.4
# Pictures that sharpness is compared with.
OTHERS = 3
# Sigma of a position that the image does not state, m: single-frequency receivers in the air.
POSITION_SIGMA_M = (1.5, 1.5, 3.0)
# A level block without control says little about c, x0 and y0, which go with the heights and the
# positions: they are held until somebody asks for them.
ESTIMATE = ("K1", "K2")
# Fewer positions do not fix a datum.
FEWEST_POSITIONS = 3


def explained(
    left_out: Iterable[Mapping[str, str]], paths: Mapping[str, Path], facts: Sequence[ImageFacts]
) -> list[dict[str, str]]:
    """Reasons with what the picture itself has to do with them."""
    entries = [dict(entry) for entry in left_out]
    gone = {entry["image"] for entry in entries}
    of_image = {image.name: image for image in facts}
    cameras = Counter(_camera(image) for image in facts if image.name not in gone)
    usual = cameras.most_common(1)[0][0] if cameras else ""
    others = [path for name, path in paths.items() if name not in gone] if gone & set(paths) else []
    pictures = [grey for path in others[:OTHERS] if (grey := _read(path)) is not None]
    sharp = [_sharpness(grey) for grey in pictures]
    for entry in entries:
        image, path = of_image.get(entry["image"]), paths.get(entry["image"])
        if image is None or path is None:
            continue
        also = [f"taken by another camera ({_camera(image)})"] if usual and _camera(image) != usual else []
        also += _appearance(_read(path), sharp)
        entry["reason"] = "; ".join([entry["reason"], *also])
    return entries


def _camera(image: ImageFacts) -> str:
    width, height = image.size_px
    return " ".join(part for part in (image.model or image.make, f"{width} x {height} px") if part)


def _read(path: Path) -> Bytes | None:
    try:
        return as_eight_bit(read_grey(path))
    except PhotocalError:
        return None


def _appearance(grey: Bytes | None, sharp: Sequence[float]) -> list[str]:
    if grey is None:
        return []
    white, black = float(np.mean(grey >= WHITE)), float(np.mean(grey <= BLACK))
    if white > BURNT:
        return [f"over-exposed: {white:.0%} of it is white"]
    if black > BURNT:
        return [f"under-exposed: {black:.0%} of it is black"]
    if len(sharp) == OTHERS and _sharpness(grey) < BLURRED * float(np.median(sharp)):
        return ["blurred"]
    return []


def _sharpness(grey: Bytes) -> float:
    """Finest detail over all contrast."""
    import cv2

    fine = cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), 1.0), cv2.CV_32F)
    return float(fine.std() / max(float(grey.std()), 1.0))


def start_block(facts: Sequence[ImageFacts], places: Floats, name: str) -> Block:
    """Make a block of images without points."""
    names, member = group_cameras(facts)
    cameras = []
    for k, camera_name in enumerate(names):
        image = facts[int(np.flatnonzero(member == k)[0])]
        stated = stated_camera(camera_name, image)
        free, guessed = among(*ESTIMATE), stated.guessed
        cameras.append(replace(stated.camera, estimated=free, guessed=guessed, shutter="unknown"))
    poses = np.full((len(facts), 6), np.nan)
    poses[:, 3:] = places
    sigma = np.full((len(facts), 6), np.inf)
    sigma[:, 3:] = position_sigma(facts)
    sigma[np.isnan(places).any(axis=1)] = np.inf
    enough = np.isfinite(places).all(axis=1).sum() >= FEWEST_POSITIONS
    images = Images(tuple(f.name for f in facts), member, poses, sigma, time=clock_seconds(facts))
    return Block(name, "local", "", "control" if enough else "free", tuple(cameras), images)


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

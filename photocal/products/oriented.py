"""Oriented images of a block folder, and their cameras as the kernels of the orthophoto take them."""

from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.model import Block
from photocal.block.network import block_frame
from photocal.block.results.folder import read_result
from photocal.exchange.formats import read_any_block
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.frames import LocalFrame
from photocal.geometry.lens import optics
from photocal.geometry.oriented_images import OrientedImages
from photocal.products.kernels import LensTables, Poses, look_up


def lens_tables(cameras: tuple[Camera, ...]) -> LensTables:
    """Gather what the kernels need of the cameras."""
    return LensTables(
        np.array([camera.values for camera in cameras]),
        np.array([optics(camera) for camera in cameras]),
        np.array([camera.pitch for camera in cameras], dtype=float),
        np.array([camera.size_px for camera in cameras], dtype=float),
        np.array([ideal_limit(camera) for camera in cameras]),
    )


def best_places(
    ground: Floats, lenses: LensTables, shots: OrientedImages, candidates: Integers
) -> tuple[Floats, Integers]:
    """Choose for every ground point, (n, 3), the image with the best nadir among candidates.

    returns place (2, n): column and row in it, px.
    returns chosen (n,): image of each point; -1 for none.
    """
    place, chosen = np.full((2, len(ground)), np.nan), np.full(len(ground), -1, dtype=np.int64)
    poses = Poses(shots.camera, shots.rotation, shots.station, shots.movements)
    look_up(ground, lenses, poses, candidates, place, chosen)
    return place, chosen


def border(per_side: int = 64) -> Floats:
    """Places along the outer edge of an image as shares of its sides, shape (4 per_side, 2)."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    sides = np.roll(corners, -1, axis=0) - corners
    share = np.arange(per_side)[:, None] / per_side
    return np.asarray((corners[:, None] + share * sides[:, None]).reshape(-1, 2))


def ideal_limit(camera: Camera) -> float:
    """Largest ideal radius that lies in the image, in the camera's unit."""
    edge = pixel_to_plane(camera.size_px, camera.pitch, border() * camera.size_px - 0.5)
    ideal = np.linalg.norm(undistorted(camera, edge), axis=1)
    # The limit only spares work beyond the image, it must never cut into it.
    seen = ideal[np.isfinite(ideal)].max(initial=0.0)
    whole = bool(np.isfinite(ideal).all())
    limit = 1.05 * seen if whole else np.inf
    if camera.model == "brown-ideal":
        limit = min(limit, _turning_radius(camera))
    return float(limit)


def _turning_radius(camera: Camera) -> float:
    """First radius at which r + r rad(r) stops growing; infinite when it never does."""
    k = camera.values[3:7]
    r0 = camera.reference_radius**2
    constant = 1 - sum(kn * r0**n for n, kn in enumerate(k, start=1))
    polynomial = [*((2 * n + 1) * k[n - 1] for n in (4, 3, 2, 1)), constant]
    roots = np.roots(np.trim_zeros(polynomial, "f"))
    real = roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real
    return float(np.sqrt(real.min(initial=np.inf)))


def oriented(folder: Path, run: Path | None) -> tuple[Block, LocalFrame, OrientedImages]:
    """Read a block and, where it was adjusted, the results in place of its start values.

    returns frame: between the block's coordinates and the local ones of the images.
    raises InputNotFoundError, InputMalformedError, ConfigurationError: for what cannot be read, or results
        that belong to another block.
    """
    block = read_any_block(folder)
    frame = block_frame(block)
    for camera in block.cameras:
        if (camera.deviation_sigma > 0).any():
            raise ConfigurationError(
                f"camera {camera.id} has parameters that vary from image to image",
                "adjust with a lens that does not vary; products need one lens for all images",
                where=folder,
            )
    images = OrientedImages(block.images.names, block.cameras, block.images.camera, block.images.values)
    if run is not None:
        images = _adjusted(images, run)
    return block, frame, images.in_local(frame)


def _adjusted(images: OrientedImages, run: Path) -> OrientedImages:
    """Give the images of a block as a run adjusted them."""
    result = read_result(run)
    adjusted = result.images.named(images.names)
    lost = [name for name, camera in zip(adjusted.names, adjusted.camera, strict=True) if camera < 0]
    strange = [camera.id for camera in images.cameras if camera.id not in result.cameras]
    if lost or strange:
        what = f"image {lost[0]}" if lost else f"camera {strange[0]}"
        raise InputMalformedError(f"lacks {what}", "name the run of this block", where=run)
    return adjusted

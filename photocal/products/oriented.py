"""Oriented images of a block folder, as given or as adjusted."""

from __future__ import annotations

from pathlib import Path

from drivers.errors import ConfigurationError, InputMalformedError
from photocal.block.model import Block
from photocal.block.network import block_frame
from photocal.exchange.formats import read_any_block
from photocal.geometry.frames import Frame
from photocal.geometry.oriented_images import OrientedImages
from photocal.results.folder import read_result


def oriented(folder: Path, run: Path | None) -> tuple[Block, Frame, OrientedImages]:
    """Read a block and, where it was adjusted, the results in place of its start values.

    run: folder of its adjustment.
    returns frame: between the block's coordinates and the local ones of the images.
    raises InputNotFoundError, InputMalformedError, ConfigurationError: for what cannot be read, or results
        that belong to another block.
    """
    block = read_any_block(folder)
    frame = block_frame(block)
    for own in block.cameras:
        if (own.deviation_sigma > 0).any():
            raise ConfigurationError(
                f"camera {own.id} has parameters that vary from image to image",
                where=folder,
                remedy="adjust with a lens that does not vary; products take one lens for all images",
            )
    images = OrientedImages(block.images.names, block.cameras, block.images.camera, block.images.values)
    if run is not None:
        images = _adjusted(images, run)
    return block, frame, images.in_local(frame)


def _adjusted(images: OrientedImages, run: Path) -> OrientedImages:
    """Give the images of a block as a run adjusted them."""
    result = read_result(run)
    found = result.images.named(images.names)
    lost = [name for name, camera in zip(found.names, found.camera, strict=True) if camera < 0]
    strange = [own.id for own in images.cameras if own.id not in result.cameras]
    if lost or strange:
        what = f"image {lost[0]}" if lost else f"camera {strange[0]}"
        raise InputMalformedError(f"lacks {what}", where=run, remedy="name the run of this very block")
    return found

"""A camera that was not the same all the time: one principal distance before and one after an image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.adjust import adjust
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS

Floats = NDArray[np.float64]

# So many places are tried where the camera may have changed.
_MOST_PLACES = 6
# On either side; fewer say nothing of a principal distance.
_FEWEST_IMAGES = 4


@dataclass(frozen=True)
class Change:
    """Where a second camera begins.

    Attributes
    ----------
    image : int
        Its first image.
    values : ndarray, shape (13,)
        Its parameters: start values of those that are free.
    """

    image: int
    values: Floats


def places_of_change(block: Block) -> tuple[int, ...]:
    """List the images before which the camera may have changed: first ones of strips, else quarters."""
    count = len(block.images.names)
    if len(block.cameras) != 1 or count < 2 * _FEWEST_IMAGES:
        return ()
    strip = np.full(count, -1)
    strip[block.positions.image] = block.positions.strip
    first = np.flatnonzero((np.diff(strip) != 0) & (strip[1:] >= 0) & (strip[:-1] >= 0)) + 1
    if not len(first):
        first = np.arange(1, 4) * count // 4
    first = first[(first >= _FEWEST_IMAGES) & (first <= count - _FEWEST_IMAGES)]
    chosen = np.linspace(0, len(first) - 1, min(len(first), _MOST_PLACES)).round().astype(int)
    return tuple(int(first[k]) for k in np.unique(chosen))


def split_at(block: Block, change: Change, loose: float) -> Block:
    """Return the block with a second camera from an image on, the principal distances of both free."""
    (own,) = block.cameras
    c = PARAMETERS.index("c")
    estimated, sigma = own.estimated.copy(), own.prior_sigma.copy()
    estimated[c], sigma[c] = True, loose * own.value("c")
    first = replace(own, estimated=estimated, prior_sigma=sigma)
    later = block.images.names[change.image]
    second = replace(first.with_values(change.values), id=f"{own.id} from {later}")
    camera = np.where(np.arange(len(block.images.names)) >= change.image, 1, 0)
    return replace(block, cameras=(first, second), images=replace(block.images, camera=camera))


def unknowns_of_change(block: Block) -> int:
    """Count what `split_at` frees in a block with one camera: the second camera, and c of the first."""
    (own,) = block.cameras
    free = own.estimated.copy()
    c = PARAMETERS.index("c")
    held = not free[c]
    free[c] = True
    return int(free.sum()) + int(held)


def best_change(block: Block, values: Floats, loose: float) -> Change | None:
    """Find the image from which a second camera explains most."""
    best: tuple[float, Change] | None = None
    for image in places_of_change(block):
        change = Change(image, values)
        try:
            chi_squared = adjust(assemble(split_at(block, change, loose)).network).chi_squared
        except (IllPosedError, NotConvergedError):
            continue
        if best is None or chi_squared < best[0]:
            best = chi_squared, change
    return None if best is None else best[1]

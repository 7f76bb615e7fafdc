"""Where features of one image are sought in another, once a few matches are known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Floats, Integers

Floats32 = NDArray[np.float32]

# The search reaches so many times farther than the known matches lie off their common homography, and this
# part of the image at least: between them the ground may rise higher.
_REACH, _LEAST_PART = 2.0, 0.05
# A search that reaches farther than this part of the image saves nothing; what lies so far off is no match.
_MOST_PART, _WILD_PART = 0.15, 0.25
# The nearest of a few is nearest by chance.
_FEWEST = 10


def search_windows(
    first: Floats32, second: Floats32, known_first: Floats32, known_second: Floats32
) -> list[tuple[Integers, Integers]] | None:
    """Features of the first image, a few neighbours at a time, and those of the second that they may match.

    A homography takes the one image to the other. How far the known matches lie off it, because the ground
    is not a plane, tells how far to seek.
    """
    import cv2

    extent = float(np.ptp(second, axis=0).max())
    # No result may depend on chance.
    cv2.setRNGSeed(len(known_first))
    found: Any = cv2.findHomography(known_first, known_second, cv2.USAC_MAGSAC, _LEAST_PART * extent)[0]
    if found is None:
        return None
    off = np.hypot(*(_moved(found, known_first) - known_second).T)
    off = off[off < _WILD_PART * extent]
    if len(off) < _FEWEST:
        return None
    reach = max(_REACH * float(np.quantile(off, 0.95)), _LEAST_PART * extent)
    if reach > _MOST_PART * extent:
        return None
    aim = _moved(found, first)
    with np.errstate(invalid="ignore"):
        near = (aim >= second.min(axis=0) - reach) & (aim <= second.max(axis=0) + reach)
    rows = np.flatnonzero(near.all(axis=1))
    cell = np.floor(aim[rows] / reach).astype(np.int64)
    cells, member = np.unique(cell, axis=0, return_inverse=True)
    rows = rows[np.argsort(np.ravel(member), kind="stable")]
    counts = np.bincount(np.ravel(member), minlength=len(cells))
    # Sorted by row, those within a range of rows stand together.
    down = np.argsort(second[:, 1], kind="stable")
    across, height = second[down, 0], second[down, 1]
    windows = []
    for place, mine in zip(cells, np.split(rows, np.cumsum(counts)[:-1]), strict=True):
        low, high = (place - 1) * reach, (place + 2) * reach
        begin, end = np.searchsorted(height, (low[1], high[1]))
        inside = (across[begin:end] >= low[0]) & (across[begin:end] <= high[0])
        there = np.sort(down[begin:end][inside])
        if len(there) >= _FEWEST:
            windows.append((mine, there))
    return windows


def _moved(homography: Floats, pixels: Floats32) -> Floats:
    """Pixels taken through a homography; NaN beyond its horizon."""
    moved = pixels.astype(float) @ homography[:, :2].T + homography[:, 2]
    ahead = moved[:, 2:] > 0
    return np.where(ahead, moved[:, :2] / np.where(ahead, moved[:, 2:], 1.0), np.nan)

"""Matches between the features of two images: ratio test, cross check, epipolar geometry."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from photocal.base.arrays import Bytes, Flags, Floats, Integers
from photocal.measurement.features import Features, Floats32

# The search reaches so many times farther than the known matches lie off their common homography, and this
# part of the image at least: between them the ground may rise higher.
_REACH, _LEAST_PART = 2.0, 0.05
# A search that reaches farther than this part of the image saves nothing; what lies so far off is no match.
_MOST_PART, _WILD_PART = 0.15, 0.25

# A nearest of fewer than these is nearest by chance.
_FEWEST_NEAR = 10


@dataclass(frozen=True)
class Windows:
    """Features of the first image, some neighbours at a time, and those of the second that they may match.

    rows (n,): features of the first image, window by window.
    begins (windows + 1,): where each window begins in them.
    columns (m,): features of the second image.
    spans (windows, k, 2): those of a window: where each of k parts of them begins and ends in `columns`.
    """

    rows: Integers
    begins: Integers
    columns: Integers
    spans: Integers


def everything(first: int, second: int) -> Windows:
    """Windows of so many features of the first image, each with all of the second."""
    # Likenesses of so many features at a time fit into the processor's cache.
    together = 256
    begins = np.r_[np.arange(0, first, together), first].astype(np.int64)
    spans = np.tile(np.array([0, second]), (len(begins) - 1, 1, 1))
    return Windows(np.arange(first), begins, np.arange(second), spans)


def search_windows(
    first: Floats32, second: Floats32, known_first: Floats32, known_second: Floats32
) -> Windows | None:
    """Seek matches where known matches say; None where these say too little.

    A homography takes the one image to the other. How far the known matches lie off it, because the ground
    is not a plane, tells how far to seek.
    """
    import cv2

    extent = float(np.ptp(second, axis=0).max())
    # No result may depend on chance.
    cv2.setRNGSeed(len(known_first))
    homography: Any = cv2.findHomography(known_first, known_second, cv2.USAC_MAGSAC, _LEAST_PART * extent)[0]
    if homography is None:
        return None
    off = np.hypot(*(_moved(homography, known_first) - known_second).T)
    off = off[off < _WILD_PART * extent]
    if len(off) < _FEWEST_NEAR:
        return None
    reach = max(_REACH * float(np.quantile(off, 0.95)), _LEAST_PART * extent)
    if reach > _MOST_PART * extent:
        return None
    aim = _moved(homography, first)
    with np.errstate(invalid="ignore"):
        near = (aim >= second.min(axis=0) - reach) & (aim <= second.max(axis=0) + reach)
    rows = np.flatnonzero(near.all(axis=1))
    # Cells as long as the search reaches: what may match a feature of one lies in it or beside it. A margin
    # of empty cells all round spares the search at the edges. The cells of one row stand together.
    origin = np.minimum(aim[rows].min(axis=0, initial=np.inf), second.min(axis=0)) - reach
    cells = (_cells(places, origin, reach) for places in (aim[rows], second))
    (down, across), (down_there, across_there) = cells
    width = int(max(across.max(initial=0), across_there.max(initial=0))) + 2
    cell, there = down * width + across, down_there * width + across_there
    order, columns = np.argsort(cell, kind="stable"), np.argsort(there, kind="stable")
    used, begins = np.unique(cell[order], return_index=True)
    middle = used[:, None] + width * np.array([-1, 0, 1])
    spans = np.stack(
        [
            np.searchsorted(there[columns], middle - 1, side="left"),
            np.searchsorted(there[columns], middle + 1, side="right"),
        ],
        axis=2,
    )
    # A window of too few has none.
    spans[(spans[:, :, 1] - spans[:, :, 0]).sum(axis=1) < _FEWEST_NEAR] = 0
    return Windows(rows[order], np.r_[begins, len(rows)], columns, spans)


def _cells(places: Floats | Floats32, origin: Floats, reach: float) -> tuple[Integers, Integers]:
    """Row and column of the cell in which each place lies."""
    across, down = np.floor((places - origin) / reach).astype(np.int64).T
    return down, across


def _moved(homography: Floats, pixels: Floats32) -> Floats:
    """Pixels taken through a homography; NaN beyond its horizon."""
    moved = pixels.astype(float) @ homography[:, :2].T + homography[:, 2]
    ahead = moved[:, 2:] > 0
    return np.where(ahead, moved[:, :2] / np.where(ahead, moved[:, 2:], 1.0), np.nan)


# A match is taken when it is nearer than this part of the distance to the second best, and as near as this to
# the epipolar line, px. A pair needs so many verified matches; by chance a few always agree.
RATIO, EPIPOLAR_PX, FEWEST = 0.85, 2.0, 20
# First only so many features of each image are matched, the coarsest: a pair that has fewer verified matches
# among them is given up, for a small part of the cost. By chance about ten agree. The others are matched only
# where these say that they should be.
SKETCH, SKETCH_FEWEST = 2500, 14


def match(first: Features, second: Features, sketch: int = SKETCH) -> Integers:
    """Match two images and verify the matches by their epipolar geometry.

    sketch: features of each that are matched first.
    returns (n, 2): indices of the features; empty when the images do not belong together.
    """
    windows = None
    if min(len(first.scale), len(second.scale)) > 2 * sketch:
        orders = ((features, np.argsort(-features.scale, kind="stable")) for features in (first, second))
        coarse = [features.rows(order[:sketch]) for features, order in orders]
        known = _verified(coarse[0], coarse[1], SKETCH_FEWEST)
        if len(known) < SKETCH_FEWEST:
            return np.zeros((0, 2), dtype=np.int64)
        places = [features.pixels[index] for features, index in zip(coarse, known.T, strict=True)]
        windows = search_windows(first.pixels, second.pixels, places[0], places[1])
    pairs = _verified(first, second, FEWEST, windows)
    return pairs if len(pairs) >= FEWEST else pairs[:0]


def _verified(first: Features, second: Features, fewest: int, windows: Windows | None = None) -> Integers:
    """Matches that agree with one epipolar geometry; none is looked for where there are fewer than asked."""
    pairs = mutual_matches(first.descriptors, second.descriptors, RATIO, windows)
    if len(pairs) < fewest:
        return pairs[:0]
    keep = epipolar_inliers(first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]], EPIPOLAR_PX)
    return pairs[keep]


def mutual_matches(first: Bytes, second: Bytes, ratio: float, windows: Windows | None = None) -> Integers:
    """Features that are each other's nearest, clearly before the second nearest (Lowe 2004)."""
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    windows = windows or everything(len(first), len(second))
    # Descriptors are compared by the Hellinger kernel (Arandjelovic and Zisserman 2012).
    a, b = _rooted(first[windows.rows]), _rooted(second[windows.columns])
    there = np.zeros(len(a), dtype=np.int64)
    best, second_best = np.full((2, len(a)), -1.0, dtype=np.float32)
    back = np.full(len(b), -1.0, dtype=np.float32)
    for (start, end), spans in zip(pairwise(windows.begins), windows.spans, strict=True):
        near = np.concatenate([np.arange(low, high) for low, high in spans])
        if not len(near):
            continue
        alike, rows = a[start:end] @ b[near].T, np.arange(end - start)
        nearest = alike.argmax(axis=1)
        there[start:end], best[start:end] = near[nearest], alike[rows, nearest]
        back[near] = np.maximum(back[near], alike.max(axis=0))
        alike[rows, nearest] = -1.0
        second_best[start:end] = alike.max(axis=1)
    # Of likenesses: distance^2 = 2 - 2 likeness. The nearest of my nearest is me when nobody is nearer to it.
    good = (1 - best < ratio**2 * (1 - second_best)) & (best >= back[there])
    pairs = np.column_stack([windows.rows[good], windows.columns[there[good]]])
    return pairs[np.argsort(pairs[:, 0], kind="stable")]


def epipolar_inliers(first: Floats32, second: Floats32, tolerance_px: float) -> Flags:
    """Matches that agree with one epipolar geometry (MAGSAC++, Barath et al. 2020)."""
    import cv2

    none = np.zeros(len(first), dtype=np.bool_)
    if len(first) < 8:
        return none
    # No result may depend on chance.
    cv2.setRNGSeed(len(first))
    try:
        fundamental: Any = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, tolerance_px, 0.9999, 5000)
    except cv2.error:
        return none
    mask = fundamental[1]
    return none if mask is None else np.asarray(np.ravel(mask) > 0)


def _rooted(descriptors: Bytes) -> Floats32:
    values = descriptors.astype(np.float32)
    values /= np.maximum(values.sum(axis=1, keepdims=True), 1e-6)
    return np.sqrt(values, out=values)

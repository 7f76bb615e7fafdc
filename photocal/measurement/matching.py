"""Matches between the features of two images: ratio test, cross check, epipolar geometry."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Bytes, Flags, Floats, Integers
from photocal.measurement.features import Features

Floats32 = NDArray[np.float32]

# The search reaches so many times farther than the known matches lie off their common homography, and this
# part of the image at least: between them the ground may rise higher.
_REACH, _LEAST_PART = 2.0, 0.05
# A search that reaches farther than this part of the image saves nothing; what lies so far off is no match.
_MOST_PART, _WILD_PART = 0.15, 0.25
# The nearest of a few is nearest by chance.
_FEWEST = 10
# So many features at a time: their likenesses fit into the processor's cache.
_BLOCK = 512

Window = tuple[Integers, Integers] | tuple[slice, slice]


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
    homography: Any = cv2.findHomography(known_first, known_second, cv2.USAC_MAGSAC, _LEAST_PART * extent)[0]
    if homography is None:
        return None
    off = np.hypot(*(_moved(homography, known_first) - known_second).T)
    off = off[off < _WILD_PART * extent]
    if len(off) < _FEWEST:
        return None
    reach = max(_REACH * float(np.quantile(off, 0.95)), _LEAST_PART * extent)
    if reach > _MOST_PART * extent:
        return None
    aim = _moved(homography, first)
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
    for place, together in zip(cells, np.split(rows, np.cumsum(counts)[:-1]), strict=True):
        low, high = (place - 1) * reach, (place + 2) * reach
        begin, end = np.searchsorted(height, (low[1], high[1]))
        inside = (across[begin:end] >= low[0]) & (across[begin:end] <= high[0])
        there = np.sort(down[begin:end][inside])
        if len(there) >= _FEWEST:
            windows.append((together, there))
    return windows


def _moved(homography: Floats, pixels: Floats32) -> Floats:
    """Pixels taken through a homography; NaN beyond its horizon."""
    moved = pixels.astype(float) @ homography[:, :2].T + homography[:, 2]
    ahead = moved[:, 2:] > 0
    return np.where(ahead, moved[:, :2] / np.where(ahead, moved[:, 2:], 1.0), np.nan)


@dataclass(frozen=True)
class MatchSettings:
    """How features are matched.

    ratio: A match is taken when it is nearer than this part of the distance to the second best.
    epipolar_px: largest distance from the epipolar line.
    fewest: verified matches that a pair needs; by chance a few always agree.
    sketch, sketch_fewest: first only so many features of each image are matched, the coarsest: a pair that
        has fewer verified matches among them is given up, for a small part of the cost. By chance about ten
        agree. The others are sought only where these say that they should be.
    """

    ratio: float = 0.85
    epipolar_px: float = 2.0
    fewest: int = 20
    sketch: int = 2500
    sketch_fewest: int = 14


def match(first: Features, second: Features, settings: MatchSettings) -> Integers:
    """Match two images and verify the matches by their epipolar geometry.

    returns (n, 2): indices of the features; empty when the images do not belong together.
    """
    large = len(first.scale) > 2 * settings.sketch and len(second.scale) > 2 * settings.sketch
    windows: Iterable[Window] | None = None
    if large:
        orders = ((features, np.argsort(-features.scale, kind="stable")) for features in (first, second))
        coarse = [features.rows(order[: settings.sketch]) for features, order in orders]
        known = _verified(coarse[0], coarse[1], settings)
        if len(known) < settings.sketch_fewest:
            return np.zeros((0, 2), dtype=np.int64)
        places = [features.pixels[index] for features, index in zip(coarse, known.T, strict=True)]
        windows = search_windows(first.pixels, second.pixels, places[0], places[1])
    pairs = _verified(first, second, settings, windows)
    return pairs if len(pairs) >= settings.fewest else pairs[:0]


def _verified(
    first: Features, second: Features, settings: MatchSettings, windows: Iterable[Window] | None = None
) -> Integers:
    pairs = mutual_matches(first.descriptors, second.descriptors, settings.ratio, windows)
    keep = epipolar_inliers(first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]], settings.epipolar_px)
    return pairs[keep]


def mutual_matches(
    first: Bytes, second: Bytes, ratio: float, windows: Iterable[Window] | None = None
) -> Integers:
    """Features that are each other's nearest, clearly before the second nearest (Lowe 2004)."""
    # Descriptors are compared by the Hellinger kernel (Arandjelovic and Zisserman 2012).
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    a, b = _rooted(first), _rooted(second)
    forward = np.zeros(len(a), dtype=np.int64)
    best = np.zeros(len(a), dtype=np.float32)
    clear = np.zeros(len(a), dtype=np.bool_)
    best_back = np.full(len(b), -1.0, dtype=np.float32)
    if windows is None:
        # All features of one image with all of the other, in pieces.
        windows = ((slice(start, start + _BLOCK), slice(0, len(b))) for start in range(0, len(a), _BLOCK))
    for rows, columns in windows:
        likeness = a[rows] @ b[columns].T
        best_back[columns] = np.maximum(best_back[columns], likeness.max(axis=0))
        each = np.arange(len(likeness))
        nearest = likeness.argmax(axis=1)
        high = likeness[each, nearest]
        likeness[each, nearest] = -1.0
        forward[rows], best[rows] = np.arange(len(b))[columns][nearest], high
        # Of likenesses: distance^2 = 2 - 2 likeness.
        clear[rows] = np.asarray(1 - high < ratio**2 * (1 - likeness.max(axis=1)))
    # The nearest of my nearest is me when nobody is nearer to it than I am.
    good = clear & (best >= best_back[forward])
    return np.column_stack([np.flatnonzero(good), forward[good]]).astype(np.int64)


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

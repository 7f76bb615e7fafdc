"""Features and matches of a set of images: cached, on several processes, bounded in memory.

Matches between the features of two images: ratio test, cross check, epipolar geometry.

Features of a set of images, matched and joined to tracks.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from photocal.base.arrays import Bytes, Flags, Floats, Integers
from photocal.base.errors import InputNotFoundError, OutputError, PhotocalError
from photocal.base.files import digest
from photocal.base.operating_system import cache_folder
from photocal.base.progress import Progress
from photocal.base.workers import Workers, affordable, run_tasks
from photocal.measurement.features import (
    Arrays,
    Features,
    FeatureSettings,
    Floats32,
    array_key,
    cached,
    combined_key,
    detect,
    kept,
)
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import as_eight_bit, each_picture, left_out_entry, read_grey
from photocal.measurement.image_pairs import Footprints, select_pairs
from photocal.measurement.patch_matching import ImageSource
from photocal.measurement.tracks import Tracks, join_tracks, of_images

# The search reaches so many times farther than the known matches lie off their common homography, and this
# part of the image at least: between them the ground may rise higher.
_REACH, _LEAST_PART = 2.0, 0.05
# A search that reaches farther than this part of the image saves nothing; what lies so far off is no match.
_MOST_PART, _WILD_PART = 0.15, 0.25

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
    # The nearest of a few is nearest by chance.
    fewest = 10
    if len(off) < fewest:
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
        if len(there) >= fewest:
            windows.append((together, there))
    return windows


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
    windows: Iterable[Window] | None = None
    if min(len(first.scale), len(second.scale)) > 2 * sketch:
        orders = ((features, np.argsort(-features.scale, kind="stable")) for features in (first, second))
        coarse = [features.rows(order[:sketch]) for features, order in orders]
        known = _verified(coarse[0], coarse[1])
        if len(known) < SKETCH_FEWEST:
            return np.zeros((0, 2), dtype=np.int64)
        places = [features.pixels[index] for features, index in zip(coarse, known.T, strict=True)]
        windows = search_windows(first.pixels, second.pixels, places[0], places[1])
    pairs = _verified(first, second, windows)
    return pairs if len(pairs) >= FEWEST else pairs[:0]


def _verified(first: Features, second: Features, windows: Iterable[Window] | None = None) -> Integers:
    pairs = mutual_matches(first.descriptors, second.descriptors, RATIO, windows)
    keep = epipolar_inliers(first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]], EPIPOLAR_PX)
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
    # So many features at a time: their likenesses fit into the processor's cache.
    block = 512
    if windows is None:
        # All features of one image with all of the other, in pieces.
        windows = ((slice(start, start + block), slice(0, len(b))) for start in range(0, len(a), block))
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


# Raised whenever the meaning of cached results changes: of features, of matches.
FEATURES, MATCHES = 2, 3
# Peak memory of a process that detects features, of 3 to 24 megapixels the same (their pictures are reduced),
# and of the one that joins them.
WORKER_BYTES, OWN_BYTES = 1.2e9, 1.0e9
_NAMES = ("pixels", "scale", "descriptors")


@dataclass(frozen=True)
class MatchingPlan:
    """Where results are kept, how they are made and by how many processes."""

    cache: Path = field(default_factory=cache_folder)
    processes: Workers = field(default_factory=lambda: affordable(WORKER_BYTES, OWN_BYTES))
    features: FeatureSettings = field(default_factory=FeatureSettings)


def detect_all(
    paths: Sequence[Path], plan: MatchingPlan, done: Callable[[float], None]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Detect the features of all images into the cache; give their keys, and why an image cannot be used."""
    images = ((path, combined_key(FEATURES, digest(path), plan.features), plan) for path in paths)
    detected = list(
        run_tasks(_detect_one, images, plan.processes, done, lambda image: kept(plan.cache, image[1]))
    )
    return tuple(key for key, _ in detected), tuple(reason for _, reason in detected)


def same_pictures(keys: Mapping[int, str], plan: MatchingPlan) -> dict[int, int]:
    """Give for each picture the first that shows the same, to the last pixel.

    One that was saved twice, under another name or with other tags, is no second observation.
    """
    first, seen = dict[str, int](), {k: _features(plan, key).pixels for k, key in keys.items()}
    return {k: first.setdefault(array_key(px), k) if len(px) else k for k, px in seen.items()}


def match_all(
    keys: Sequence[str], pairs: Integers, plan: MatchingPlan, done: Callable[[float], None]
) -> tuple[Tracks, Integers]:
    """Match pairs of images and join the matches to tracks."""
    tasks = ((_match_key(keys[a], keys[b]), keys[a], keys[b], plan) for a, b in pairs)
    matches = list(run_tasks(_match_one, tasks, plan.processes, done, lambda task: kept(plan.cache, task[0])))
    # Descriptors stay on the disk: only places and scales of all images are held.
    features = [_features(plan, key) for key in keys]
    return join_tracks(features, pairs, matches), np.array([len(m) for m in matches], dtype=np.int64)


def _detect_one(image: tuple[Path, str, MatchingPlan]) -> tuple[str, str]:
    path, key, plan = image

    def make() -> Arrays:
        """Detect the features of one picture."""
        return dict(vars(detect(as_eight_bit(read_grey(path)), plan.features)))

    try:
        cached(plan.cache, key, _NAMES, make)
    except PhotocalError as refusal:
        if refusal.where != str(path):
            raise
        return "", refusal.what
    return key, ""


def features_of(path: Path, plan: MatchingPlan) -> tuple[str, Features] | None:
    """Features of one picture and their key; None where the picture is damaged.

    The key is empty where the cache cannot be written.

    raises OSError: when the file cannot be opened.
    """
    try:
        key, reason = _detect_one((path, combined_key(FEATURES, digest(path), plan.features), plan))
    except OutputError:
        # Few pictures are examined: without a cache that costs seconds.
        return "", detect(as_eight_bit(read_grey(path)), plan.features)
    return None if reason else (key, _features(plan, key, whole=True))


def matches_of(first: tuple[str, Features], second: tuple[str, Features], plan: MatchingPlan) -> Integers:
    """Matches of two pictures as `features_of` gives them, kept where the cache can be written."""
    (key, one), (other_key, other) = first, second
    if not key or not other_key:
        return match(one, other)
    return _kept_matches(_match_key(key, other_key), plan, lambda: match(one, other))


def _match_key(first: str, second: str) -> str:
    return combined_key(MATCHES, "match", first, second)


def _kept_matches(key: str, plan: MatchingPlan, make: Callable[[], Integers]) -> Integers:
    made = cached(plan.cache, key, ("pairs",), lambda: {"pairs": make()})
    return np.asarray(made["pairs"], dtype=np.int64)


def _match_one(task: tuple[str, str, str, MatchingPlan]) -> Integers:
    key, first, second, plan = task
    whole = partial(_features, plan, whole=True)
    return _kept_matches(key, plan, lambda: match(whole(first), whole(second)))


def _features(plan: MatchingPlan, key: str, *, whole: bool = False) -> Features:
    names = _NAMES if whole else _NAMES[:2]
    held = cached(plan.cache, key, names, dict)
    descriptors = held["descriptors"] if whole else np.zeros((len(held["scale"]), 0), dtype=np.uint8)
    return Features(held["pixels"], held["scale"], descriptors)


# Why a picture is left out that is there twice: nothing is lost with it.
SAME = "same-picture"


@dataclass(frozen=True)
class ImageTracks:
    """Images and the tracks of their features, before anything is oriented.

    facts: of the images that can be used.
    pairs (k, 2).
    rule: by which the pairs were chosen.
    """

    facts: tuple[ImageFacts, ...]
    sources: tuple[ImageSource, ...]
    tracks: Tracks
    pairs: Integers
    verified_pairs: int
    rule: str
    left_out: tuple[dict[str, str], ...]

    def without(self, reasons: Sequence[str]) -> Self:
        """Leave out the images that have a reason; others have an empty one."""
        keep = np.array([not reason for reason in reasons])
        number = np.where(keep, np.cumsum(keep) - 1, -1)
        pairs = number[self.pairs]
        left = [
            left_out_entry(f.name, why, "other-size")
            for f, why in zip(self.facts, reasons, strict=True)
            if why
        ]
        return replace(
            self,
            facts=tuple(f for f, good in zip(self.facts, keep, strict=True) if good),
            sources=tuple(s for s, good in zip(self.sources, keep, strict=True) if good),
            tracks=of_images(self.tracks, keep),
            pairs=pairs[(pairs >= 0).all(axis=1)],
            left_out=(*self.left_out, *left),
        )


def track_images(
    paths: Sequence[Path],
    plan: MatchingPlan,
    progress: Progress,
    looking: Callable[[Sequence[ImageFacts]], Footprints],
    given: Callable[[ImageFacts], ImageFacts],
) -> ImageTracks:
    """Find features in images, match them and join the matches to tracks.

    given: what is known better of an image than it states.
    raises InputNotFoundError: when fewer than two images can be read.
    """
    pictures, left_out = each_picture(paths, lambda path: (path, read_facts(path)))
    readable = [path for path, _ in pictures]
    with progress("detecting features", len(readable)) as done:
        keys, reasons = detect_all(readable, plan, done)
    good = [k for k, reason in enumerate(reasons) if not reason]
    left_out += [left_out_entry(readable[k].name, why, "unreadable") for k, why in enumerate(reasons) if why]
    # Marks name the original, not "copy of" it, nor it with "(1)" behind.
    by_length = sorted(good, key=lambda k: len(readable[k].name))
    first = same_pictures({k: keys[k] for k in by_length}, plan)
    left_out += [
        left_out_entry(readable[k].name, f"is the same picture as {readable[j].name}", SAME)
        for k, j in first.items()
        if j != k
    ]
    good = [k for k in good if first[k] == k]
    facts, keys = [given(pictures[k][1]) for k in good], tuple(keys[k] for k in good)
    if len(facts) < 2:
        raise InputNotFoundError(
            f"{len(facts)} of {len(paths)} images can be used",
            "; ".join(f"{e['image']}: {e['reason']}" for e in left_out[:3]),
            where=paths[0].parent,
        )
    pairs, rule = select_pairs(looking(facts), len(facts))
    with progress("matching pairs of images", len(pairs)) as done:
        tracks, counts = match_all(keys, pairs, plan, done)
    sources = tuple(ImageSource(readable[k], key, plan.cache) for k, key in zip(good, keys, strict=True))
    return ImageTracks(
        tuple(facts), sources, tracks, pairs, int(np.count_nonzero(counts)), rule, tuple(left_out)
    )

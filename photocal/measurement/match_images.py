"""Features and matches of a set of images: cached, on several processes, bounded in memory."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import PhotocalError
from photocal.base.operating_system import cache_folder
from photocal.base.workers import Workers, run_tasks
from photocal.block.model import digest
from photocal.measurement.features import (
    Arrays,
    Features,
    FeatureSettings,
    array_key,
    cached,
    combined_key,
    detect,
)
from photocal.measurement.image_file import as_eight_bit, read_grey
from photocal.measurement.matching import MatchSettings, match
from photocal.measurement.tracks import Tracks, join_tracks

Rule = Literal["footprints", "neighbours", "sequence", "all"]

# Each image is matched with so many others at most: the number of pairs grows with the images, not
# with their square.
MOST_PARTNERS = 24
# Without any exposure: all pairs up to so many images, then those that follow each other.
ALL_UP_TO, SEQUENCE = 60, 12
# Footprints that overlap by less than about a fifth are of no use.
USEFUL = 0.8
# Raised whenever the meaning of cached results changes: of features, of matches.
FEATURES, MATCHES = 2, 2
_NAMES = ("pixels", "scale", "descriptors")


@dataclass(frozen=True)
class Footprints:
    """Where images look, as far as it is known before they are oriented.

    centre (n, 2): middle of the footprint, m; NaN when unknown.
    radius (n,): of a circle with the area of the footprint, m; NaN when the height above ground is unknown.
    """

    centre: Floats
    radius: Floats


def footprints(
    places: Floats, height_m: Floats, yaw_pitch: Floats, size_px: Floats, c_px: Floats
) -> Footprints:
    """Footprints on level ground.

    places (n, 2): east and north of the projection centres, m.
    height_m (n,): above ground.
    yaw_pitch (n, 2): of the camera, radians; pitch -90 degrees looks down, which is assumed where it is
        unknown.
    size_px (n, 2).
    c_px (n,).
    """
    yaw = np.nan_to_num(yaw_pitch[:, 0])
    pitch = np.where(np.isnan(yaw_pitch[:, 1]), -np.pi / 2, yaw_pitch[:, 1])
    # Views to the horizon see everything; what is useful of them ends at 60 degrees from the vertical.
    tilt = np.clip(np.pi / 2 + pitch, 0.0, np.radians(60))
    ahead = height_m * np.tan(tilt)
    centre = places + ahead[:, None] * np.column_stack([np.sin(yaw), np.cos(yaw)])
    radius = height_m / np.cos(tilt) * np.sqrt(size_px.prod(axis=1) / np.pi) / c_px
    return Footprints(np.where(np.isfinite(centre), centre, places), radius)


def select_pairs(seen: Footprints, count: int) -> tuple[Integers, Rule]:
    """Choose the pairs of images to match.

    Few images of which nobody knows where they were taken go with all; many, with those before and after.
    """
    placed = np.isfinite(seen.centre).all(axis=1)
    lost = np.flatnonzero(~placed)
    if len(lost) and count <= ALL_UP_TO:
        return np.column_stack(np.triu_indices(count, 1)).astype(np.int64), "all"
    span = count if len(lost) <= ALL_UP_TO else SEQUENCE
    near = np.arange(-span, span + 1)
    first = np.repeat(lost, len(near))
    second = first + np.tile(near, len(lost))
    good = (second >= 0) & (second < count) & (second != first)
    pairs = [np.column_stack([first, second])[good]]
    rule: Rule = "sequence"
    if placed.sum() >= 2:
        some, rule = _near(seen, np.flatnonzero(placed))
        pairs.append(some)
    return np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0).astype(np.int64), rule


def _near(seen: Footprints, rows: Integers) -> tuple[Integers, Rule]:
    """Pairs of neighbours, of those whose footprints overlap where these are known."""
    from scipy.spatial import KDTree

    partners = min(len(rows), MOST_PARTNERS + 1)
    nearest = KDTree(seen.centre[rows]).query(seen.centre[rows], k=partners)
    distance, other = (np.reshape(part, (len(rows), -1)) for part in nearest)
    first = np.broadcast_to(np.arange(len(rows))[:, None], other.shape)
    near, radius = first != other, seen.radius[rows]
    # Where a height is not known the nearest go together, however far.
    known = np.isfinite(radius[first] + radius[other])
    with np.errstate(invalid="ignore"):
        near &= ~known | (distance < USEFUL * (radius[first] + radius[other]))
    pairs = np.column_stack([rows[first[near]], rows[other[near]]])
    return pairs, "footprints" if known.all() else "neighbours"


@dataclass(frozen=True)
class MatchingPlan:
    """Where results are kept, how they are made and by how many processes."""

    cache: Path = field(default_factory=cache_folder)
    processes: Workers = field(default_factory=lambda: os.cpu_count() or 1)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    matches: MatchSettings = field(default_factory=MatchSettings)


def detect_all(
    paths: Sequence[Path], plan: MatchingPlan, done: Callable[[float], None]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Detect the features of all images into the cache; give their keys, and why an image cannot be used."""
    images = ((path, combined_key(FEATURES, digest(path), plan.features), plan) for path in paths)
    detected = list(run_tasks(_detect_one, images, plan.processes, done))
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
    tasks = ((keys[a], keys[b], plan) for a, b in pairs)
    matches = list(run_tasks(_match_one, tasks, plan.processes, done))
    # Descriptors stay on the disk: only places and scales of all images are held.
    features = [_features(plan, key) for key in keys]
    return join_tracks(features, pairs, matches), np.array([len(m) for m in matches], dtype=np.int64)


def _detect_one(image: tuple[Path, str, MatchingPlan]) -> tuple[str, str]:
    path, key, plan = image

    def make() -> Arrays:
        features = detect(as_eight_bit(read_grey(path)), plan.features)
        return {"pixels": features.pixels, "scale": features.scale, "descriptors": features.descriptors}

    try:
        cached(plan.cache, key, _NAMES, make)
    except PhotocalError as refusal:
        if refusal.where != str(path):
            raise
        return "", refusal.what
    return key, ""


def _match_one(task: tuple[str, str, MatchingPlan]) -> Integers:
    first, second, plan = task
    key = combined_key(MATCHES, "match", first, second, plan.matches)

    def make() -> Arrays:
        pairs = match(_features(plan, first, whole=True), _features(plan, second, whole=True), plan.matches)
        return {"pairs": pairs}

    return np.asarray(cached(plan.cache, key, ("pairs",), make)["pairs"], dtype=np.int64)


def _features(plan: MatchingPlan, key: str, *, whole: bool = False) -> Features:
    names = _NAMES if whole else _NAMES[:2]
    held = cached(plan.cache, key, names, dict)
    descriptors = held["descriptors"] if whole else np.zeros((len(held["scale"]), 0), dtype=np.uint8)
    return Features(held["pixels"], held["scale"], descriptors)

"""Features and matches of a set of images: cached, on several processes, bounded in memory."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from photocal.base.arrays import Integers
from photocal.base.errors import PhotocalError
from photocal.base.operating_system import cache_folder
from photocal.base.workers import Workers, affordable, run_tasks
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

# Raised whenever the meaning of cached results changes: of features, of matches.
FEATURES, MATCHES = 2, 2
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
        """Detect the features of one picture."""
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
        """Match the features of two pictures."""
        pairs = match(_features(plan, first, whole=True), _features(plan, second, whole=True), plan.matches)
        return {"pairs": pairs}

    return np.asarray(cached(plan.cache, key, ("pairs",), make)["pairs"], dtype=np.int64)


def _features(plan: MatchingPlan, key: str, *, whole: bool = False) -> Features:
    names = _NAMES if whole else _NAMES[:2]
    held = cached(plan.cache, key, names, dict)
    descriptors = held["descriptors"] if whole else np.zeros((len(held["scale"]), 0), dtype=np.uint8)
    return Features(held["pixels"], held["scale"], descriptors)

"""Features and matches of a set of images: cached, on several processes, bounded in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.arrays import Integers
from drivers.errors import PhotocalError
from photocal.block.model import digest
from photocal.measurement.cache import Arrays, cached, combined_key
from photocal.measurement.features import Features, FeatureSettings, detect
from photocal.measurement.image_file import as_eight_bit, read_grey
from photocal.measurement.matching import MatchSettings, match
from photocal.measurement.tracks import Tracks, join_tracks
from photocal.tasks.workers import Workers, run_tasks

# Raised whenever the meaning of cached results changes: of features, of matches.
FEATURES, MATCHES = 1, 2
_NAMES = ("pixels", "scale", "descriptors")


@dataclass(frozen=True)
class MatchingPlan:
    """Where results are kept, how they are made and by how many processes."""

    cache: Path
    processes: Workers
    features: FeatureSettings = field(default_factory=FeatureSettings)
    matches: MatchSettings = field(default_factory=MatchSettings)


@dataclass(frozen=True)
class _Image:
    path: Path
    key: str
    plan: MatchingPlan


def detect_all(
    paths: Sequence[Path], plan: MatchingPlan, done: Callable[[float], None]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Detect the features of all images into the cache."""
    keys, reasons = [], []
    images = (_Image(path, combined_key(FEATURES, digest(path), plan.features), plan) for path in paths)
    for key, reason in run_tasks(_detect_one, images, plan.processes):
        keys.append(key)
        reasons.append(reason)
        done(1)
    return tuple(keys), tuple(reasons)


def match_all(
    keys: Sequence[str], pairs: Integers, plan: MatchingPlan, done: Callable[[float], None]
) -> tuple[Tracks, Integers]:
    """Match pairs of images and join the matches to tracks."""
    tasks = ((keys[a], keys[b], plan) for a, b in pairs)
    matches = []
    for found in run_tasks(_match_one, tasks, plan.processes):
        matches.append(found)
        done(1)
    # Descriptors stay on the disk: only places and scales of all images are held.
    features = [_features(plan, key) for key in keys]
    return join_tracks(features, pairs, matches), np.array([len(m) for m in matches], dtype=np.int64)


def _detect_one(image: _Image) -> tuple[str, str]:
    def make() -> Arrays:
        found = detect(as_eight_bit(read_grey(image.path)), image.plan.features)
        return {"pixels": found.pixels, "scale": found.scale, "descriptors": found.descriptors}

    try:
        cached(image.plan.cache, image.key, _NAMES, make)
    except PhotocalError as refusal:
        if refusal.where != str(image.path):
            raise
        return "", refusal.what
    return image.key, ""


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

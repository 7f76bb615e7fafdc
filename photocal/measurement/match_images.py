"""Features of a set of images, matched and joined to tracks: cached, on several processes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Self

import numpy as np

from photocal.base.arrays import Flags, Integers
from photocal.base.errors import InputNotFoundError, OutputError, PhotocalError
from photocal.base.files import digest
from photocal.base.operating_system import cache_folder
from photocal.base.progress import Progress
from photocal.base.workers import Workers, affordable, run_tasks
from photocal.measurement.features import (
    Arrays,
    Features,
    FeatureSettings,
    array_key,
    cached,
    combined_key,
    detect,
    kept,
)
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import as_eight_bit, each_picture, left_out_entry, read_grey
from photocal.measurement.image_pairs import ALL_UP_TO, NEAREST, Footprints, among_nearest, select_pairs
from photocal.measurement.markers import coded_targets, coded_targets_kept
from photocal.measurement.pair_matching import match
from photocal.measurement.patch_matching import ImageSource
from photocal.measurement.tracks import Tracks, in_common, join_tracks, of_images

# Raised whenever the meaning of cached results changes: of features, of matches.
FEATURES, MATCHES = 4, 4
# Peak memory of a process that detects features, of 3 to 24 megapixels the same (their pictures are reduced),
# and of the one that joins them.
WORKER_BYTES, OWN_BYTES = 1.2e9, 1.0e9
_NAMES = ("pixels", "scale", "descriptors")


@dataclass(frozen=True)
class MatchingPlan:
    """Where results are kept, how they are made and by how many processes.

    coded: dictionaries of coded targets that are looked for beside the features: pictures are decoded once.
    """

    cache: Path = field(default_factory=cache_folder)
    processes: Workers = field(default_factory=lambda: affordable(WORKER_BYTES, OWN_BYTES))
    features: FeatureSettings = field(default_factory=FeatureSettings)
    coded: tuple[str, ...] = ()


# A picture, and the key that its features are kept by.
_Picture = tuple[Path, str, MatchingPlan]


def detect_all(
    paths: Sequence[Path], plan: MatchingPlan, progress: Progress
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Detect the features of all images into the cache; give their keys, and why an image cannot be used."""
    images = [_picture(path, plan) for path in paths]
    # The bar counts what is left of a run that was ended.
    wanted = [image for image in images if not _at_hand(image)]
    title = "detecting features and coded targets" if plan.coded else "detecting features"
    with progress(title, len(wanted) or None) as done:
        whys = list(run_tasks(_detect_one, wanted, plan.processes, done))
    reasons = {path: why for (path, *_), why in zip(wanted, whys, strict=True) if why}
    keys = tuple("" if path in reasons else key for path, key, _ in images)
    return keys, tuple(reasons.get(path, "") for path in paths)


def same_pictures(keys: Mapping[int, str], plan: MatchingPlan) -> dict[int, int]:
    """Give for each picture the first that shows the same, to the last pixel.

    One that was saved twice, under another name or with other tags, is no second observation.
    """
    first, seen = dict[str, int](), {k: _features(plan, key).pixels for k, key in keys.items()}
    return {k: first.setdefault(array_key(px), k) if len(px) else k for k, px in seen.items()}


def match_all(
    keys: Sequence[str], pairs: Integers, plan: MatchingPlan, done: Callable[[float], None]
) -> tuple[Tracks, Integers]:
    """Match pairs of images and join the matches to tracks; give the number of matches of each, too."""
    matches = _matches(keys, pairs, plan, done)
    return join_tracks(_places(keys, plan), pairs, matches), _counts(matches)


def _matches(
    keys: Sequence[str], pairs: Integers, plan: MatchingPlan, done: Callable[[float], None]
) -> list[Integers]:
    tasks = ((_match_key(keys[a], keys[b]), keys[a], keys[b], plan) for a, b in pairs)
    return list(run_tasks(_match_one, tasks, plan.processes, done, lambda task: kept(plan.cache, task[0])))


def _places(keys: Sequence[str], plan: MatchingPlan) -> list[Features]:
    # Descriptors stay on the disk: only places and scales of all images are held.
    return [_features(plan, key) for key in keys]


def _counts(matches: Sequence[Integers]) -> Integers:
    return np.array([len(m) for m in matches], dtype=np.int64)


# So many tracks join two images as well as matches of their own would. Of 318 pictures, of which each
# overlaps with 24 and more, half of the pairs are matched then, and 98 % of the rays are left.
JOINED = 200


def match_where_needed(
    keys: Sequence[str], pairs: Integers, near: Flags, plan: MatchingPlan, progress: Progress
) -> tuple[Tracks, Integers]:
    """Match the near pairs of images, and of the others those that have few tracks in common then.

    near (n,): which pairs are matched in any case.
    returns: the tracks; numbers of matches of the pairs that were matched.
    """
    with progress("matching pairs of images", int(near.sum())) as done:
        matches, places = _matches(keys, pairs[near], plan, done), _places(keys, plan)
        tracks = join_tracks(places, pairs[near], matches)
    far = pairs[~near]
    far = far[in_common(tracks, far, len(keys)) < JOINED]
    if len(far):
        with progress("matching pairs of images", len(far)) as done:
            matches += _matches(keys, far, plan, done)
            tracks = join_tracks(places, np.concatenate([pairs[near], far]), matches)
    return tracks, _counts(matches)


def _picture(path: Path, plan: MatchingPlan) -> _Picture:
    return path, combined_key(FEATURES, digest(path), plan.features), plan


def _at_hand(image: _Picture) -> bool:
    path, key, plan = image
    source = ImageSource(path, key, plan.cache)
    return kept(plan.cache, key) and all(coded_targets_kept(source, codes) for codes in plan.coded)


def _detect_one(image: _Picture) -> str:
    """Detect the features of a picture into the cache; why it cannot be used, if it cannot."""
    path, key, plan = image
    # Decoded once, and only where something is made of it.
    picture = cache(partial(read_grey, path))

    def make() -> Arrays:
        """Detect the features of one picture."""
        return dict(vars(detect(as_eight_bit(picture()), plan.features)))

    try:
        cached(plan.cache, key, _NAMES, make)
        for codes in plan.coded:
            coded_targets(ImageSource(path, key, plan.cache), codes, picture)
    except PhotocalError as refusal:
        if refusal.where != str(path):
            raise
        return refusal.what
    return ""


def features_of(path: Path, plan: MatchingPlan) -> tuple[str, Features] | None:
    """Features of one picture and their key; None where the picture is damaged.

    The key is empty where the cache cannot be written.

    raises OSError: when the file cannot be opened.
    """
    try:
        _, key, _ = image = _picture(path, plan)
        reason = _detect_one(image)
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
    pairs (k, 2): images that may show the same.
    matched_pairs, verified_pairs: how many of them were matched, and belong together.
    rule: by which the pairs were chosen.
    """

    facts: tuple[ImageFacts, ...]
    sources: tuple[ImageSource, ...]
    tracks: Tracks
    pairs: Integers
    matched_pairs: int
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


def too_few(
    usable: int, total: int, left_out: Sequence[Mapping[str, str]], where: Path
) -> InputNotFoundError:
    """Make the refusal of pictures of which fewer than two can be used."""
    reasons = "; ".join(f"{entry['image']}: {entry['reason']}" for entry in left_out[:3])
    return InputNotFoundError(f"{usable} of {total} images can be used", reasons, where=where)


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
    keys, reasons = detect_all(readable, plan, progress)
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
        raise too_few(len(facts), len(paths), left_out, paths[0].parent)
    seen = looking(facts)
    pairs, rule = select_pairs(seen, len(facts))
    # Of few images each pair may be the one that joins two parts.
    few = len(facts) <= ALL_UP_TO
    near = np.ones(len(pairs), dtype=np.bool_) if few else among_nearest(seen[0], pairs, NEAREST)
    tracks, counts = match_where_needed(keys, pairs, near, plan, progress)
    sources = tuple(ImageSource(readable[k], key, plan.cache) for k, key in zip(good, keys, strict=True))
    return ImageTracks(
        tuple(facts),
        sources,
        tracks,
        pairs,
        len(counts),
        int(np.count_nonzero(counts)),
        rule,
        tuple(left_out),
    )

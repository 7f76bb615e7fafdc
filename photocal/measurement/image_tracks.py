"""Features of a set of images, matched and joined to tracks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from photocal.base.arrays import Integers
from photocal.base.errors import InputNotFoundError
from photocal.base.progress import Progress
from photocal.measurement import match_images
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import each_picture
from photocal.measurement.image_pairs import Footprints, select_pairs
from photocal.measurement.patch_matching import Source
from photocal.measurement.tracks import Tracks, of_images

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
    sources: tuple[Source, ...]
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
        left = [_entry(f.name, why, "other-size") for f, why in zip(self.facts, reasons, strict=True) if why]
        return replace(
            self,
            facts=tuple(f for f, good in zip(self.facts, keep, strict=True) if good),
            sources=tuple(s for s, good in zip(self.sources, keep, strict=True) if good),
            tracks=of_images(self.tracks, keep),
            pairs=pairs[(pairs >= 0).all(axis=1)],
            left_out=(*self.left_out, *left),
        )


def _entry(image: str, reason: str, code: str) -> dict[str, str]:
    return {"image": image, "reason": reason, "code": code}


def track_images(
    paths: Sequence[Path],
    plan: match_images.MatchingPlan,
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
        keys, reasons = match_images.detect_all(readable, plan, done)
    good = [k for k, reason in enumerate(reasons) if not reason]
    left_out += [_entry(readable[k].name, why, "unreadable") for k, why in enumerate(reasons) if why]
    # Marks name the original, not "copy of" it, nor it with "(1)" behind.
    by_length = sorted(good, key=lambda k: len(readable[k].name))
    first = match_images.same_pictures({k: keys[k] for k in by_length}, plan)
    left_out += [
        _entry(readable[k].name, f"is the same picture as {readable[j].name}", SAME)
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
        tracks, counts = match_images.match_all(keys, pairs, plan, done)
    sources = tuple(Source(readable[k], key, plan.cache) for k, key in zip(good, keys, strict=True))
    return ImageTracks(
        tuple(facts), sources, tracks, pairs, int(np.count_nonzero(counts)), rule, tuple(left_out)
    )

"""From a folder of images to a block of tie points."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputNotFoundError
from photocal.base.progress import Progress
from photocal.measurement import match_images
from photocal.measurement.block_files import PIXEL_ORIGIN, SCHEMA
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import each_picture
from photocal.measurement.maker_camera import stated_camera
from photocal.measurement.oriented_ties import Oriented
from photocal.measurement.position_files import local_places
from photocal.measurement.refine import Source
from photocal.measurement.start_block import explained
from photocal.measurement.tie_adjustment import camera_figures, pixel_residuals, with_released_c
from photocal.measurement.tracks import Tracks, of_images

# Why a picture is left out that is there twice: nothing is lost with it.
SAME = "same-picture"


@dataclass(frozen=True)
class Sighted:
    """What features alone say of a set of images.

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


def sight(
    paths: Sequence[Path],
    plan: match_images.MatchingPlan,
    progress: Progress,
    looking: Callable[[Sequence[ImageFacts]], match_images.Footprints],
    given: Callable[[ImageFacts], ImageFacts],
) -> Sighted:
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
    pairs, rule = match_images.select_pairs(looking(facts), len(facts))
    with progress("matching pairs of images", len(pairs)) as done:
        tracks, counts = match_images.match_all(keys, pairs, plan, done)
    sources = tuple(Source(readable[k], key, plan.cache) for k, key in zip(good, keys, strict=True))
    return Sighted(tuple(facts), sources, tracks, pairs, int(np.count_nonzero(counts)), rule, tuple(left_out))


def tie_record(sighted: Sighted, oriented: Oriented) -> dict[str, Any]:
    """What was measured and how, for `measurement.json`."""
    paths = {source.path.name: source.path for source in sighted.sources}
    final = oriented.adjusted
    residuals = pixel_residuals(final.assembly, final.solution)[-len(final.tracks.track) :]
    return {
        "schema": SCHEMA,
        "images": list(final.block.images.names),
        "turned_by_exif": [f.name for f in sighted.facts if f.orientation != 1],
        "left_out": [*sighted.left_out, *explained(oriented.left_out, paths, sighted.facts)],
        "pairs": {"rule": sighted.rule, "examined": len(sighted.pairs), "verified": sighted.verified_pairs},
        "tracks": {
            "of_features": sighted.tracks.count,
            "conflicts_removed": sighted.tracks.conflicts,
            "all": oriented.verified.count,
            "three_and_more_rays": int(np.count_nonzero(oriented.verified.rays >= 3)),
        },
        "pixel_origin": PIXEL_ORIGIN,
        "points": final.tracks.count,
        "observations": len(final.tracks.track),
        "rejected_observations": final.rejected,
        "points_by_rays": {str(n): int(c) for n, c in enumerate(np.bincount(final.tracks.rays)) if c},
        "share_of_four_and_more": float(np.mean(final.tracks.rays >= 4)),
        "rms_px": float(np.sqrt(np.mean(residuals**2))),
        "sigma_px": final.tie_sigma,
        "variance_factor": float(final.solution.variance_factor),
        "cameras": camera_figures(final, with_released_c(final)),
    }


def position_figures(facts: Sequence[ImageFacts], sigma: Floats) -> dict[str, Any]:
    """How well the positions were taken to be known, and who said so; `sigma` (images, 3)."""
    stated = [bool(np.isfinite(f.position_sigma_m).all()) for f in facts if f.has_position]
    known = sigma[np.isfinite(sigma).all(axis=1)]
    return {
        "images": len(stated),
        "sigma_stated_by_image": sum(stated),
        "sigma_m": np.sqrt(np.mean(known**2, axis=0)).tolist() if len(known) else None,
    }


def stated_footprints(facts: Sequence[ImageFacts]) -> match_images.Footprints:
    """Footprints of images as they say where they are, how high and which way they look."""
    places, _ = local_places(facts)
    return match_images.footprints(
        places[:, :2],
        np.array([f.relative_altitude_m for f in facts]),
        np.radians([[f.gimbal_deg[2], f.gimbal_deg[1]] for f in facts]),
        np.array([f.size_px for f in facts], dtype=float),
        np.array([stated_camera("", f).camera.value("c") for f in facts]),
    )

"""From a folder of images to a block of tie points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputNotFoundError, PhotocalError
from photocal.measurement.geographic import local_places
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.match_images import MatchingPlan, detect_all, match_all
from photocal.measurement.pair_selection import footprints, select_pairs
from photocal.measurement.start_camera import principal_distance_px
from photocal.measurement.tie_block import TieBlock, make_tie_block
from photocal.measurement.tracks import Tracks, thin

Progress = Callable[[str, float | None], AbstractContextManager[Callable[[float], None]]]

# Points wanted in each cell of an image, and cells along its longer side.
CELLS, IN_A_CELL = 20, 6


def measure_ties(paths: Sequence[Path], name: str, plan: MatchingPlan, progress: Progress) -> TieBlock:
    """Measure tie points in images and make their block.

    Parameters
    ----------
    paths : sequence of Path
    name : str
        Of the block.
    plan : MatchingPlan
    progress : callable
        Shows a bar for a title and an amount of work.

    Returns
    -------
    TieBlock

    Raises
    ------
    PhotocalError
        When too few images can be read, or their tie points do not orient them.
    """
    readable, facts, left_out = _readable(paths)
    with progress("detecting features", len(readable)) as done:
        keys, reasons = detect_all(readable, plan, done)
    good = [k for k, reason in enumerate(reasons) if not reason]
    left_out += [{"image": readable[k].name, "reason": r} for k, r in enumerate(reasons) if r]
    facts, keys = [facts[k] for k in good], tuple(keys[k] for k in good)
    if len(facts) < 2:
        raise InputNotFoundError(
            f"{len(facts)} of {len(paths)} images can be used",
            where=paths[0].parent,
            remedy="; ".join(f"{e['image']}: {e['reason']}" for e in left_out[:3]),
        )
    places, origin = local_places(facts)
    pairs, rule = select_pairs(_footprints(facts, places), len(facts))
    with progress("matching pairs of images", len(pairs)) as done:
        tracks, counts = match_all(keys, pairs, plan, done)
    sizes = np.array([f.size_px for f in facts], dtype=float)
    chosen = _strong(tracks, sizes)
    made = make_tie_block(facts, chosen, places, name)
    record = {
        "schema": "photocal.measurement/1",
        "kind": "tie points",
        "images": [f.name for f in facts],
        "turned_by_exif": [f.name for f in facts if f.orientation != 1],
        "left_out": left_out,
        "pairs": {"rule": rule, "examined": len(pairs), "verified": int(np.count_nonzero(counts))},
        "tracks": {
            "all": tracks.count,
            "three_and_more_rays": int(np.count_nonzero(tracks.rays >= 3)),
            "conflicts_removed": tracks.conflicts,
        },
        "principal_distance_from": sorted({principal_distance_px(f)[1] for f in facts}),
        "origin": None
        if np.isnan(origin[0])
        else {"latitude_deg": origin[0], "longitude_deg": origin[1], "height_m": origin[2]},
        "pixel_origin": "centre of the upper-left stored pixel is (0, 0); EXIF orientation is not applied",
        **made.record,
    }
    return replace(made, record=record)


def _readable(paths: Sequence[Path]) -> tuple[list[Path], list[ImageFacts], list[dict[str, str]]]:
    readable, facts, left_out = [], [], []
    for path in paths:
        try:
            facts.append(read_facts(path))
            readable.append(path)
        except PhotocalError as refusal:
            left_out.append({"image": path.name, "reason": refusal.what})
    return readable, facts, left_out


def _footprints(facts: Sequence[ImageFacts], places: NDArray[np.float64]) -> Any:
    return footprints(
        places[:, :2],
        np.array([f.relative_altitude_m for f in facts]),
        np.radians([[f.gimbal_deg[2], f.gimbal_deg[1]] for f in facts]),
        np.array([f.size_px for f in facts], dtype=float),
        np.array([principal_distance_px(f)[0] for f in facts]),
    )


def _strong(tracks: Tracks, sizes: NDArray[np.float64]) -> Tracks:
    """Points with three and more rays, evenly spread; those with two only where an image lacks others."""
    many = tracks.some((tracks.rays >= 3)[tracks.track])
    seen = np.bincount(many.image, minlength=len(sizes))
    enough = (seen >= 30).all()
    return thin(many if enough else tracks, sizes, CELLS, IN_A_CELL)

"""From a folder of images to a block of tie points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputNotFoundError, PhotocalError
from photocal.block.model import Block
from photocal.measurement.geographic import local_places
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.match_images import MatchingPlan, detect_all, match_all
from photocal.measurement.oriented_ties import Progress, figures, orient_ties
from photocal.measurement.pair_selection import footprints, select_pairs
from photocal.measurement.refine import Source
from photocal.measurement.released import camera_figures
from photocal.measurement.start_block import POSITION_SIGMA_M, position_sigma, start_block
from photocal.measurement.start_camera import principal_distance_px


@dataclass(frozen=True)
class TieBlock:
    """A block of tie points.

    Attributes
    ----------
    block : Block
    record : dict
        Figures for `measurement.json`.
    """

    block: Block
    record: dict[str, Any]


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
    start = start_block(facts, places, name)
    sources = [Source(readable[k], key, plan.cache) for k, key in zip(good, keys, strict=True)]
    found = orient_ties(start, sources, tracks, pairs, plan.processes, progress)
    left_out += found.left_out
    block = found.adjusted.block
    sigma = position_sigma(facts)
    stated = sum(np.isfinite(f.position_sigma_m).all() for f in facts if f.has_position)
    record = {
        "schema": "photocal.measurement/1",
        "kind": "tie points",
        "images": list(block.images.names),
        "turned_by_exif": [f.name for f in facts if f.orientation != 1],
        "left_out": left_out,
        "pairs": {"rule": rule, "examined": len(pairs), "verified": int(np.count_nonzero(counts))},
        "tracks": {
            "of_features": tracks.count,
            "conflicts_removed": tracks.conflicts,
            "all": found.verified.count,
            "three_and_more_rays": int(np.count_nonzero(found.verified.rays >= 3)),
        },
        "principal_distance_from": sorted({principal_distance_px(f)[1] for f in facts}),
        "positions": {
            "images": sum(f.has_position for f in facts),
            "sigma_from_image": int(stated),
            "sigma_m": np.sqrt(np.mean(sigma**2, axis=0)).tolist(),
            "sigma_assumed_m": list(POSITION_SIGMA_M),
        },
        "origin": None
        if np.isnan(origin[0])
        else {"latitude_deg": origin[0], "longitude_deg": origin[1], "height_m": origin[2]},
        "pixel_origin": "centre of the upper-left stored pixel is (0, 0); EXIF orientation is not applied",
        **figures(found),
        "cameras": camera_figures(found.adjusted),
    }
    return TieBlock(block, record)


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

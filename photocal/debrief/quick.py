"""A quick orientation by features of reduced pictures, and the first calibration that follows of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.errors import PhotocalError
from photocal.findings.finding import Finding, untested
from photocal.geometry.camera import Camera
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.match_images import MatchingPlan, match_all, select_pairs
from photocal.measurement.measure_ties import stated_footprints
from photocal.measurement.oriented_ties import Progress, first_orientation
from photocal.measurement.position_files import local_places
from photocal.measurement.start_block import start_block
from photocal.measurement.tie_adjustment import camera_figures
from photocal.navigation.exposures import Exposures

# A principal distance of the quick orientation that differs by so many sigmas of both, and by this share.
_CHANGED_SIGMAS, _CHANGED_SHARE = 4.0, 5e-4
# Pictures that may stay outside: those over water, or at the end of a strip.
_MAY_STAY = 0.05


@dataclass(frozen=True)
class Quick:
    """What reduced pictures say together.

    Attributes
    ----------
    joined : int
        Pictures that were oriented.
    left_out : tuple of dict
        Those that were not, with the reason.
    cameras : list of dict
        As `released.camera_figures`: c that the block gives by itself, with its sigma.
    """

    joined: int
    left_out: tuple[dict[str, str], ...]
    cameras: list[dict[str, Any]]


def with_positions(facts: Sequence[ImageFacts], exposures: Exposures) -> list[ImageFacts]:
    """Pictures with the positions of their exposures in place of those that they state."""
    row = {name: k for k, names in enumerate(exposures.image) for name in names.split()}
    placed, found = exposures.placed, []
    sigma = np.sqrt(np.maximum(np.diagonal(placed.covariance_m2, axis1=1, axis2=2), 0.0))
    for one in facts:
        k = row.get(one.name)
        if k is not None and placed.placed[k]:
            east, north, up = sigma[k].tolist()
            one = replace(
                one,
                latitude_deg=float(placed.lat_deg[k]),
                longitude_deg=float(placed.lon_deg[k]),
                altitude_m=float(placed.height_m[k]),
                position_sigma_m=(east, north, up),
            )
        found.append(one)
    return found


def orient_quickly(
    facts: Sequence[ImageFacts],
    keys: Sequence[str],
    last: Sequence[Camera],
    plan: MatchingPlan,
    progress: Progress,
) -> Quick:
    """Orient pictures by their features; what was matched before is kept.

    A camera that was calibrated keeps all that was found but its principal distance.

    Raises
    ------
    PhotocalError
        When they do not hold together.
    """
    pairs, _ = select_pairs(stated_footprints(facts), len(facts))
    with progress("matching reduced pictures", len(pairs)) as done:
        tracks, _ = match_all(keys, pairs, plan, done)
    with progress("orienting reduced pictures", None):
        start = start_block(facts, local_places(facts)[0], "debrief")
        start = replace(start, cameras=tuple(_known(own, last) for own in start.cameras))
        first = first_orientation(start, tracks)
        return Quick(len(first.kept), first.left_out, camera_figures(first.adjusted))


def _known(stated: Camera, last: Sequence[Camera]) -> Camera:
    """Camera of the last certificate in place of a stated one of the same format; nothing is estimated."""
    same = [one for one in last if one.size_px == stated.size_px]
    if not same:
        return stated
    nearest = min(same, key=lambda one: abs(one.value("c") / one.pitch[0] - stated.value("c")))
    none = np.zeros_like(nearest.estimated)
    unknown = np.full(len(none), np.inf)
    return replace(nearest, id=stated.id, estimated=none, prior_sigma=unknown, guessed=False)


def quick_findings(
    facts: Sequence[ImageFacts],
    keys: Sequence[str],
    last: Sequence[Camera],
    plan: MatchingPlan,
    progress: Progress,
) -> tuple[Quick | None, list[Finding]]:
    """Orient quickly, and hold the calibration against the last one of the same camera."""
    try:
        quick = orient_quickly(facts, keys, last, plan, progress)
    except PhotocalError as refusal:
        return None, [Finding("pictures-not-joined", "grave", figures={"reason": refusal.what})]
    findings = []
    out = tuple(one["image"] for one in quick.left_out)
    if len(out) > _MAY_STAY * len(facts):
        figures = {"n": float(len(out)), "all": float(len(facts)), "images": out}
        findings.append(Finding("pictures-left-out", "doubtful", figures=figures))
    return quick, findings + [_since(own, last) for own in quick.cameras if last]


def _since(found: dict[str, Any], last: Sequence[Camera]) -> Finding:
    """Principal distance since the last certificate, whose camera the pictures were oriented with."""
    released, unit = found["released"], found["unit"]
    if released is None or not released["credible"]:
        return untested("c-changed", "c-not-determined", {"camera": found["camera"]})
    c = float(released["c"] / (1.0 + released["change"]))
    before = min(last, key=lambda one: abs(one.value("c") - c))
    both = float(np.hypot(before.sigma_of("c"), released["sigma"]))
    away = float(released["c"]) - c
    figures = {
        "camera": found["camera"],
        "c": float(released["c"]),
        "sigma": float(released["sigma"]),
        "before": c,
        "unit": unit,
        "percent": 100.0 * away / c,
        "sigmas": abs(away) / both,
    }
    changed = abs(away) > max(_CHANGED_SIGMAS * both, _CHANGED_SHARE * c)
    return Finding("c-changed", "doubtful" if changed else "passed", str(found["camera"]), figures)

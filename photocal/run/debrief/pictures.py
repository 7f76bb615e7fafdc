"""What each picture shows, whether it is sharp and well exposed, and a first orientation by its features."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.base.errors import PhotocalError
from photocal.base.files import digest
from photocal.base.policy import policy
from photocal.base.progress import Progress
from photocal.findings.digits import with_sigma
from photocal.findings.finding import Figure, Finding, untested
from photocal.geometry.camera import Camera, held_camera
from photocal.measurement.features import Arrays, FeatureSettings, cached, combined_key, detect
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import BLACK, WHITE, as_eight_bit, read_grey
from photocal.measurement.image_pairs import among_nearest, select_pairs, stated_footprints
from photocal.measurement.match_images import FEATURES, MatchingPlan, match_all
from photocal.measurement.oriented_ties import first_orientation
from photocal.measurement.picture_tests import judge_pictures
from photocal.measurement.position_files import Origin, local_places
from photocal.measurement.released_c import camera_figures, told_by_rays, with_released_c
from photocal.measurement.tie_adjustment import AdjustedTies, reopened, shutters_closed
from photocal.measurement.tie_block import start_block
from photocal.navigation.exposures import Exposures

# Enough for overlap, orientation and a first calibration, in a small part of the time of the features for the
# map.
QUICK = FeatureSettings(most=1500, longest_px=640, part=1.0)
_LOOK, _NAMES = 1, ("figures", "pixels", "scale", "descriptors")
MEASURED = ("softness", "white", "black", "range")
# Tiles in which sharpness is looked for, px and number along each side.
_TILE, _TILES = 384, 3
# A picture whose edges are softer than the flight's usual ones by this much, and by so many deviations.
_SOFTER, _DEVIATIONS = 1.35, 6.0
# Share of the picture without detail, and the least range of grey values of the rest.
_SHARE, _RANGE = 0.2, 40.0


@dataclass(frozen=True)
class PictureQuality:
    """What a picture shows.

    facts: None of a file that cannot be read; `refusal` then says why.
    softness: width of what is seen, in the direction where it is largest, about px: it grows with blur,
        hardly with what is pictured.
    white, black: share of pixels without detail.
    range: grey values between the 2nd and the 98th percentile.
    """

    path: Path
    facts: ImageFacts | None
    refusal: str = ""
    key: str = ""
    softness: float = np.nan
    white: float = np.nan
    black: float = np.nan
    range: float = np.nan


def look(task: tuple[Path, MatchingPlan]) -> PictureQuality:
    """Look at a picture; one that cannot be read is a `PictureQuality` that says why."""
    path, plan = task

    def make() -> Arrays:
        """Measure one picture: features, exposure, sharpness."""
        grey = as_eight_bit(read_grey(path))
        few = grey[::4, ::4]
        low, high = np.quantile(few, [0.02, 0.98])
        figures = np.array([_softness(grey), np.mean(few >= WHITE), np.mean(few <= BLACK), high - low])
        return {"figures": figures, **vars(detect(grey, plan.features))}

    try:
        facts = read_facts(path)
        key = combined_key(FEATURES, _LOOK, digest(path), plan.features)
        figures = cached(plan.cache, key, _NAMES, make)["figures"]
    except PhotocalError as refusal:
        return PictureQuality(path, None, refusal.what)
    return PictureQuality(path, facts, "", key, *figures.tolist())


def _softness(grey: NDArray[np.uint8]) -> float:
    """Inverse of the usual spatial frequency in the direction where it is lowest, median over tiles."""
    # A wave of frequency w has differences over one and two pixels with the ratio of squares 2 (1 + cos w),
    # of which tan^2(w/2) follows.
    height, width = grey.shape
    softness = []
    # Grey values that scatter less show nothing whose edges could be judged.
    plain = 4.0
    for row in np.linspace(0, max(height - _TILE, 0), _TILES).astype(int):
        for column in np.linspace(0, max(width - _TILE, 0), _TILES).astype(int):
            tile = grey[row : row + _TILE, column : column + _TILE].astype(np.float32)
            # Tiles without detail show noise, not edges.
            if tile.std() < plain:
                continue
            lowest = np.inf
            for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
                near, far = (_difference(tile, n * down, n * right) for n in (1, 2))
                length = float(np.hypot(down, right))
                lowest = min(lowest, max(4 * near / max(far, 1e-6) - 1, 1e-6) / length**2)
            softness.append(lowest**-0.5)
    return float(np.median(softness)) if softness else np.nan


def _difference(tile: NDArray[np.float32], down: int, right: int) -> float:
    rows, columns = tile.shape
    here = tile[: rows - down, max(0, -right) : columns - max(0, right)]
    there = tile[down:, max(0, right) : columns - max(0, -right)]
    return float(np.mean((here - there) ** 2))


# Pictures of such findings say nothing together with the others.
UNUSABLE = (
    "pictures-unreadable", "pictures-blurred", "pictures-too-bright", "pictures-too-dark",
    "pictures-of-other-camera", "lens-changed", "refocused",
)  # fmt: skip


def picture_findings(looks: Sequence[PictureQuality]) -> list[Finding]:
    """Name pictures that cannot be read, are blurred, badly exposed, or of another camera or lens setting."""
    readable = [look for look in looks if look.facts is not None]
    groups = {
        "pictures-unreadable": [look for look in looks if look.facts is None],
        "pictures-blurred": _blurred(readable),
        "pictures-too-bright": [look for look in readable if look.white > _SHARE],
        "pictures-too-dark": [
            look for look in readable if look.white <= _SHARE and (look.black > 0.5 or look.range < _RANGE)
        ],
    }
    findings = [_about(code, group, len(looks)) for code, group in groups.items() if group]
    return findings + judge_pictures([look.facts for look in readable if look.facts is not None])


def _about(code: str, group: Sequence[PictureQuality], of: int) -> Finding:
    names = tuple(look.path.name for look in group)
    reason = next((look.refusal for look in group if look.refusal), "")
    figures = {"n": float(len(names)), "all": float(of), "images": names, "reason": reason}
    return Finding(code, "doubtful", figures=figures)


def _blurred(looks: Sequence[PictureQuality]) -> list[PictureQuality]:
    softness = np.log([look.softness for look in looks])
    known = np.isfinite(softness)
    if known.sum() < 5:
        return []
    middle = float(np.median(softness[known]))
    spread = policy.mad_to_sigma * float(np.median(np.abs(softness[known] - middle)))
    limit = middle + max(np.log(_SOFTER), _DEVIATIONS * spread)
    return [look for look, value in zip(looks, softness, strict=True) if value > limit]


# A principal distance of the quick orientation that differs by so many sigmas of both, and by this share.
_CHANGED_SIGMAS, _CHANGED_SHARE = 4.0, 5e-4
# Positions are held so many times more loosely to see whether they pull c.
_LOOSE = 10.0
# What else c depends on that a first calibration does not tell apart from nothing: the principal point, also
# where a certificate states the lens; a lens out of centre, pixels that are not square, and a shutter that
# rolls. Of cameras on small aircraft that takes some 30 ms.
ALSO = (
    ("x0", np.inf), ("y0", np.inf), ("P1", np.inf), ("P2", np.inf), ("B1", 1e-3), ("readout", 0.03),
)  # fmt: skip
# Pictures that each one is matched with.
_PARTNERS = 8


@dataclass(frozen=True)
class Quick:
    """What reduced pictures say together.

    cameras: as `released.camera_figures`: c that the block gives by itself, with its sigma.
    ground_m: median height of what the pictures show, of the kind of their positions; NaN without these.
    adjusted, origin: what a later orientation continues from, and the origin of its system.
    """

    joined: int
    left_out: tuple[dict[str, str], ...]
    cameras: list[dict[str, Any]]
    ground_m: float
    adjusted: AdjustedTies
    origin: Origin


def with_positions(facts: Sequence[ImageFacts], exposures: Exposures) -> list[ImageFacts]:
    """Pictures with the positions of their exposures in place of those that they state."""
    row = {name: k for k, names in enumerate(exposures.images) for name in names}
    placed, with_place = exposures.placed, []
    sigma = placed.sigma_m
    for image in facts:
        k = row.get(image.name)
        if k is not None and placed.placed[k]:
            east, north, up = sigma[k].tolist()
            image = replace(
                image,
                latitude_deg=float(placed.lat_deg[k]),
                longitude_deg=float(placed.lon_deg[k]),
                altitude_m=float(placed.height_m[k]),
                position_sigma_m=(east, north, up),
            )
        with_place.append(image)
    return with_place


def orient_quickly(
    facts: Sequence[ImageFacts],
    keys: Sequence[str],
    last: Sequence[Camera],
    plan: MatchingPlan,
    progress: Progress,
    before: Quick | None = None,
) -> Quick:
    """Orient pictures by their features; what was matched before is kept.

    before: an orientation of some of them, which is continued where it left none out.
    """
    pairs = select_pairs(stated_footprints(facts), len(facts))[0]
    pairs = pairs[among_nearest(local_places(facts)[0], pairs, _PARTNERS)]
    with progress("matching reduced pictures", len(pairs)) as done:
        tracks, _ = match_all(keys, pairs, plan, done)
    with progress("orienting reduced pictures", None):
        kept = None if before is None or before.left_out else before
        places, origin = local_places(facts, None if kept is None else kept.origin)
        start = start_block(facts, places, "debrief")
        given = tuple(_known(camera, last) for camera in start.cameras)
        # A readout is looked for once, when all gross errors are out: in each round it would take nine tenths
        # of the time.
        start = replace(start, cameras=shutters_closed(given))
        # Without a cache for each: no other run orients just these pictures.
        first = first_orientation(start, tracks, None, None if kept is None else kept.adjusted)
        adjusted = first.adjusted
        # The adjustment has a frame of its own, upright as that of the places.
        state = adjusted.solution
        above = float(np.median(state.exposures[:, 5]) - np.median(state.points[:, 2]))
        height = origin[2] + float(np.median(adjusted.values[:, 5])) - above
        ground = height if adjusted.start.datum != "free" else np.nan
        flown = reopened(adjusted, given)
        freed = with_released_c(flown, 1.0, ALSO)
        loosely = with_released_c(flown, _LOOSE, ALSO)
        cameras = camera_figures(adjusted, told_by_rays(freed, loosely))
        joined = len(adjusted.start.images.names)
        return Quick(joined, first.left_out, cameras, ground, adjusted, origin)


def _known(stated: Camera, last: Sequence[Camera]) -> Camera:
    """Camera of the last certificate in place of a stated one of the same format; nothing is estimated."""
    same = [camera for camera in last if camera.size_px == stated.size_px]
    if not same:
        return stated
    nearest = min(same, key=lambda camera: abs(camera.value("c") / camera.pitch[0] - stated.value("c")))
    return replace(held_camera(nearest), id=stated.id, guessed=False)


def quick_findings(
    facts: Sequence[ImageFacts],
    keys: Sequence[str],
    last: Sequence[Camera],
    plan: MatchingPlan,
    progress: Progress,
    before: Quick | None = None,
) -> tuple[Quick | None, list[Finding]]:
    """Orient quickly, and hold the calibration against the last one of the same camera."""
    try:
        quick = orient_quickly(facts, keys, last, plan, progress, before)
    except PhotocalError as refusal:
        return None, [Finding("pictures-not-joined", "grave", figures={"reason": refusal.what})]
    findings = []
    out = tuple(entry["image"] for entry in quick.left_out)
    # Pictures that may stay outside: those over water, or at the end of a strip.
    may_stay = 0.05
    if len(out) > may_stay * len(facts):
        figures = {"n": float(len(out)), "all": float(len(facts)), "images": out}
        findings.append(Finding("pictures-left-out", "doubtful", figures=figures))
    return quick, findings + [since_certificate(camera, last) for camera in quick.cameras if last]


def since_certificate(quick_camera: dict[str, Any], last: Sequence[Camera]) -> Finding:
    """Tell whether c has changed since the last certificate, whose camera the pictures were oriented with."""
    released, unit = quick_camera["released"], quick_camera["unit"]
    if released is None or not released["credible"]:
        return untested("c-changed", "c-not-determined", {"camera": quick_camera["camera"]})
    c = float(released["c"] / (1.0 + released["change"]))
    before = min(last, key=lambda camera: abs(camera.value("c") - c))
    before_sigma = before.sigma_of("c")
    both = float(np.hypot(before_sigma, released["sigma"]))
    away = float(released["c"]) - c
    figures: dict[str, Figure] = {
        "camera": quick_camera["camera"],
        "c": float(released["c"]),
        "sigma": float(released["sigma"]),
        "before": c,
        "numbers": (with_sigma(released["c"], released["sigma"]),),
        # A principal distance that was held has no standard deviation.
        "stated": (with_sigma(c, before_sigma) if before_sigma > 0.0 else f"{c:g}",),
        "unit": unit,
        "percent": 100.0 * away / c,
        "sigmas": abs(away) / both,
    }
    changed = abs(away) > max(_CHANGED_SIGMAS * both, _CHANGED_SHARE * c)
    return Finding("c-changed", "doubtful" if changed else "passed", str(quick_camera["camera"]), figures)

"""From tracks to an oriented block: oriented by features, measured again by matching, adjusted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import ConfigurationError, IllPosedError, NotConvergedError, PhotocalError
from photocal.base.operating_system import available_memory
from photocal.base.policy import policy
from photocal.base.progress import Progress
from photocal.base.workers import Workers
from photocal.block.model import NO_POINTS, Block, Images
from photocal.block.network import block_frame
from photocal.block.results.adjusted import movements
from photocal.findings.finding import Finding
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.control_fit import fit_control, not_used
from photocal.measurement.features import made_once
from photocal.measurement.image_file import left_out_entry
from photocal.measurement.patch_matching import HALF, ImageSource, refine
from photocal.measurement.thinning import spaced, thin
from photocal.measurement.tie_adjustment import AdjustedTies, adjust_ties, adjusted_again
from photocal.measurement.tie_block import (
    GROSS,
    intersected,
    marked_control,
    reprojection_errors,
    with_ties,
)
from photocal.measurement.tie_orientation import Placed, continued, oriented, position_sigmas, reweighted
from photocal.measurement.tracks import Tracks, of_images, without_twins

# Cells along the longer side of an image; points in each that orient it at first, tracks that are matched
# precisely, and points that are adjusted: more of them cost time, and what they have in common is no noise
# that many points take away.
CELLS, FIRST_IN_A_CELL, MATCHED_IN_A_CELL, IN_A_CELL = 20, 1, 20, 3
# Tracks that cannot be placed to so many pixels by the first orientation are mismatches, in images of the
# usual length; larger than so much they are matched in reduced ones first.
FIRST_MISS_PX, USUAL_PX, LARGE_PX = 8.0, 4000.0, 8400.0
# Times that positions are judged anew, while their sigmas become less than this share.
_ROUNDS, _LESS = 6, 0.7
# Patches that are matched are so wide; the errors of nearer neighbours were found to be alike by 0.1 to 0.4.
PATCH_PX = 2.0 * HALF - 1.0
# Bytes that a ray of a tie point takes at least in what follows, beyond what the process has by then: half of
# what was measured with 0.9 million rays of 308 pictures and 1.3 million of 1001.
OF_RAY = 600.0
# Sigmas of tie points come from their own residuals: they test nothing.
ESTIMATED = Finding("sigmas-from-residuals", "note")
# Position and rotation of the block are unknown.
NOT_PLACED = Finding("block-not-placed", "doubtful")
# What is said of positions alone, which control may answer.
_WITHOUT_CONTROL = ("block-not-placed", "positions-in-line")


@dataclass(frozen=True)
class Oriented:
    """A block oriented by tie points.

    by_rays: before marks were used. All that is found in the images comes of it, so that a mark that moves
        leaves the cached tie points as they are.
    verified (n,): rays that fit the orientation, of each track that two and more of them see, before tracks
        are thinned.
    marked: the images with the control and the marks that fit.
    """

    adjusted: AdjustedTies
    by_rays: AdjustedTies
    verified: Integers
    marked: Block
    left_out: tuple[dict[str, str], ...]
    findings: tuple[Finding, ...]


class UnorientedError(IllPosedError):
    """No two images could be oriented; `block` has what was measured, without orientation."""

    def __init__(self, what: str, *, remedy: str = "", block: Block) -> None:
        """Keep the block beside the message."""
        super().__init__(what, remedy=remedy)
        self.block = block


def first_orientation(
    marked: Block, tracks: Tracks, cache: Path | None = None, before: AdjustedTies | None = None
) -> Oriented:
    """Orient a block by tracks of features, then bring in what of its control fits.

    cache: folder where what depends on the tracks alone is kept.
    before: an orientation of some of its images in the same system, from where it is continued.
    """
    return _with_marks(*_by_rays(marked, tracks, cache, before), marked)


def _by_rays(
    marked: Block, tracks: Tracks, cache: Path | None, before: AdjustedTies | None = None
) -> tuple[AdjustedTies, list[Finding]]:
    """Orient a block by tracks of features and by positions, as if it had no marks."""
    start = replace(marked, observations=marked.observations.rows(np.zeros(0, dtype=np.int64)))
    if len(marked.observations.image) and np.isfinite(marked.images.values[:, 3:]).all(axis=1).any():
        # A corrected coordinate would move the middle of the block, and each patch by a hair.
        start = replace(start, points=NO_POINTS)
    start, tracks, left_out = _connected(start, tracks)
    sizes = _sizes(start)
    strong = _strong(tracks, sizes, FIRST_IN_A_CELL)
    known = None if before is None else continued(start, strong, before.start, before.values)
    placed, poses, reasons, found = known or made_once(
        cache, Placed, (start, strong), lambda: oriented(start, strong, cache)
    )
    named = zip(start.images.names, reasons, strict=True)
    left_out += [left_out_entry(name, why, "not-joined") for name, why in named if why]
    reached = np.array([not reason for reason in reasons])
    start, tracks = placed.of_images(reached), of_images(tracks, reached)
    adjusted = adjust_ties(start, poses[reached], _strong(tracks, sizes[reached], FIRST_IN_A_CELL), cache)
    return replace(adjusted, left_out=(*left_out, *adjusted.left_out)), list(found)


def _with_marks(alone: AdjustedTies, findings: list[Finding], marked: Block) -> Oriented:
    """Bring what fits of a block's control to its images as rays alone orient them.

    findings: of that orientation.
    """
    stated = dict(zip(marked.images.names, marked.images.sigma, strict=True))
    final, fits = alone, alone.start
    if len(marked.observations.image) or marked.points.of_role("control").any():
        fits, poses, of_control, controlled = fit_control(alone, marked, _views(alone))
        if controlled:
            findings = [finding for finding in findings if finding.code not in _WITHOUT_CONTROL]
        # Why listed control places nothing comes before what follows from it.
        findings = [*of_control, *findings]
        if len(fits.observations.image):
            final, fits, findings = _with_control(alone, fits, poses, findings)
        elif len(alone.start.points.names) < len(fits.points.names):
            final = adjusted_again(alone, fits, alone.values).after(alone)
    final = _by_positions(final, stated)
    if final.start.datum != "free":
        as_stated, shifted = _as_stated(final.start, stated), _controlled(final.start)
        findings = [*findings, *position_sigmas(as_stated, final.values, shifted=shifted)[2]]
    elif marked.datum != "free" and NOT_PLACED not in findings:
        findings = [*findings, NOT_PLACED]
    return Oriented(final, alone, final.tracks.rays, fits, final.left_out, tuple(findings))


def _with_control(
    alone: AdjustedTies, fitted: Block, poses: Floats, findings: list[Finding]
) -> tuple[AdjustedTies, Block, list[Finding]]:
    """Adjust anew with the control that fits, and give the block with it; without where it does not hold."""
    try:
        adjusted = adjusted_again(alone, fitted, poses)
    except PhotocalError as refusal:
        figures = {"refusal": refusal.what}
        findings.insert(0, not_used("control-refused", figures))
        known = alone.start.points
        return alone, replace(alone.start, points=known.only(known.of_role("tie"))), findings
    return adjusted.after(alone), fitted, findings


def _by_positions(adjusted: AdjustedTies, stated: Mapping[str, Floats]) -> AdjustedTies:
    """AdjustedTies anew while the positions, which now hold the block from bending, are borne out better.

    A block of rays alone bends by far more than good positions are wrong: what these miss by beside it says
    nothing about them.
    """
    for _ in range(_ROUNDS):
        images = adjusted.start.images
        if adjusted.start.datum == "free":
            break
        as_stated, shifted = _as_stated(adjusted.start, stated), _controlled(adjusted.start)
        better = reweighted(as_stated, adjusted.values, shifted=shifted)
        with np.errstate(invalid="ignore"):
            change = better.sigma[:, 3:] / images.sigma[:, 3:]
        if not (np.isfinite(better.sigma) != np.isfinite(images.sigma)).any() and not (change < _LESS).any():
            break
        start = replace(adjusted.start, images=replace(images, sigma=better.sigma))
        try:
            again = adjusted_again(adjusted, start, adjusted.values)
        except PhotocalError:
            break
        if again.start.datum == "free":
            break
        adjusted = again.after(adjusted)
    return adjusted


def _as_stated(block: Block, stated: Mapping[str, Floats]) -> Images:
    """Images of a block with the sigmas that were stated of their positions, by name."""
    sigma = np.array([stated[name] for name in block.images.names])
    return replace(block.images, sigma=np.hstack([block.images.sigma[:, :3], sigma[:, 3:]]))


def _controlled(block: Block) -> bool:
    """Whether marked control points place a block without its positions."""
    return len(marked_control(block)) >= policy.fewest_control


def orient_ties(
    start: Block,
    sources: Sequence[ImageSource],
    tracks: Tracks,
    pairs: Integers,
    processes: Workers,
    progress: Progress,
) -> Oriented:
    """Orient a block by tracks of features and measure its tie points precisely."""
    names, cache, found = start.images.names, sources[0].cache if sources else None, list[Finding]()
    try:
        with progress("orienting the pictures", None):
            alone, findings = _by_rays(start, tracks, cache)
    except PhotocalError as refusal:
        raise _unoriented(start, tracks, refusal) from refusal
    matched = of_images(tracks, np.isin(names, alone.start.images.names))
    matched = thin(matched, _sizes(alone.start), CELLS, MATCHED_IN_A_CELL)
    # How often images are halved, pass after pass, so that each finds what the one before has left.
    longest_px = float(_sizes(alone.start).max())
    levels = (int(np.ceil(np.log2(longest_px / USUAL_PX))), 0) if longest_px > LARGE_PX else (0,)
    try:
        for level in levels:
            matched = _matched(alone, matched, (names, sources, pairs), processes, progress, level)
            with progress("adjusting the tie points", None):
                alone, before = _adjusted(alone, matched, cache), alone
            matched = of_images(matched, np.isin(before.start.images.names, alone.start.images.names))
    except (IllPosedError, NotConvergedError) as refusal:
        matched = alone.tracks
        found.append(Finding("matches-not-adjusted", "doubtful", refusal.what))
    try:
        with progress("adjusting with control", None):
            final = _with_marks(alone, findings, start)
    except PhotocalError as refusal:
        raise _unoriented(start, tracks, refusal) from refusal
    stay = np.isin(alone.start.images.names, final.adjusted.start.images.names)
    verified = _verified(final.adjusted, of_images(matched, stay))
    return replace(final, verified=verified, findings=(*final.findings, ESTIMATED, *found))


def _unoriented(start: Block, tracks: Tracks, refusal: PhotocalError) -> UnorientedError:
    """Why a block is not oriented, with what was measured."""
    places = np.full((tracks.count, 3), np.nan)
    block = with_ties(start, tracks, places, np.ones(len(tracks.track)))
    return UnorientedError(refusal.what, remedy=refusal.remedy, block=block)


def _matched(
    by_rays: AdjustedTies,
    tracks: Tracks,
    pictures: tuple[Sequence[str], Sequence[ImageSource], Integers],
    processes: Workers,
    progress: Progress,
    level: int,
) -> Tracks:
    """Tracks measured again in images that are halved so many times.

    pictures: names and files of all images, and the pairs that show the same.
    """
    names, sources, pairs = pictures
    views, longest_px = _views(by_rays), float(_sizes(by_rays.start).max())
    kept = np.isin(names, by_rays.start.images.names)
    chosen = [source for source, good in zip(sources, kept, strict=True) if good]
    partners = _partners(pairs, np.flatnonzero(kept), len(names))

    def matched() -> Tracks:
        """Measure them in the pictures."""
        placed, points = _placed(views, tracks, FIRST_MISS_PX * max(1.0, longest_px / USUAL_PX))
        with progress("matching tie points precisely", 2 * len(chosen)) as done:
            found = refine(chosen, views, placed, points, partners, processes, done, level)
        # Matched patches nearer than this show one place.
        twin_px = 4.0
        return without_twins(found, twin_px)

    content = [source.key for source in chosen]
    return made_once(sources[0].cache, Tracks, (content, views, tracks, partners, level), matched)


def _adjusted(before: AdjustedTies, matched: Tracks, cache: Path | None) -> AdjustedTies:
    """Adjust a block anew by matched tie points, of which the strong ones are used."""
    strong = _strong(spaced(matched, PATCH_PX), _sizes(before.start), IN_A_CELL)
    _require_memory(len(strong.track))
    after = adjust_ties(before.start, before.values, strong, cache)
    return replace(after, left_out=(*before.left_out, *after.left_out))


def _require_memory(rays: int) -> None:
    """Refuse rays that this computer cannot hold before they are adjusted: what was measured is kept."""
    free, needed = available_memory(), OF_RAY * rays
    if free is not None and needed > free:
        raise ConfigurationError(
            f"{rays} rays of tie points take at least {needed / 1e9:.1f} GB of memory, "
            f"{free / 1e9:.1f} GB are free",
            "close other programs, take fewer pictures, or a computer with more memory; "
            "what was measured is kept",
        )


def _sizes(block: Block) -> Floats:
    return np.array([camera.size_px for camera in block.cameras], dtype=float)[block.images.camera]


def _connected(start: Block, tracks: Tracks) -> tuple[Block, Tracks, list[dict[str, str]]]:
    """Take out images with too few tie points."""
    left_out: list[dict[str, str]] = []
    # An image with fewer tie points is not oriented by them.
    fewest_ties = 12
    while True:
        seen = np.bincount(tracks.image, minlength=len(start.images.names))
        few = seen < fewest_ties
        if not few.any():
            return start, tracks, left_out
        shares = "shares only {} tie points with the other images"
        left_out += [
            left_out_entry(start.images.names[k], shares.format(seen[k]), "few-ties")
            for k in np.flatnonzero(few)
        ]
        if (~few).sum() < 2:
            reasons = "; ".join(f"{entry['image']} {entry['reason']}" for entry in left_out[:3])
            raise IllPosedError(
                f"the images cannot be oriented by tie points: {reasons}",
                "take images that overlap by 60 % and more, from different places",
            )
        start, tracks = start.of_images(~few), of_images(tracks, ~few)


def _strong(tracks: Tracks, sizes: Floats, in_a_cell: int) -> Tracks:
    """Points with three and more rays, evenly spread; those with two only where an image lacks others."""
    many = tracks.some((tracks.rays >= 3)[tracks.track])
    seen = np.bincount(many.image, minlength=len(sizes))
    # Images with fewer points of three and more rays also take those of two.
    enough_strong = 30
    return thin(many if (seen >= enough_strong).all() else tracks, sizes, CELLS, in_a_cell)


def _views(adjusted: AdjustedTies) -> OrientedImages:
    """The images as adjusted, with their movement while a rolling shutter reads them, in a local frame."""
    block = adjusted.block
    movement = movements(adjusted.assembly, adjusted.solution, adjusted.values)
    views = OrientedImages(
        block.images.names, block.cameras, block.images.camera, adjusted.values, movement=movement
    )
    return views.in_local(block_frame(block))


def _placed(views: OrientedImages, tracks: Tracks, most_px: float) -> tuple[Tracks, Floats]:
    """Tracks whose rays meet, and where."""
    points = intersected(views, tracks)
    with np.errstate(invalid="ignore"):
        tracks = tracks.some(reprojection_errors(views, tracks, points) < most_px)
    points = intersected(views, tracks)
    met: Flags = np.asarray(np.isfinite(points).all(axis=1))
    return tracks.some(met[tracks.track]), points[met]


def _partners(pairs: Integers, kept: Integers, count: int) -> list[Integers]:
    place = np.full(count, -1)
    place[kept] = np.arange(len(kept))
    both = place[pairs]
    both = both[(both >= 0).all(axis=1)]
    return [np.unique(np.r_[both[both[:, 0] == k, 1], both[both[:, 1] == k, 0]]) for k in range(len(kept))]


def _verified(final: AdjustedTies, tracks: Tracks) -> Integers:
    """Rays that fit the final orientation, of each track that two and more of them see."""
    views = _views(final)
    away = reprojection_errors(views, tracks, intersected(views, tracks))
    with np.errstate(invalid="ignore"):
        fit = away < GROSS * np.sqrt(2) * final.tie_sigma
    rays = np.bincount(tracks.track[fit], minlength=tracks.count)
    return np.asarray(rays[rays >= 2])

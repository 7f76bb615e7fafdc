"""Control brought to a block that its pictures alone have oriented: what fits places it, the rest is named.

A block keeps its shape whatever a person has typed. So gross errors of control are searched for before any of
it is adjusted: rays of a point must meet, and points that met must lie as surveyed, but for one similarity.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, islice

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.policy import policy
from photocal.block.model import ROLES, Block, ObjectPoints
from photocal.block.network import block_frame, observed_pixels
from photocal.findings.finding import Figure, Finding
from photocal.geometry.frames import LocalFrame
from photocal.geometry.localisation import Similarity, misses_of, similarity
from photocal.geometry.oriented_images import OrientedImages, given_poses
from photocal.geometry.rotation import angles_from_matrix
from photocal.measurement.tie_adjustment import AdjustedTies
from photocal.measurement.tie_block import LEAST_SPREAD, intersected, reprojection_errors, spread
from photocal.measurement.tracks import Tracks

# Rays of one point meet within so many pixels of a picture of the usual length, in a first orientation.
MEET_PX, USUAL_PX = 8.0, 4000.0
# Pairs of rays and triples of points that are tried, of many.
MOST_PAIRS, MOST_TRIPLES = 45, 1000
# A block of uncertain cameras is bent by this share of its extent; more is a gross error. Within it a point
# does not fit that misses by this many times the median, and by so many sigmas and pixels.
BENT, STRAY, SURVEYS, PIXELS = 0.01, 5.0, 5.0, 3.0
# Control contradicts positions that all lie off by so many sigmas, and by so many metres.
AGAINST, AGAINST_M, AGAINST_UP_M = 6.0, 10.0, 60.0
# What to do where control as a whole is not used, by the cause.
_REMEDIES = {
    "control-few": "mark-control",
    "control-in-line": "control-off-line",
    "control-exchanged": "exchange-axes",
    "control-contradicts-itself": "check-control",
    "control-refused": "check-control",
}
_TIE = ROLES.index("tie")
_SAME = Similarity(1.0, np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class _Rays:
    """Marks in oriented images, and which of them meet in their points.

    row: of each mark among the observations of the block.
    tracks: a track for each point of the block, with marks or without.
    met (points, 3): local; NaN where no two rays meet.
    miss_px: of each mark from where its point was met.
    """

    row: Integers
    tracks: Tracks
    meets: Flags
    met: Floats
    miss_px: Floats


@dataclass(frozen=True)
class _Fit:
    """How points that met lie to their survey: the move that most agree with, who does, and the misses, m.

    why: code of why no move is known; empty for one that is.
    """

    move: Similarity | None
    fits: Flags
    miss: Floats
    why: str = ""


def fit_control(
    adjusted: AdjustedTies, start: Block, views: OrientedImages
) -> tuple[Block, Floats, list[Finding], bool]:
    """Bring the marked control of a block to its images as tie points have oriented them.

    start: the block with all its marks, of more images perhaps.
    views: the oriented images in the local frame of the adjusted block.
    returns: the block with the marks that fit, where what is surveyed and does not fit is an unknown point of
        these marks; poses of its images, in its frame, to start from; what was found; and whether control
        alone says how the block lies.
    """
    frame, points = block_frame(adjusted.block), start.points
    placed = adjusted.start.datum != "free"
    rays = _meeting(*_marks_of(start, views.names), views, len(points.names))
    surveyed = ~points.of_role("tie") & np.isfinite(points.values).all(axis=1)
    target = np.where(surveyed[:, None], frame.to_local(points.values), np.nan)
    control = surveyed & points.of_role("control")
    # A coordinate that nobody has surveyed says nothing.
    judged = np.flatnonzero(
        control & np.isfinite(points.sigma).all(axis=1) & np.isfinite(rays.met).all(axis=1)
    )
    # What a pixel is on the ground, by the points themselves.
    gsd = _ground_px(rays, views)
    sigma = np.linalg.norm(points.sigma[judged], axis=1)
    if placed and len(judged) < policy.fewest_control:
        fit = _beside_positions(rays.met[judged], target[judged], adjusted)
    else:
        fit = _consistent(rays.met[judged], target[judged], sigma, gsd, placed=placed)
        turned = _consistent(rays.met[judged], target[judged][:, [1, 0, 2]], sigma, gsd, placed=placed)
        if _exchanged(fit, turned, level=start.frame != "local"):
            fit = replace(turned, move=None, fits=np.zeros_like(fit.fits), why="control-exchanged")
        if fit.move is None and placed:
            fit = replace(_beside_positions(rays.met[judged], target[judged], adjusted), why=fit.why)
    move, controlled = fit.move or _SAME, fit.move is not None and not fit.why
    known = controlled or placed
    keeps = np.zeros(len(points.names), dtype=np.bool_)
    keeps[judged[fit.fits]] = known
    findings = _not_meeting(points, rays, views) + [
        _off(points.names[j], float(fit.miss[k]), float(fit.miss[k] / (move.scale * gsd)))
        for k, j in enumerate(judged)
        if not fit.fits[k] and known
    ]
    # What has a single ray is compared with where the others put it.
    count = np.bincount(rays.tracks.track, minlength=len(points.names))
    if known:
        limit = _limit_px(views) + _tolerance(target[judged[fit.fits]], sigma[fit.fits]) / (move.scale * gsd)
        shown, away = _shown(rays.tracks, views, move, target)
        for j in np.flatnonzero(control & (count == 1) & shown):
            keeps[j] = away[j] <= limit
            if not keeps[j]:
                findings.append(_off(points.names[j], float(away[j] * move.scale * gsd), float(away[j])))
    keeps |= _checks_here(points, rays.met, target, move, surveyed & known)
    # What is used in plane or height alone is compared with nothing here.
    partly = points.of_role("control") & ~np.isfinite(points.sigma).all(axis=1)
    # What is marked nowhere does no harm, and is named as such.
    keeps |= (partly | (surveyed & (count == 0))) & known
    why = fit.why if control.any() else ""
    findings += _sentences(
        fit, why, target, judged, views, adjusted, placed=placed, listed=int(control.sum())
    )
    block = _with_what_fits(start, adjusted, rays, keeps, free=not known)
    if controlled and any(finding.code == "control-against-positions" for finding in findings):
        block.images.sigma[:, 3:] = np.inf
    return block, _moved(views, move, frame), findings, controlled


def _marks_of(start: Block, images: tuple[str, ...]) -> tuple[Integers, Tracks]:
    """Marks in images that are oriented, as rows of the block and with a track for each of its points."""
    seen, place = start.observations, {name: k for k, name in enumerate(images)}
    image = np.array([place.get(start.images.names[k], -1) for k in seen.image], dtype=np.int64)
    there = image >= 0
    pixels = observed_pixels(start)[there]
    marks = Tracks(seen.point[there], image[there], pixels, seen.sigma[there].mean(axis=1))
    return np.flatnonzero(there), marks


def _limit_px(views: OrientedImages) -> float:
    """How far a mark may lie from its place, before anything is known well."""
    return MEET_PX * max(1.0, float(views.sizes().max()) / USUAL_PX)


def _meeting(row: Integers, marks: Tracks, views: OrientedImages, count: int) -> _Rays:
    """Which marks of each point meet, and where: the pair of rays that most others agree with decides."""
    limit = _limit_px(views)
    meets, met = np.zeros(len(marks.track), dtype=np.bool_), np.full((count, 3), np.nan)
    miss = np.full(len(marks.track), np.nan)
    for j in np.unique(marks.track):
        rows = np.flatnonzero(marks.track == j)
        best: tuple[int, float] | None = None
        for chosen in islice(combinations(rows, 2), MOST_PAIRS):
            place = _met(marks, views, np.array(chosen))
            away = _misses(marks, views, rows, place)
            rank = (int((away <= limit).sum()), -float(np.minimum(away, limit).sum()))
            if best is None or rank > best:
                best, miss[rows] = rank, away
        good = rows[miss[rows] <= limit]
        if len(good) >= 2:
            place = _met(marks, views, good)
            away = _misses(marks, views, rows, place)
            # All of them together, unless one that was far off pulls them apart.
            if (away[np.isin(rows, good)] <= limit).all():
                met[j], miss[rows], meets[good] = place, away, True
    return _Rays(row, marks, meets, met, miss)


def _of_one_point(marks: Tracks, rows: Integers) -> Tracks:
    """Some marks as the rays of a single point."""
    some = marks.rows(rows)
    return replace(some, track=np.zeros_like(some.track))


def _met(marks: Tracks, views: OrientedImages, rows: Integers) -> Floats:
    """Where some rays come closest, before the cameras; else NaN."""
    some = _of_one_point(marks, rows)
    place = intersected(views, some)
    with np.errstate(invalid="ignore"):
        wide = spread(views, some, place)[0] >= LEAST_SPREAD
    return place[0] if wide else np.full(3, np.nan)


def _misses(marks: Tracks, views: OrientedImages, rows: Integers, place: Floats) -> Floats:
    """By how much marks miss a place, px; infinite behind the camera."""
    here = _of_one_point(marks, rows)
    with np.errstate(all="ignore"):
        away = reprojection_errors(views, here, place[None])
        towards = place - views.station[here.image]
        ahead = np.einsum("ni,ni->n", views.rotation[here.image, 2], towards) < 0.0
    return np.asarray(np.where(ahead & np.isfinite(away), away, np.inf))


def _ground_px(rays: _Rays, views: OrientedImages) -> float:
    """What a pixel of the marks is at their points, in the unit of the views."""
    rows = np.flatnonzero(rays.meets)
    if not len(rows):
        return 1.0
    image = rays.tracks.image[rows]
    far = np.linalg.norm(rays.met[rays.tracks.track[rows]] - views.station[image], axis=1)
    c = np.array([camera.value("c") / camera.pitch[0] for camera in views.cameras])[views.camera[image]]
    return float(np.median(far / c))


def _tolerance(target: Floats, sigma: Floats) -> float:
    """What a bent block may miss its control by, m."""
    if not len(target):
        return AGAINST_M
    extent = 2.0 * float(np.median(np.linalg.norm(target - np.median(target, axis=0), axis=1)))
    return max(BENT * extent, SURVEYS * float(np.median(sigma)))


def _consistent(source: Floats, target: Floats, sigma: Floats, gsd: float, *, placed: bool) -> _Fit:
    """Find the move that most points agree with, among those of triples, of all, and of no turn at all."""
    count, limit = len(source), _tolerance(target, sigma)
    nothing = _Fit(None, np.zeros(count, dtype=np.bool_), np.full(count, np.nan), "control-few")
    if count < policy.fewest_control:
        return nothing
    triples = list(combinations(range(count), policy.fewest_control))
    if len(triples) > MOST_TRIPLES:
        chosen = np.random.default_rng(count).choice(len(triples), MOST_TRIPLES, replace=False)
        triples = [triples[k] for k in chosen]
    choices = [list(range(count)), *map(list, triples)]
    moves = [move for some in choices if (move := similarity(source[some], target[some])) is not None]
    if not moves:
        return replace(nothing, why="control-in-line")
    moves += [replace(_SAME, shift=shift) for shift in (target - source if placed else [])]
    cost = [float(np.minimum(misses_of(move, source, target), limit).sum()) for move in moves]
    # Of triples that fit about as well, the one that turns the block least.
    about_as_well = 1.2
    alike = [move for move, c in zip(moves, cost, strict=True) if c <= about_as_well * min(cost) + gsd]
    best = min(alike, key=lambda move: _turned(move, whole=placed))
    fits = misses_of(best, source, target) <= limit
    if fits.sum() < policy.fewest_control or 2 * fits.sum() <= count:
        return replace(nothing, miss=misses_of(best, source, target), why="control-contradicts-itself")
    while True:
        better = similarity(source[fits], target[fits])
        if better is None:
            return replace(nothing, why="control-in-line")
        best, miss = better, misses_of(better, source, target)
        worst = int(np.argmax(np.where(fits, miss, -1.0)))
        noise = SURVEYS * sigma[worst] + PIXELS * gsd * best.scale
        few = fits.sum() <= max(policy.fewest_control + 1, np.ceil(2 * count / 3))
        if few or miss[worst] <= max(STRAY * float(np.median(miss[fits])), noise):
            return _Fit(best, fits, miss)
        fits[worst] = False


def _exchanged(typed: _Fit, turned: _Fit, *, level: bool) -> bool:
    """Whether control fits with E and N exchanged, and as it is typed not, or only from below the ground.

    Exchanged axes mirror the ground. Where that is flat they fit as well, seen by cameras that look up.

    level: whether heights are such of a map, whose ground is seen from above.
    """
    # The tilt beyond which cameras that looked down look up.
    upright = np.cos(np.radians(60.0))
    if turned.move is None or turned.move.rotation[2, 2] < upright:
        return False
    if typed.move is None or (level and typed.move.rotation[2, 2] < -upright):
        return bool(turned.fits.sum() >= typed.fits.sum())
    return bool(turned.fits.all() and not typed.fits.all())


def _turned(move: Similarity, *, whole: bool) -> float:
    """By how much a move turns, or tilts: cameras that look down tell the vertical, no direction."""
    return float(np.trace(move.rotation) if whole else move.rotation[2, 2]) * -1.0


def _beside_positions(source: Floats, target: Floats, adjusted: AdjustedTies) -> _Fit:
    """Points that are too few to say how the block lies, compared with its positions."""
    miss = target - source
    level = max(AGAINST_M, AGAINST * _position_sigma(adjusted))
    fits = (np.linalg.norm(miss[:, :2], axis=1) <= level) & (np.abs(miss[:, 2]) <= AGAINST_UP_M)
    return _Fit(None, np.asarray(fits, dtype=np.bool_), np.linalg.norm(miss, axis=1))


def _position_sigma(adjusted: AdjustedTies) -> float:
    sigma = adjusted.start.images.sigma[:, 3:5]
    return float(np.median(sigma[np.isfinite(sigma)])) if np.isfinite(sigma).any() else 0.0


def _shown(marks: Tracks, views: OrientedImages, move: Similarity, target: Floats) -> tuple[Flags, Floats]:
    """Points that have marks and a survey, and by how much the marks miss it, px."""
    back = (target - move.shift) @ move.rotation / move.scale
    away = np.full(len(target), np.nan)
    for j in np.unique(marks.track):
        rows = np.flatnonzero(marks.track == j)
        if np.isfinite(back[j]).all():
            away[j] = _misses(marks, views, rows, back[j]).min()
    return np.asarray(~np.isnan(away)), away


def _checks_here(
    points: ObjectPoints, met: Floats, target: Floats, move: Similarity, among: Flags | bool
) -> Flags:
    """Check points of this block: what is only wrong stays: its discrepancy shows it."""
    checks = points.of_role("check") & among
    known = checks & np.isfinite(met).all(axis=1)
    if not known.any():
        return np.asarray(checks)
    away = np.where(known, misses_of(move, np.nan_to_num(met), np.nan_to_num(target)), 0.0)
    # A check point that is off by more than so many such shares is no point of this block.
    elsewhere = 10.0
    limit = elsewhere * max(_tolerance(target[known], np.zeros(1)), AGAINST_M)
    return np.asarray(checks & (away <= limit))


def _off(name: str, miss_m: float, px: float) -> Finding:
    # Beyond this it is no distance in a picture any more.
    figures: dict[str, Figure] = {"miss_m": miss_m if np.isfinite(miss_m) else None}
    figures["px"] = px if np.isfinite(px) else None
    clauses = ("off-by",) if np.isfinite(miss_m) and np.isfinite(px) else ("off-somewhere",)
    return Finding("control-off", "doubtful", name, figures, clauses)


def _not_meeting(points: ObjectPoints, rays: _Rays, views: OrientedImages) -> list[Finding]:
    """Marks that do not show the place of the others, and points of which no two show one place."""
    findings = []
    for j in np.unique(rays.tracks.track):
        rows = np.flatnonzero(rays.tracks.track == j)
        name, lost = points.names[j], rows[~rays.meets[rows]]
        if len(rows) < 2 or not len(lost):
            continue
        if len(lost) == len(rows):
            images = tuple(views.names[k] for k in rays.tracks.image[rows])
            findings.append(Finding("marks-apart", "doubtful", name, {"images": images}))
            continue
        for k in lost:
            px = float(rays.miss_px[k]) if np.isfinite(rays.miss_px[k]) else None
            figures: dict[str, Figure] = {"image": views.names[rays.tracks.image[k]], "px": px}
            clauses = ("off-somewhere",) if px is None else ("mark-off-by",)
            findings.append(Finding("mark-left-out", "doubtful", name, figures, clauses))
    return findings


def not_used(why: str, figures: Mapping[str, Figure]) -> Finding:
    """Say that control as a whole places nothing, and what to do about the cause."""
    return Finding("control-not-used", "doubtful", figures=figures, cause=why, remedy=_REMEDIES[why])


def _sentences(
    fit: _Fit,
    why: str,
    target: Floats,
    judged: Integers,
    views: OrientedImages,
    adjusted: AdjustedTies,
    *,
    placed: bool,
    listed: int,
) -> list[Finding]:
    """What is to be said of control as a whole."""
    if fit.move is None:
        if not why or (placed and why == "control-few"):
            return []
        figures: dict[str, Figure] = {"n": float(len(judged)), "all": float(listed)}
        return [not_used(why, figures)]
    findings = []
    used, middle = judged[fit.fits], views.station.mean(axis=0)
    shift = fit.move.applied(middle) - middle
    off = float(np.hypot(*shift[:2]))
    if placed and off > max(AGAINST_M, AGAINST * _position_sigma(adjusted)):
        east, north, up = shift
        figures = {"east_m": float(east), "north_m": float(north), "up_m": float(up)}
        findings.append(Finding("control-against-positions", "doubtful", figures=figures))
    width, block = (
        float(np.linalg.norm(np.ptp(places, axis=0)))
        for places in (target[used], fit.move.scale * views.station)
    )
    # Control whose width is a smaller share of the block's holds one corner of it.
    corner = 0.25
    if width < corner * block:
        share: dict[str, Figure] = {"percent": 100.0 * width / block, "n": float(len(used))}
        findings.append(Finding("control-in-corner", "doubtful", figures=share))
    return findings


def _with_what_fits(start: Block, adjusted: AdjustedTies, rays: _Rays, keeps: Flags, *, free: bool) -> Block:
    """The block of the oriented images with the marks that fit.

    Of points that do not fit, the marks that meet stay: they are points like others.
    """
    alone, points = adjusted.start, start.points
    tie = points.of_role("tie")
    rows = {name: k for k, name in enumerate(start.images.names)}
    images = start.images.some(np.array([rows[name] for name in alone.images.names], dtype=np.int64))
    # A camera none of whose images is oriented has gone with them.
    images = replace(images, camera=alone.images.camera)
    sigma = images.sigma.copy()
    if alone.datum != "free":
        sigma[:, 3:] = alone.images.sigma[:, 3:]
    elif free:
        sigma[:] = np.inf
    marks = rays.tracks
    single = np.bincount(marks.track, minlength=len(keeps)) == 1
    used = rays.meets | (keeps & ~tie & single)[marks.track]
    left_over = ~keeps & ~tie
    known = ObjectPoints(
        points.names,
        np.where(left_over[:, None], np.nan, points.values),
        np.where(left_over[:, None], np.inf, points.sigma),
        np.where(left_over, _TIE, points.role),
        None if points.cross is None else np.where(left_over[:, None], 0.0, points.cross),
    )
    # A point of no use and no rays would only stand in tables.
    stays = keeps | tie | (np.bincount(marks.track[used], minlength=len(keeps)) > 1)
    place = np.cumsum(stays) - 1
    used &= stays[marks.track]
    seen = start.observations.rows(rays.row[used])
    return replace(
        alone,
        datum="free" if free else "control",
        images=replace(images, sigma=sigma),
        points=known.only(stays),
        observations=replace(seen, image=marks.image[used], point=place[marks.track[used]]),
    )


def _moved(views: OrientedImages, move: Similarity, frame: LocalFrame) -> Floats:
    """Poses in the coordinates of the block after a move in its local frame."""
    rotation = move.applied_to_rotations(views.rotation)
    return given_poses(frame, np.hstack([angles_from_matrix(rotation), move.applied(views.station)]))

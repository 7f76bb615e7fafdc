"""Images oriented by their tie points alone, then placed by control points and positions.

The shape of a block comes from its rays; what images say of their positions, which may be wrong by tens of
metres, only places it. So a wrong position bends nothing and can be distinguished from the others.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.adjustment.network import Rays
from photocal.adjustment.start.bearings import bearings
from photocal.adjustment.start.model import LENS, Model, empty_model, grown, held_to_given, misfit, support
from photocal.adjustment.start.values import free_models
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import IllPosedError
from photocal.block.model import Block, Images
from photocal.block.network import block_frame, observed_plane
from photocal.findings.finding import Finding, Severity
from photocal.geometry.camera import Camera
from photocal.geometry.localisation import Similarity, aligned_similarity, misses_of, robust_similarity
from photocal.geometry.oriented_images import given_poses, local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.measurement.features import made_once
from photocal.measurement.tie_block import POSITION_SIGMA_M, views_of, with_ties
from photocal.measurement.tracks import Tracks

# The principal distance that was given is kept where the rays fit it so well, and meet in threes so often,
# as the one that they would choose: flat ground seen from one height says next to nothing about it, and what
# the model of the camera lacks biases it. Beyond these shares of it, it is never believed.
KEPT_MISFIT, KEPT_SUPPORT = 1.5, 0.9
CREDIBLE = (0.7, 1.4)
# Places whose errors leave a turn open by more than this (rad) do not say how the whole lies.
OPEN_TURN = 0.25
# How well a level camera, or attitudes of the vehicle, then say it, rad.
LEVEL = 0.2
# A position that misses by so many sigmas is wrong; positions that miss by so many all together are worse
# than was assumed.
WRONG_POSITION, WORSE_POSITIONS = 6.0, 2.0
OF_POSITIONS = ("position-off", "positions-worse", "heights-apart")
# Heights of receivers and of control that differ by more refer to different surfaces, m.
HEIGHTS_APART_M = 3 * POSITION_SIGMA_M[2]
# No geoid lies farther from the ellipsoid.
LARGEST_UNDULATION_M = 110.0
# Cosine of the angle to within which recorded directions and pictures agree; of so many of them, or the
# record is none of the pictures. A picture whose upper edge points to the sky has no direction.
SAME_WAY, MOST, UPRIGHT = 0.87, 0.9, 0.3
# Images of a model that is joined to another by positions alone, and how well these turn it (rad).
FEWEST_JOINED, JOINED_TURN = 4, 0.05

# A block with the poses of its images, why some have none, and what was found.
Placed = tuple[Block, Floats, tuple[str, ...], tuple[Finding, ...]]


def oriented(block: Block, tracks: Tracks, cache: Path | None = None) -> Placed:
    """Orient the images of a block by tracks, and place them by control points, positions and attitudes.

    cache: folder where the models of rays alone are kept.
    returns: the block, its cameras as good as they are known now, its datum and the sigmas of its positions
        as they are borne out; poses in its frame, (images, 6), NaN for images that are not oriented; why not,
        for each image, empty for those that are; and what was found.
    raises IllPosedError: when no two images are oriented to each other.
    """
    frame = block_frame(block)
    given = local_poses(frame, block.images.values)
    views = views_of(block, frame)
    tracks = replace(tracks, pixels=views.at_the_middle(tracks.image, tracks.pixels))
    whole = with_ties(block, tracks, np.full((tracks.count, 3), np.nan), np.ones(len(tracks.track)))
    cameras = tuple(replace(camera, estimated=camera.estimated | LENS) for camera in block.cameras)
    seen = bearings(cameras, block.images.camera, len(whole.points.names), _rays(whole))
    # Made once: they do not depend on marks and positions.
    models = made_once(cache, tuple[Model, ...], seen, lambda: tuple(free_models(seen)))
    if not models or models[0].oriented.sum() < 2:
        raise IllPosedError(
            "the images cannot be oriented by tie points: no two of them show the same places from two sides",
            "take images that overlap by 60 % and more, from different places",
        )
    known = block.points.of_role("control")[:, None] & (block.datum == "control")
    control = np.vstack(
        [np.where(known, frame.to_local(block.points.values), np.nan), np.full((tracks.count, 3), np.nan)]
    )
    model, findings = _calibrated(models[0], block.cameras)
    block = replace(block, cameras=_cameras(block.cameras, model))
    sigma = _position_sigma(block, given)
    move, determined = _placing(model, control, given, sigma)
    turn = np.nan if determined else _turn_of_line(model, given, sigma)
    if not determined and np.isnan(turn):
        block = replace(
            block, datum="free", images=replace(block.images, sigma=np.full_like(block.images.sigma, np.inf))
        )
        findings.append(Finding("block-not-placed", "doubtful"))
    model = _moved(model, move)
    unreached = "its tie points do not orient it relative to the other images"
    reasons = np.where(model.oriented, "", unreached).astype(object)
    for more in models[1:]:
        added = more.oriented & ~model.oriented
        count = int(added.sum())
        reasons[added] = f"belongs to another block of {count} images; no point of three images joins the two"
        move, _ = _placing(more, control, given, sigma)
        if determined and count >= FEWEST_JOINED and _turn_sigma(more, move, given) < JOINED_TURN:
            model = _together(model, _moved(more, move), added)
            reasons[added] = ""
    lost = ~model.oriented
    poses = np.hstack([angles_from_matrix(model.rotation), model.centre])
    # What was known of an image before is better than nothing.
    complete = lost & np.isfinite(given).all(axis=1) & determined
    poses[complete], reasons[complete] = given[complete], ""
    poses = given_poses(frame, poses)
    if turn > 0:
        # That cameras look down keeps the block from turning about the line; one image does for all.
        images, level = block.images, int(np.argmax(np.bincount(tracks.image)))
        values, stated = images.values.copy(), images.sigma.copy()
        values[level, :3], stated[level, :3] = poses[level, :3], LEVEL
        block = replace(block, images=replace(images, values=values, sigma=stated))
        findings.append(Finding("positions-in-line", "doubtful", figures={"turn_deg": math.degrees(turn)}))
    if (determined or turn > 0) and block.datum == "control":
        block = replace(block, images=reweighted(block.images, poses, shifted=False))
    return block, poses, tuple(reasons), tuple(findings)


def continued(block: Block, tracks: Tracks, before: Block, values: Floats) -> Placed | None:
    """Orient a block from where an earlier adjustment left the images that both have.

    Nothing is placed anew: what is new is resected from the points of the other images.

    before: the earlier block, adjusted in the same system.
    values (images, 6): its exterior orientations.
    returns: as `oriented`; None where the earlier block was not placed by its positions or attitudes alone,
        has other cameras, or does not reach all images.
    """
    tilted = np.isfinite(before.images.sigma[:, :3]).any() > np.isfinite(block.images.sigma[:, :3]).any()
    same = [(camera.id, camera.estimated[0]) for camera in block.cameras]
    if tilted or block.datum != before.datum or same != [(c.id, c.estimated[0]) for c in before.cameras]:
        return None
    known = dict(zip(before.images.names, values, strict=True))
    frame, cameras = block_frame(block), before.cameras
    block = replace(block, cameras=cameras)
    views = views_of(block, frame)
    tracks = replace(tracks, pixels=views.at_the_middle(tracks.image, tracks.pixels))
    whole = with_ties(block, tracks, np.full((tracks.count, 3), np.nan), np.ones(len(tracks.track)))
    seen = bearings(cameras, block.images.camera, len(whole.points.names), _rays(whole))
    model = empty_model(seen, np.full((len(whole.points.names), 3), np.nan))
    local = local_poses(frame, np.array([known.get(name, np.full(6, np.nan)) for name in block.images.names]))
    there = np.isfinite(local).all(axis=1)
    model.rotation[there], model.centre[there] = matrix_from_angles(local[there, :3]), local[there, 3:]
    model = grown(model, np.ones(seen.images, dtype=np.bool_))
    if not model.oriented.all():
        return None
    poses = given_poses(frame, np.hstack([angles_from_matrix(model.rotation), model.centre]))
    block = replace(block, cameras=_cameras(cameras, model))
    if block.datum == "control":
        block = replace(block, images=reweighted(block.images, poses, shifted=False))
    return block, poses, ("",) * len(poses), ()


def _rays(block: Block) -> Rays:
    seen = block.observations
    plane, sigma = observed_plane(block)
    order = np.argsort(seen.point, kind="stable")
    return Rays(seen.image[order], seen.point[order], plane[order], sigma[order])


def _calibrated(model: Model, given: tuple[Camera, ...]) -> tuple[Model, list[Finding]]:
    """The model with principal distances as given, where it bears them, else with its own."""
    wanted = [camera.estimated[0] for camera in given]
    if all(wanted):
        return model, []
    held = held_to_given(model)
    share = [b.value("c") / o.value("c") for o, b in zip(given, model.bearings.cameras, strict=True)]
    credible = all(CREDIBLE[0] < ratio < CREDIBLE[1] for ratio in share)
    bears = misfit(held) < KEPT_MISFIT * misfit(model) and support(held) > KEPT_SUPPORT * support(model)
    if held.oriented.sum() >= 2 and ((bears and (held.oriented == model.oriented).all()) or not credible):
        return held, []
    findings = []
    for camera, better in zip(given, model.bearings.cameras, strict=True):
        if not camera.estimated[0]:
            figures = {"given": camera.value("c"), "unit": camera.unit, "value": better.value("c")}
            findings.append(Finding("c-refuted-by-rays", "doubtful", camera.id, figures))
    return model, findings


def _cameras(given: tuple[Camera, ...], model: Model) -> tuple[Camera, ...]:
    """Cameras with the values of the model; c is estimated where the model could not keep the given one."""
    cameras = []
    for camera, better in zip(given, model.bearings.cameras, strict=True):
        estimated = camera.estimated.copy()
        estimated[0] |= better.value("c") != camera.value("c")
        # What is held keeps its value.
        values = np.where(estimated, better.values, camera.values)
        cameras.append(replace(camera, estimated=estimated, values=values))
    return tuple(cameras)


def _position_sigma(block: Block, given: Floats) -> float:
    """Usual sigma of a coordinate of the positions, m; 0 where they are not observed."""
    sigma = block.images.sigma[np.isfinite(given[:, 3:]).all(axis=1), 3:]
    return float(np.median(sigma[np.isfinite(sigma)])) if np.isfinite(sigma).any() else 0.0


def _placing(model: Model, control: Floats, given: Floats, sigma: float) -> tuple[Similarity, bool]:
    """How a model is brought to the object, and whether control and positions determine that."""
    points = model.placed & np.isfinite(control[:, 0])
    images = model.oriented & np.isfinite(given[:, 3:]).all(axis=1)
    both = (
        np.vstack([model.points[points], model.centre[images]]),
        np.vstack([control[points], given[images, 3:]]),
    )
    # Heights of positions may refer to another surface: control alone, where it suffices.
    for source, target, error in ((model.points[points], control[points], 0.0), (*both, sigma)):
        fit = robust_similarity(source, target)
        if fit is not None:
            move, fits = fit
            if _turn(target[fits], misses_of(move, source, target)[fits], error) < OPEN_TURN:
                return move, True
    axes, goals = _directions(model, given)
    source, target = both
    if not len(source):
        source, target = model.centre[model.oriented][:1], np.zeros((1, 3))
    weight = max(sigma, 1e-3) ** 2 / LEVEL**2 * max(len(source), 1)
    return aligned_similarity(source, target, axes, goals, weight), False


def _turn_of_line(model: Model, given: Floats, sigma: float) -> float:
    """By how much a model may turn about the line of its positions, that say all else, rad; else NaN."""
    images = model.oriented & np.isfinite(given[:, 3:]).all(axis=1)
    if images.sum() < FEWEST_JOINED or not sigma:
        return np.nan
    source, target, nothing = model.centre[images], given[images, 3:], np.zeros((0, 3))
    miss = misses_of(aligned_similarity(source, target, nothing, nothing, 0.0), source, target)
    length = float(np.linalg.norm(target - target.mean(axis=0), 2))
    error = max(float(np.sqrt(np.mean(miss**2))), sigma)
    return min(LEVEL, _turn(target, miss, sigma)) if error < OPEN_TURN * length else np.nan


def _turn(target: Floats, miss: Floats, sigma: float) -> float:
    """By how much places of some sigma leave a turn about their line open, rad."""
    extent = np.linalg.svd(target - target.mean(axis=0), compute_uv=False)
    freedom = max(3 * len(target) - 7, 1)
    error = max(float(np.sqrt(np.sum(miss**2) / freedom)), sigma)
    return error / max(float(extent[1]), 1e-12)


def _turn_sigma(model: Model, move: Similarity, given: Floats) -> float:
    images = model.oriented & np.isfinite(given[:, 3:]).all(axis=1)
    if images.sum() < FEWEST_JOINED:
        return np.inf
    target = given[images, 3:]
    return _turn(target, misses_of(move, model.centre[images], target), 0.0)


def _directions(model: Model, given: Floats) -> tuple[Floats, Floats]:
    """Directions in the model, and what they are in the object: attitudes, or that cameras look down."""
    images = model.oriented & np.isfinite(given[:, :3]).all(axis=1)
    if images.any():
        return (model.rotation[images].reshape(-1, 3), matrix_from_angles(given[images, :3]).reshape(-1, 3))
    up = model.rotation[model.oriented, 2].mean(axis=0)
    return (up / np.linalg.norm(up))[None], np.array([[0.0, 0.0, 1.0]])


def _moved(model: Model, move: Similarity) -> Model:
    return replace(
        model,
        rotation=move.applied_to_rotations(model.rotation),
        centre=move.applied(model.centre),
        points=move.applied(model.points),
    )


def _together(model: Model, more: Model, added: Flags) -> Model:
    return replace(
        model,
        rotation=np.where(added[:, None, None], more.rotation, model.rotation),
        centre=np.where(added[:, None], more.centre, model.centre),
    )


def position_sigmas(images: Images, values: Floats, *, shifted: bool) -> tuple[Floats, Floats, list[Finding]]:
    """Standard deviations of positions, as images oriented without or with them show.

    images: with positions and the sigmas that were stated.
    values (images, 6): exterior orientations in the same frame; NaN where unknown.
    shifted: whether something better places the block, so that what all positions have in common is no
        scatter.
    returns sigma (images, 6): as stated where the rays bear it out; larger where all are worse; infinite
        where one is wrong, and of heights that refer to another surface than what places the block.
    returns shift (3,): what all positions are off by, m.
    """
    sigma, shift = images.sigma.copy(), np.zeros(3)
    stated = sigma[:, 3:]
    observed = np.isfinite(values[:, 3]) & np.isfinite(stated).all(axis=1) & (stated > 0).all(axis=1)
    if observed.sum() < FEWEST_JOINED:
        return sigma, shift, []
    miss = values[observed, 3:] - images.values[observed, 3:]
    if shifted:
        shift = np.median(miss, axis=0)
        miss = miss - shift
    ratio = np.linalg.norm(miss / stated[observed], axis=1) / np.sqrt(3)
    # Median of what positions of the stated sigmas miss by, over these.
    usual_ratio = 0.89
    factor = max(1.0, float(np.median(ratio)) / usual_ratio)
    wrong = ratio > WRONG_POSITION * factor
    findings = [
        Finding("position-off", "doubtful", images.names[k], {"off_m": float(np.linalg.norm(miss[j]))})
        for j, k in enumerate(np.flatnonzero(observed))
        if wrong[j]
    ]
    apart = abs(shift[2]) > HEIGHTS_APART_M
    if apart:
        beyond: Severity = "doubtful" if abs(shift[2]) > LARGEST_UNDULATION_M else "note"
        findings.append(Finding("heights-apart", beyond, figures={"up_m": float(shift[2])}))
    if factor > WORSE_POSITIONS:
        findings.append(Finding("positions-worse", "doubtful", figures={"factor": factor}))
        sigma[:, 3:] *= factor
    sigma[np.flatnonzero(observed)[wrong], 3:] = np.inf
    # Sigmas that cover any surface are of one common error, which positions of so many images would reduce.
    if apart and np.median(stated[observed, 2]) > HEIGHTS_APART_M:
        sigma[observed, 5] = np.inf
    return sigma, shift, findings


def pictures_turned(names: Sequence[str], values: Floats, gimbal: Floats) -> list[Finding]:
    """Name pictures that are stored turned by half a turn against the direction recorded with them.

    Who turns a picture afterwards turns its principal point and its readout, too.

    values (images, 6): exterior orientations.
    gimbal (images, 3): recorded roll, pitch and yaw, rad; NaN where unknown.
    """
    # Beyond the nadir a gimbal may write a roll of half a turn, and the yaw from the other side.
    heading = gimbal[:, 2] + np.where(np.abs(gimbal[:, 0]) > np.pi / 2, np.pi, 0.0)
    up = matrix_from_angles(values[:, :3])[:, 1]
    off = np.exp(1j * (np.arctan2(up[:, 0], up[:, 1]) - heading))
    known = np.isfinite(off) & (np.hypot(up[:, 0], up[:, 1]) > UPRIGHT)
    if known.sum() < FEWEST_JOINED:
        return []
    # Twice the angle is the same for both: the axis first, then the side where most of them are.
    axis = np.exp(0.5j * np.angle(np.mean(off[known] ** 2)))
    along = np.where(known, (off * axis.conjugate()).real, 0.0)
    along *= np.sign(np.sum(np.sign(along))) or np.sign(axis.real)
    turned = along < -SAME_WAY
    if not turned.any() or np.mean(np.abs(along[known]) > SAME_WAY) < MOST:
        return []
    listed = tuple(names[k] for k in np.flatnonzero(turned).tolist())
    return [Finding("pictures-turned", "doubtful", figures={"images": listed, "count": len(listed)})]


def reweighted(images: Images, values: Floats, *, shifted: bool) -> Images:
    """Images whose positions weigh as much as they fit: what bends a block is not drawn straight at once."""
    sigma, shift, _ = position_sigmas(images, values, shifted=shifted)
    sigma[:, 3:] = np.hypot(sigma[:, 3:], np.abs(shift))
    return replace(images, sigma=np.where(images.sigma == 0, 0.0, sigma))

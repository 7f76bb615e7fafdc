"""What a project of another program loses: gross rays, gross control, weakly determined points.

A project of another program without control, brought onto a list beside it.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from photocal.adjustment.datum import with_datum
from photocal.adjustment.lasers import NO_LASERS
from photocal.adjustment.network import NO_RELATIONS
from photocal.adjustment.normal import prepare
from photocal.adjustment.snooping import ray_fit, robust_state, subset
from photocal.adjustment.state import start_state
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.base.files import write_rows
from photocal.base.policy import policy
from photocal.block.model import ROLES, Block, ObjectPoints
from photocal.block.network import assemble, behind_cameras, block_frame, frame_of
from photocal.block.rig import Head
from photocal.exchange.foreign_project import ForeignProject, without_weak_points
from photocal.geometry.camera import Camera, among
from photocal.geometry.frames import UNSTATED, ShiftedFrame
from photocal.geometry.localisation import aligned_similarity, robust_similarity
from photocal.geometry.oriented_images import OrientedImages, given_places, given_poses, local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.measurement.mark_frames import inside
from photocal.measurement.marks import (
    ControlMarks,
    in_map_system,
    named_after,
    read_control_marks,
    with_marks,
)
from photocal.measurement.tie_block import TIE, intersected, tracks_of, views_of
from photocal.measurement.tracks import Tracks
from photocal.run.control_files import ASSUMED_M

GROSS_RAYS = "rays-left-out.csv"
# Control so many times farther than usual from where its rays meet would bend the block; so much is enough to
# tell what is usual.
FAR, ENOUGH_CONTROL = 30.0, 5
# Three rays give a pose that nothing checks; images that are named in one remark.
FEWEST_RAYS, MOST_NAMED = 4, 6
# The distance of a point with a smaller parallax is known to a fifth at best, with a measurement of 1 px.
LEAST_PARALLAX_PX = 5.0


def without_gross_rays(foreign: ForeignProject, output: Path) -> ForeignProject:
    """Leave out rays that do not fit the others, whatever control and positions say; `output` lists them."""
    block = foreign.block
    seen, tie = block.observations, block.points.of_role("tie")
    rays = np.flatnonzero(crossed(block))
    assembly = assemble(by_rays_alone(block))
    whole = assembly.network
    lost = behind_cameras(whole.exposures, whole.rays, whole.points.values)
    network, kept, kept_points = subset(whole, ~lost[whole.rays.point])
    problem, start = prepare(network), start_state(network)
    state = robust_state(with_datum(problem, start), start)
    places = assembly.frame.to_given(state.points)
    foreign = _without_gross_control(foreign, assembly.points[kept_points], places)
    block, fit = foreign.block, ray_fit(problem, state)
    gross = np.zeros(len(seen.point), dtype=np.bool_)
    rays = rays[assembly.rays]
    gross[rays] = True
    rays = rays[kept]
    # Residuals are as much smaller than errors as unknowns take from them; of the lengths of pairs of normal
    # deviates the median is known, and what one in all exceeds.
    taken = (3 * len(network.point_names) + 6 * len(network.image_names)) / (2 * len(fit))
    limit = np.sqrt(np.log(2 * len(fit)) / np.log(2) / max(1 - taken, policy.least_checked))
    for kind in np.unique(tie[seen.point[rays]]):
        of_kind = tie[seen.point[rays]] == kind
        gross[rays[of_kind]] = fit[of_kind] > limit * np.median(fit[of_kind])
    if not gross.any():
        return foreign
    names, points = block.images.names, block.points.names
    listed = [(names[seen.image[k]], points[seen.point[k]], *seen.values[k]) for k in np.flatnonzero(gross)]
    write_rows(output / GROSS_RAYS, ("image", "point", "x", "y"), ([*map(str, row)] for row in listed))
    remarks = [f"{len(listed)} of {len(gross)} rays do not fit the others: left out ({GROSS_RAYS})"]
    marks = [
        f"{points[seen.point[k]]} in {names[seen.image[k]]}" for k in np.flatnonzero(gross & ~tie[seen.point])
    ]
    remarks += [f"{len(marks)} marks of surveyed points among them: {some_of(marks)}"] if marks else []
    fitting = replace(block, observations=seen.rows(~gross))
    return replace(foreign, block=fitting, remarks=(*foreign.remarks, *remarks))


def _without_gross_control(foreign: ForeignProject, points: Integers, places: Floats) -> ForeignProject:
    """Take control points that lie far from where their rays meet as check points.

    points (n,): those of the block that have `places` (n, 3) by rays alone.
    """
    block = foreign.block
    control = block.points.of_role("control")[points]
    names, source, target = points[control], places[control], block.points.values[points[control]]
    known = np.isfinite(target).all(axis=1) & np.isfinite(source).all(axis=1)
    names, source, target = names[known], source[known], target[known]
    if len(names) < ENOUGH_CONTROL:
        return foreign
    robust = robust_similarity(source, target)
    seen = robust[0].applied(source) if robust else source - np.median(source - target, axis=0)
    miss = np.linalg.norm(seen - target, axis=1)
    limit = FAR * max(float(np.median(miss)), float(np.median(block.points.sigma[names])))
    far = np.flatnonzero(miss > limit)
    if not 0 < len(far) < len(names) / 2:
        return foreign
    label = [block.points.names[k] for k in names]
    told = [f"{label[k]} {miss[k]:.3g} m" for k in far]
    remarks = [
        f"control points far from the intersection of their rays are used as check points: {some_of(told)}"
    ]
    remarks += [
        f"coordinates of {label[a]} and {label[b]} are exchanged"
        for a, b in combinations(far, 2)
        if max(np.linalg.norm(seen[a] - target[b]), np.linalg.norm(seen[b] - target[a])) < limit
    ]
    role = block.points.role.copy()
    role[names[far]] = ROLES.index("check")
    points_now = replace(block.points, role=role)
    return replace(foreign, block=replace(block, points=points_now), remarks=(*foreign.remarks, *remarks))


def by_rays_alone(block: Block) -> Block:
    """Free block of images and their rays, whatever control and positions say."""
    # What was surveyed may be exchanged: it is where its rays meet.
    places = np.where(block.points.of_role("tie")[:, None], block.points.values, np.nan)
    count = len(places)
    return replace(
        block,
        datum="free",
        datum_points=(),
        cameras=tuple(_nearly_known(camera) for camera in block.cameras),
        images=replace(block.images, sigma=np.full_like(block.images.sigma, np.inf)),
        points=ObjectPoints(block.points.names, places, np.full_like(places, np.inf), np.full(count, TIE)),
        observations=block.observations.rows(np.flatnonzero(crossed(block))),
        relations=NO_RELATIONS,
        lasers=NO_LASERS,
        heads=(),
    )


def _nearly_known(camera: Camera) -> Camera:
    """The camera with c, x0 and y0 within a hundredth of c: a level block alone does not determine them."""
    # What a camera is known to during the search for gross errors, as a share of c.
    roughly = 0.01
    sigma = np.where(among("c", "x0", "y0"), roughly * camera.value("c"), camera.prior_sigma)
    return replace(camera, prior_sigma=np.minimum(sigma, camera.prior_sigma))


def some_of(names: Sequence[str]) -> str:
    """Name the first of many."""
    return ", ".join(names[:MOST_NAMED]) + (" ..." if len(names) > MOST_NAMED else "")


def without_weak_parts(foreign: ForeignProject) -> ForeignProject:
    """Leave out points with one ray or no parallax, and images whose pose their rays do not check."""
    lost, names, weak, heads = 0, list[str](), foreign.block, {c.id for c in foreign.block.cameras}
    weak, blind = _with_directions(weak)
    weak, flat = _without_parallax(weak)
    while True:
        block, fewer = without_weak_points(weak)
        lost += fewer
        few = np.bincount(block.observations.image, minlength=len(block.images.names)) < FEWEST_RAYS
        if not few.any() or few.all():
            break
        names += [block.images.names[k] for k in np.flatnonzero(few)]
        weak, kept = block.of_images(~few), ~few
        # Of the images that stay: what is not as long as the block counts as not known.
        foreign = replace(
            foreign,
            block=weak,
            position=foreign.position[kept],
            position_sigma=foreign.position_sigma[kept],
            pose_sigma=foreign.pose_sigma[kept],
        )
    gone = sorted(heads - {camera.id for camera in block.cameras})
    block = replace(block, heads=_still_on_frames(block.heads, gone))
    remarks = [f"{lost} points have one ray only: left out"] if lost else []
    if blind:
        remarks.append(f"{blind} rays cannot be corrected for the distortion of their cameras: left out")
    if flat:
        remarks.append(f"{flat} points have a parallax below {LEAST_PARALLAX_PX:g} px: left out")
    if names:
        remarks.append(f"{len(names)} images have fewer than {FEWEST_RAYS} rays: left out ({some_of(names)})")
    if gone:
        remarks.append(f"no image of camera {some_of(gone)} has {FEWEST_RAYS} rays: the camera is left out")
    left = tuple(camera for camera in foreign.cameras if camera.id not in gone)
    return replace(foreign, block=block, cameras=left, remarks=(*foreign.remarks, *remarks))


def _still_on_frames(heads: Sequence[Head], gone: Sequence[str]) -> tuple[Head, ...]:
    """Heads without those of cameras that are gone; a frame without its first, or all others, ends."""
    left = [head for head in heads if head.camera not in gone and head.of not in gone]
    others = {head.of for head in left if head.camera != head.of}
    return tuple(head for head in left if head.of in others)


def _with_directions(block: Block) -> tuple[Block, int]:
    """Leave out rays that no direction belongs to: a polynomial may not be one to one so far out."""
    views, seen = views_of(block, ShiftedFrame(np.zeros(3))), block.observations
    with np.errstate(over="ignore", invalid="ignore"):
        ideal, c = views.ideal(seen.image, seen.values)
        # No plane image reaches farther from its middle, in principal distances.
        widest = 1e3
        good = (np.abs(ideal) < widest * c[:, None]).all(axis=1)
    return replace(block, observations=seen.rows(good)), int((~good).sum())


def _without_parallax(block: Block) -> tuple[Block, int]:
    """Give tie points without coordinates those where their rays meet; leave out those that hardly do."""
    tie, rays = block.points.of_role("tie"), crossed(block)
    if np.isnan(block.images.values).any():
        return block, 0
    seen, frame = block.observations, block_frame(block)
    points, tracks = tracks_of(seen, rays & tie[seen.point])
    if not len(points):
        return block, 0
    views = views_of(block, frame)
    local = intersected(views, tracks)
    flat = points[~(_parallax_px(views, tracks) > LEAST_PARALLAX_PX) | np.isnan(local).any(axis=1)]
    values = block.points.values.copy()
    bare = np.isnan(values[points]).any(axis=1) & np.isfinite(local).all(axis=1)
    values[points[bare]] = frame.to_given(local[bare])
    keep = np.ones(len(values), dtype=np.bool_)
    keep[flat] = False
    return replace(block, points=replace(block.points, values=values)).of_points(keep), len(flat)


def _parallax_px(views: OrientedImages, tracks: Tracks) -> Floats:
    """Twice the largest angle of a point's rays from their mean, px of the longest lens, (tracks.count,)."""
    ideal, c = views.ideal(tracks.image, tracks.pixels)
    rotation, _ = views.at_lines(tracks.image, tracks.pixels)
    towards = np.einsum("nji,nj->ni", rotation, np.column_stack([ideal, -c]))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    mean = np.column_stack([np.bincount(tracks.track, towards[:, k], tracks.count) for k in range(3)])
    mean = mean / np.linalg.norm(mean, axis=1)[:, None]
    apart, longest = np.zeros((2, tracks.count))
    np.maximum.at(apart, tracks.track, np.linalg.norm(towards - mean[tracks.track], axis=1))
    pitch = np.array([camera.pitch[0] for camera in views.cameras])
    np.maximum.at(longest, tracks.track, c / pitch[views.camera[tracks.image]])
    return 2 * apart * longest


def crossed(block: Block) -> Flags:
    """Observations of points that two rays and more see, shape (n,)."""
    seen = block.observations.point
    return np.asarray(np.bincount(seen, minlength=len(block.points.names))[seen] > 1)


_CHECK = re.compile(r"(?i)check|chk")
# Weight of the direction in which images look, beside places of control that lie nearly in a line.
LEVELLING_M2, _UP = 1.0, np.array([[0.0, 0.0, 1.0]])


def with_control(given: ForeignProject, path: Path, gcp: Path | None) -> ForeignProject:
    """Bring a project without control onto that of a list beside it."""
    folder = path if path.is_dir() else path.parent
    lists = [gcp] if gcp is not None else sorted(folder.rglob("gcp_list.txt"), key=lambda p: len(p.parts))
    if not lists:
        return given
    if not given.block.points.of_role("tie").all():
        unused = f"{lists[0].name} is not used: the project has control of its own"
        return given if gcp is None else replace(given, remarks=(*given.remarks, unused))
    block = given.block
    names = block.images.names
    sizes = {name: block.cameras[k].size_px for name, k in zip(names, block.images.camera, strict=True)}
    control = _with_checks(in_map_system(read_control_marks(lists[0], ASSUMED_M, sizes)))
    none = block.observations.rows(np.empty(0, dtype=np.int64))
    marks = named_after(control.marks, names)
    within = [mark for mark in marks if mark.image not in sizes or inside(mark, sizes[mark.image])]
    marked, unknown = with_marks(replace(block, points=control.points, observations=none), within)
    lost = [f"{len(unknown)} marks are in no image of the project ({unknown[0].image})"] if unknown else []
    if beyond := len(marks) - len(within):
        lost.append(f"{beyond} marks lie outside of their images: made in pictures of another size?")
    seen = marked.observations
    kept, tracks = tracks_of(seen, np.ones(len(seen.point), dtype=np.bool_))
    # From the program's own axes, Cartesian ones, to those at the middle of the control.
    own, local = block_frame(block), control.crs == "local"
    there = frame_of(control.crs, "" if local else UNSTATED, control.points.values)
    places = intersected(views_of(block, own), tracks)
    met = np.isfinite(places).all(axis=1)
    if met.sum() < policy.fewest_control:
        raise IllPosedError(
            f"{int(met.sum())} control points of the list are marked in two images and more",
            "; ".join(lost) or "mark at least three that are not in a line, to transform the block to them",
            where=lists[0],
        )
    poses = local_poses(own, block.images.values)
    rotation = matrix_from_angles(poses[:, :3])
    # Control along a line leaves a turn to where images look from.
    looks = -rotation[:, 2].mean(axis=0)
    source, target = places[met], there.to_local(control.points.values[kept[met]])
    robust = robust_similarity(source, target)
    fit = robust[0] if robust else aligned_similarity(source, target, -looks[None], _UP, LEVELLING_M2)
    turned = angles_from_matrix(fit.applied_to_rotations(rotation))
    moved_poses = given_poses(there, np.hstack([turned, fit.applied(poses[:, 3:])]))
    ties, rays = tuple(f"tie {name}" for name in block.points.names), block.observations
    tie_places = given_places(there, fit.applied(own.to_local(block.points.values)))
    moved = replace(
        block,
        frame=control.crs,
        height="" if local else UNSTATED,
        datum="control",
        images=replace(block.images, values=moved_poses),
        points=control.points.with_ties(ties, tie_places),
        observations=seen.plus(rays.image, rays.point + len(control.points.names), rays.values, rays.sigma),
    )
    remarks = [
        f"control of {lists[0].name}, in {control.crs}"
        + ("" if local else ", which does not state the reference of its heights")
        + f"; without accuracies: {ASSUMED_M[0]} and {ASSUMED_M[1]} m assumed"
    ]
    checks = [control.points.names[k] for k in np.flatnonzero(control.points.of_role("check"))]
    remarks += [f"{len(checks)} check points by their names: {some_of(checks)}"] if checks else []
    remarks += lost
    position = np.full_like(given.position, np.nan)
    if np.isfinite(given.position).any():
        remarks.append("positions are of the program's own axes: left out")
    return replace(given, block=moved, position=position, remarks=(*given.remarks, *remarks))


def _with_checks(control: ControlMarks) -> ControlMarks:
    """Take points as check points whose names call them so: such lists have no column for it."""
    points = control.points
    called = np.array([bool(_CHECK.match(name)) for name in points.names], dtype=np.bool_)
    role = np.where(called, ROLES.index("check"), points.role)
    return replace(control, points=replace(points, role=role))

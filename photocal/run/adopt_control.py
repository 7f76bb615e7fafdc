"""A project of another program without control, brought onto a list beside it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import IllPosedError
from photocal.base.policy import policy
from photocal.block.model import ROLES
from photocal.block.network import block_frame, frame_of
from photocal.exchange.foreign_project import ForeignProject
from photocal.geometry.frames import UNSTATED
from photocal.geometry.oriented_images import given_places, given_poses, local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.geometry.similarity import aligned_similarity, robust_similarity
from photocal.measurement.marks import (
    ControlMarks,
    in_map_system,
    named_after,
    read_control_marks,
    with_marks,
)
from photocal.measurement.tie_block import intersected, views_of
from photocal.measurement.tracks import Tracks
from photocal.run.adopt_rays import some_of
from photocal.run.folder_survey import ASSUMED_M

_CHECK = re.compile(r"(?i)check|chk")
# Weight of the direction in which images look, beside places of control that lie nearly in a line.
LEVELLING_M2, _UP = 1.0, np.array([[0.0, 0.0, 1.0]])


def with_control(given: ForeignProject, path: Path, gcp: Path | None) -> ForeignProject:
    """Bring a project without control onto that of a list beside it."""
    folder = path if path.is_dir() else path.parent
    lists = [gcp] if gcp is not None else sorted(folder.rglob("gcp_list.txt"), key=lambda p: len(p.parts))
    if not lists or not given.block.points.of_role("tie").all():
        return given
    block = given.block
    names = block.images.names
    sizes = {name: block.cameras[k].size_px for name, k in zip(names, block.images.camera, strict=True)}
    control = _with_checks(in_map_system(read_control_marks(lists[0], ASSUMED_M, sizes)))
    none = block.observations.rows(np.empty(0, dtype=np.int64))
    marked, unknown = with_marks(
        replace(block, points=control.points, observations=none), named_after(control.marks, names)
    )
    seen = marked.observations
    order = np.argsort(seen.point, kind="stable")
    kept, track = np.unique(seen.point[order], return_inverse=True)
    # From the program's own axes, Cartesian ones, to those at the middle of the control.
    own, local = block_frame(block), control.crs == "local"
    there = frame_of(control.crs, "" if local else UNSTATED, control.points.values)
    tracks = Tracks(track, seen.image[order], seen.values[order], np.ones(len(order)))
    places = intersected(views_of(block, own), tracks)
    met = np.isfinite(places).all(axis=1)
    if met.sum() < policy.fewest_control:
        raise IllPosedError(
            f"{int(met.sum())} control points of the list are marked in two images and more",
            "three that are not in a line bring the block onto them",
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
    remarks += [f"{len(unknown)} marks are in no image of the project"] if unknown else []
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

"""A project of another program without control, brought onto a list beside it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import IllPosedError
from photocal.block.network import block_frame
from photocal.exchange.foreign_project import ForeignProject
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.geometry.similarity import aligned_similarity, robust_similarity
from photocal.measurement.marks import in_map_system, named_after, read_control_marks, with_marks
from photocal.measurement.tie_block import intersected, views_of
from photocal.measurement.tracks import Tracks
from photocal.run.folder_survey import ASSUMED_M

FEWEST_CONTROL = 3
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
    control = in_map_system(read_control_marks(lists[0], ASSUMED_M, sizes))
    none = block.observations.rows(np.empty(0, dtype=np.int64))
    bare = replace(block, points=control.points, observations=none)
    marked, unknown = with_marks(bare, named_after(control.marks, names))
    seen = marked.observations
    order = np.argsort(seen.point, kind="stable")
    kept, track = np.unique(seen.point[order], return_inverse=True)
    frame = block_frame(block)
    tracks = Tracks(track, seen.image[order], seen.values[order], np.ones(len(order)))
    places = frame.to_given(intersected(views_of(block, frame), tracks))
    met = np.isfinite(places).all(axis=1)
    # The map is taken as if it were Cartesian.
    if met.sum() < FEWEST_CONTROL:
        raise IllPosedError(
            f"{int(met.sum())} control points of the list are marked in two images and more",
            "three that are not in a line bring the block onto them",
            where=lists[0],
        )
    # The map is taken as if it were Cartesian; control along a line leaves a turn to where images look from.
    looks = -matrix_from_angles(block.images.values[:, :3])[:, 2].mean(axis=0)
    source, target = places[met], control.points.values[kept[met]]
    robust = robust_similarity(source, target)
    fit = robust[0] if robust else aligned_similarity(source, target, -looks[None], _UP, LEVELLING_M2)
    rotation = fit.applied_to_rotations(matrix_from_angles(block.images.values[:, :3]))
    poses = np.hstack([angles_from_matrix(rotation), fit.applied(block.images.values[:, 3:])])
    ties, rays = tuple(f"tie {name}" for name in block.points.names), block.observations
    moved = replace(
        block,
        frame="local",
        datum="control",
        images=replace(block.images, values=poses),
        points=control.points.with_ties(ties, fit.applied(block.points.values)),
        observations=seen.plus(rays.image, rays.point + len(control.points.names), rays.values, rays.sigma),
    )
    assumed = f"{ASSUMED_M[0]} and {ASSUMED_M[1]} m assumed"
    remarks = [
        f"control of {lists[0].name}, in {control.crs}, taken as Cartesian; without accuracies: {assumed}"
    ]
    remarks += [f"{len(unknown)} marks are in no image of the project"] if unknown else []
    return replace(given, block=moved, remarks=(*given.remarks, *remarks))

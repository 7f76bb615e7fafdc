"""`photocal adopt`: the project of another program adjusted anew, and side by side what both say."""

from __future__ import annotations

import datetime as dt
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import f

from acquire.outputs import write_rows
from drivers.errors import IllPosedError, NotConvergedError
from photocal.block.folder import read_block
from photocal.block.network import assemble, block_frame
from photocal.block.setup import MountingKeys
from photocal.exchange.foreign_project import ForeignProject, estimating_what_it_has, without_weak_points
from photocal.exchange.project_detection import read_foreign_project
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.geometry.similarity import similarity
from photocal.measurement.block_files import write_block
from photocal.measurement.control_files import in_map_system, read_control_marks
from photocal.measurement.marks import with_marks
from photocal.measurement.marks_files import named_after
from photocal.measurement.tie_block import intersected, views_of
from photocal.measurement.tracks import Tracks
from photocal.results.adjusted import adjust_block, adjusted, result_of
from photocal.results.result import Result
from photocal.run.adoption_figures import (
    camera_figures,
    control_figures,
    exterior_figures,
    position_figures,
    sigma_figures,
    ties_of,
)
from photocal.run.block import mounting_text
from photocal.run.folder_survey import ASSUMED_M
from photocal.run.stage import Progress

SCHEMA = "photocal.adoption/1"
FIGURES = "adoption.json"
FEWEST_CONTROL = 3
# How often the sigmas of image coordinates are estimated, where the program states none.
_WEIGHTINGS = 2
FEWEST_FREE = 5.0
# Two variances are different from this significance on.
LEAST = 0.0005


def adopt(
    path: Path, output: Path, day: dt.date, progress: Progress, gcp: Path | None = None
) -> dict[str, Any]:
    """Adjust a project anew; `output` gets its block, the run, `adoption.json` and the certificate.

    raises PhotocalError: for a project that cannot be read or adjusted.
    """
    from photocal.report.analysis_record import analyse_run
    from photocal.report.issue import issue

    with progress("reading the project", None):
        foreign = with_control(read_foreign_project(path), path, gcp)
        block, weak = without_weak_points(estimating_what_it_has(foreign.block, weighted=foreign.weighted))
        foreign = replace(foreign, block=block)
    source, run = output / "block", output / "calibration"
    source.mkdir(parents=True, exist_ok=True)
    with progress("weights of the image coordinates", None):
        foreign = _determined(source, foreign)
        if not foreign.weighted:
            _weighted(source, foreign)
    with progress("adjustment", None):
        result = adjust_block(source, run)
    with progress("analysis", None):
        analyse_run(run, source)
    hidden = json.loads((run / "analysis.json").read_text(encoding="utf-8"))["findings"]
    figures = {
        "schema": SCHEMA,
        "program": foreign.program,
        "project": path.name,
        "images": len(block.images.names),
        "points": len(block.points.names),
        "observations": 2 * len(block.observations.image),
        "remarks": [*foreign.remarks, *([f"{weak} points have one ray only: left out"] if weak else [])],
        "sigma0_squared": result.sigma0_squared,
        "cameras": camera_figures(foreign, result),
        "sigmas": sigma_figures(foreign, result),
        "positions": position_figures(foreign, result),
        "control": control_figures(foreign, result),
        "exterior": exterior_figures(foreign, result),
        "hidden": [finding["sentence"] for finding in hidden],
    }
    text = json.dumps(figures, indent=1, allow_nan=False) + "\n"
    (output / FIGURES).write_text(text, encoding="utf-8")
    with progress("certificate", None):
        issue(run, output / "certificate", day=day, block=source)
    return figures


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
    bare = replace(
        block,
        points=control.points,
        observations=replace(
            block.observations, image=_NO, point=_NO, values=np.empty((0, 2)), sigma=np.empty((0, 2))
        ),
    )
    marked, unknown = with_marks(bare, named_after(control.marks, names))
    seen = marked.observations
    order = np.argsort(seen.point, kind="stable")
    kept, track = np.unique(seen.point[order], return_inverse=True)
    frame = block_frame(block)
    rays = Tracks(track, seen.image[order], seen.values[order], np.ones(len(order)))
    places = frame.to_given(intersected(views_of(block, frame), rays))
    met = np.isfinite(places).all(axis=1)
    # The map is taken as if it were Cartesian.
    fit = similarity(places[met], control.points.values[kept[met]])
    if fit is None:
        raise IllPosedError(
            f"{int(met.sum())} control points of the list are marked in two images and more",
            where=lists[0],
            remedy="three that are not in a line bring the block onto them",
        )
    rotation = fit.applied_to_rotations(matrix_from_angles(block.images.values[:, :3]))
    poses = np.hstack([angles_from_matrix(rotation), fit.applied(block.images.values[:, 3:])])
    points, ties = control.points, block.points
    count = len(points.names)
    moved = replace(
        block,
        frame="local",
        datum="control",
        images=replace(block.images, values=poses),
        points=replace(
            points,
            names=(*points.names, *(f"tie {name}" for name in ties.names)),
            values=np.vstack([points.values, fit.applied(ties.values)]),
            sigma=np.vstack([points.sigma, ties.sigma]),
            role=np.concatenate([points.role, ties.role]),
        ),
        observations=replace(
            seen,
            image=np.concatenate([seen.image, block.observations.image]),
            point=np.concatenate([seen.point, block.observations.point + count]),
            values=np.vstack([seen.values, block.observations.values]),
            sigma=np.vstack([seen.sigma, block.observations.sigma]),
        ),
    )
    remarks = [f"control of {lists[0].name}, in {control.crs}, taken as Cartesian"]
    remarks += [f"{len(unknown)} marks are in no image of the project"] if unknown else []
    return replace(given, block=moved, remarks=(*given.remarks, *remarks))


_NO = np.empty(0, dtype=np.int64)


def _write(folder: Path, foreign: ForeignProject) -> None:
    """Write the block folder; positions may be shifted all alike where control says so."""
    block = foreign.block
    known = np.asarray(np.isfinite(foreign.position).all(axis=1))
    controlled = int(block.points.of_role("control").sum()) >= FEWEST_CONTROL
    held = np.isfinite(block.images.sigma).any()
    if not (known.any() or block.points.of_role("control").any() or held):
        block = replace(block, datum="free")
    write_block(folder, block, {"schema": "photocal.measurement/1", "kind": f"project of {foreign.program}"})
    if known.any():
        rows = [
            [name, *(f"{v:.6f}" for v in (*place, *sigma))]
            for name, place, sigma, has in zip(
                block.images.names, foreign.position, foreign.position_sigma, known.tolist(), strict=True
            )
            if has
        ]
        write_rows(folder / "positions.csv", ("image", "X", "Y", "Z", "sX", "sY", "sZ"), rows)
        keys = MountingKeys(lever_arm_sigma_m=0.0, flight_shift_sigma_m="free" if controlled else 0.0)
        setup = folder / "block.toml"
        setup.write_text(setup.read_text(encoding="utf-8") + "\n" + mounting_text(keys), encoding="utf-8")


def _determined(folder: Path, foreign: ForeignProject) -> ForeignProject:
    """Hold the cameras where the block does not determine what the program's camera has."""
    _write(folder, foreign)
    try:
        _solved(folder)
    except (IllPosedError, NotConvergedError) as refusal:
        if not any(own.estimated.any() for own in foreign.block.cameras):
            raise
        cameras = tuple(
            replace(own, estimated=np.zeros_like(own.estimated), prior_sigma=np.full_like(own.values, np.inf))
            for own in foreign.block.cameras
        )
        remark = f"the cameras are held as the program has them: {refusal.what}"
        block = replace(foreign.block, cameras=cameras)
        foreign = replace(foreign, block=block, remarks=(*foreign.remarks, remark))
        _write(folder, foreign)
    return foreign


def _weighted(folder: Path, foreign: ForeignProject) -> None:
    """Estimate the sigmas of tie points and of marks from their residuals, px, and write them."""
    for _ in range(_WEIGHTINGS):
        result = _solved(folder)
        residuals, tie = result.residuals, ties_of(result)
        sigma = foreign.block.observations.sigma.copy()
        free = [float(residuals.redundancy[mine].sum()) for mine in (tie, ~tie)]
        squares = [float((residuals.residual[mine] ** 2).sum()) for mine in (tie, ~tie)]
        sigma[:] = np.sqrt(sum(squares) / sum(free))
        # Marks get a sigma of their own where theirs is another for certain.
        if min(free) > FEWEST_FREE:
            ratio = squares[1] / free[1] / (squares[0] / free[0])
            if not LEAST < float(f.cdf(ratio, free[1], free[0])) < 1 - LEAST:
                for mine, square, count in zip((tie, ~tie), squares, free, strict=True):
                    sigma[mine] = np.sqrt(square / count)
        observations = replace(foreign.block.observations, sigma=sigma)
        _write(folder, replace(foreign, block=replace(foreign.block, observations=observations)))


def _solved(folder: Path) -> Result:
    block = read_block(folder)
    assembly = assemble(block)
    return result_of(block, *adjusted(assembly))

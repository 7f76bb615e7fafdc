"""`photocal adopt`: the project of another program, checked for gross errors and adjusted anew."""

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import f

from photocal.adjustment.datum import with_datum
from photocal.adjustment.factored import factored
from photocal.adjustment.groups import member_tests
from photocal.adjustment.mounting import Positions
from photocal.adjustment.network import NO_RELATIONS, covariance_matrices
from photocal.adjustment.normal import prepare
from photocal.adjustment.snooping import ray_fit, robust_state, subset
from photocal.adjustment.state import start_state
from photocal.adjustment.variance_components import estimate_components
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.files import write_json, write_rows
from photocal.base.progress import Progress
from photocal.block.model import ROLES, Block, ObjectPoints
from photocal.block.mounting import make_mounting
from photocal.block.network import assemble, behind_cameras, block_frame
from photocal.block.setup import MountingKeys
from photocal.exchange.foreign_project import (
    ForeignProject,
    free_nonzero_parameters,
    without_weak_points,
)
from photocal.exchange.formats import read_foreign_project
from photocal.geometry.camera import Camera, among
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.geometry.similarity import aligned_similarity, robust_similarity
from photocal.measurement.block_files import SCHEMA as MEASURED
from photocal.measurement.block_files import MeasuredBlock
from photocal.measurement.marks import in_map_system, named_after, read_control_marks, with_marks
from photocal.measurement.start_block import without_images
from photocal.measurement.tie_block import TIE, intersected, views_of
from photocal.measurement.tracks import Tracks
from photocal.results.adjusted import adjust_block, adjust_network, adjusted, result_of
from photocal.results.result import Result
from photocal.run.adoption_figures import (
    camera_figures,
    control_figures,
    exterior_figures,
    head_figures,
    position_figures,
    sigma_figures,
)
from photocal.run.folder_survey import ASSUMED_M

SCHEMA = "photocal.adoption/1"
FIGURES = "adoption.json"
GROSS_RAYS = "rays-left-out.csv"
# What a camera is known to while gross errors are sought, as a share of c.
ROUGHLY = 0.01
# Control so many times farther than usual from where its rays meet would bend the block; so much is enough to
# tell what is usual.
FAR, ENOUGH_CONTROL = 30.0, 5
# Less of an observation than this is not taken to be checked by others.
LEAST_CHECKED = 0.05
FEWEST_CONTROL = 3
# Weight of the direction in which images look, beside places of control that lie nearly in a line.
LEVELLING_M2, _UP = 1.0, np.array([[0.0, 0.0, 1.0]])
# Three rays give a pose that nothing checks; images that are named in one remark.
FEWEST_RAYS, MOST_NAMED = 4, 6
# How often the sigmas of image coordinates are estimated, where the program states none.
_WEIGHTINGS = 2
FEWEST_FREE = 5.0
# Sigmas are found to one per cent.
_SETTLED = 0.02
# Two variances are different from this significance on.
LEAST = 0.0005


def adopt(
    path: Path, output: Path, day: dt.date, progress: Progress, gcp: Path | None = None
) -> dict[str, Any]:
    """Adjust a project anew; `output` gets its block, the run, `adoption.json` and the certificate.

    raises PhotocalError: for a project that cannot be read or adjusted.
    """
    from photocal.analysis.analyse_run import analyse_run
    from photocal.findings.texts import catalogue, finding_text, plain
    from photocal.report.issue import issue

    with progress("reading the project", None):
        foreign = with_control(read_foreign_project(path), path, gcp)
        block = free_nonzero_parameters(foreign.block, weighted=foreign.weighted)
        foreign = _without_what_hangs_loose(replace(foreign, block=block))
    source, run = output / "block", output / "calibration"
    output.mkdir(parents=True, exist_ok=True)
    with progress("gross errors of the rays", None):
        foreign = _without_what_hangs_loose(_without_gross_rays(foreign, output))
    with progress("weights of the image coordinates", None):
        foreign = _determined(foreign)
        if not foreign.weighted:
            foreign = _weighted(foreign)
        block = _with_positions(foreign)
        MeasuredBlock(block, {"schema": MEASURED, "kind": f"project of {foreign.program}"}).write(source)
    with progress("adjustment", None):
        result = adjust_block(source, run)
    with progress("analysis", None):
        hidden = analyse_run(run, source).findings
    with progress("sigmas of control and positions", None):
        sigmas = sigma_figures(foreign, result, _as_residuals_agree(block))
    figures = {
        "schema": SCHEMA,
        "program": foreign.program,
        "project": path.name,
        "images": len(foreign.block.images.names),
        "points": len(foreign.block.points.names),
        "observations": 2 * len(foreign.block.observations.image),
        "remarks": list(foreign.remarks),
        "sigma0_squared": result.sigma0_squared,
        "cameras": camera_figures(foreign, result),
        "heads": head_figures(foreign, result),
        "sigmas": sigmas,
        "positions": position_figures(foreign, result, sigmas),
        "control": control_figures(foreign, result),
        "exterior": exterior_figures(foreign, result),
        "hidden": [finding_text(finding, catalogue("en"), plain) for finding in hidden],
    }
    write_json(output / FIGURES, figures)
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


def _without_gross_rays(foreign: ForeignProject, output: Path) -> ForeignProject:
    """Leave out rays that do not fit the others, whatever control and positions say; `output` lists them."""
    block = foreign.block
    seen, tie = block.observations, block.points.of_role("tie")
    rays = np.flatnonzero(_crossed(block))
    assembly = assemble(_by_rays_alone(block))
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
    limit = np.sqrt(np.log(2 * len(fit)) / np.log(2) / max(1 - taken, LEAST_CHECKED))
    for kind in (tie[seen.point[rays]], ~tie[seen.point[rays]]):
        gross[rays[kind]] = fit[kind] > limit * np.median(fit[kind])
    if not gross.any():
        return foreign
    names, points = block.images.names, block.points.names
    listed = [(names[seen.image[k]], points[seen.point[k]], *seen.values[k]) for k in np.flatnonzero(gross)]
    write_rows(output / GROSS_RAYS, ("image", "point", "x", "y"), ([*map(str, row)] for row in listed))
    remarks = [f"{len(listed)} of {len(gross)} rays do not fit the others: left out ({GROSS_RAYS})"]
    marks = [
        f"{points[seen.point[k]]} in {names[seen.image[k]]}" for k in np.flatnonzero(gross & ~tie[seen.point])
    ]
    remarks += [f"{len(marks)} marks of surveyed points among them: {_some(marks)}"] if marks else []
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
    remarks = [f"control that lies far from where its rays meet is taken as check points: {_some(told)}"]
    remarks += [
        f"coordinates of {label[a]} and {label[b]} are exchanged"
        for a, b in combinations(far, 2)
        if max(np.linalg.norm(seen[a] - target[b]), np.linalg.norm(seen[b] - target[a])) < limit
    ]
    role = block.points.role.copy()
    role[names[far]] = ROLES.index("check")
    points_now = replace(block.points, role=role)
    return replace(foreign, block=replace(block, points=points_now), remarks=(*foreign.remarks, *remarks))


def _by_rays_alone(block: Block) -> Block:
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
        observations=block.observations.rows(np.flatnonzero(_crossed(block))),
        relations=NO_RELATIONS,
        heads=(),
    )


def _nearly_known(camera: Camera) -> Camera:
    """The camera with c, x0 and y0 within a hundredth of c: a level block alone does not determine them."""
    sigma = np.where(among("c", "x0", "y0"), ROUGHLY * camera.value("c"), camera.prior_sigma)
    return replace(camera, prior_sigma=np.minimum(sigma, camera.prior_sigma))


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST_NAMED]) + (" ..." if len(names) > MOST_NAMED else "")


def _with_positions(foreign: ForeignProject) -> Block:
    """The block that is adjusted; positions may be shifted all alike where control says so."""
    block = foreign.block
    known = np.flatnonzero(np.isfinite(foreign.position).all(axis=1))
    controlled = int(block.points.of_role("control").sum()) >= FEWEST_CONTROL
    held = np.isfinite(block.images.sigma).any()
    if not (len(known) or block.points.of_role("control").any() or held):
        return replace(block, datum="free")
    if not len(known):
        return block
    place, none = foreign.position[known], np.zeros(len(known))
    covariance = covariance_matrices(foreign.position_sigma[known], np.zeros((len(known), 3)))
    strip = np.zeros(len(known), dtype=np.int64)
    positions = Positions(known, place, covariance, np.zeros_like(place), strip, none, place[:, 2])
    keys = MountingKeys(flight_shift_sigma_m="free" if controlled else 0.0)
    return replace(block, positions=positions, mounting=make_mounting(keys, 1))


def _without_what_hangs_loose(foreign: ForeignProject) -> ForeignProject:
    """Leave out points with one ray, and images whose pose their rays do not check."""
    lost, names, weak = 0, list[str](), foreign.block
    while True:
        block, fewer = without_weak_points(weak)
        lost += fewer
        few = np.bincount(block.observations.image, minlength=len(block.images.names)) < FEWEST_RAYS
        if not few.any() or few.all():
            break
        names += [block.images.names[k] for k in np.flatnonzero(few)]
        weak, kept = without_images(block, few), ~few
        foreign = replace(
            foreign,
            position=foreign.position[kept],
            position_sigma=foreign.position_sigma[kept],
            pose_sigma=foreign.pose_sigma[kept],
        )
    remarks = [f"{lost} points have one ray only: left out"] if lost else []
    if names:
        remarks += [f"{len(names)} images have fewer than {FEWEST_RAYS} rays: left out ({_some(names)})"]
    return replace(foreign, block=block, remarks=(*foreign.remarks, *remarks))


def _determined(foreign: ForeignProject) -> ForeignProject:
    """Hold the cameras where the block does not determine what the program's camera has."""
    try:
        _solved(foreign)
    except (IllPosedError, NotConvergedError) as refusal:
        if not any(camera.estimated.any() for camera in foreign.block.cameras):
            raise
        cameras = tuple(
            replace(
                camera,
                estimated=np.zeros_like(camera.estimated),
                prior_sigma=np.full_like(camera.values, np.inf),
            )
            for camera in foreign.block.cameras
        )
        remark = f"the cameras are held as the program has them: {refusal.what}"
        block = replace(foreign.block, cameras=cameras)
        foreign = replace(foreign, block=block, remarks=(*foreign.remarks, remark))
    return foreign


def _weighted(foreign: ForeignProject) -> ForeignProject:
    """Estimate the sigmas of tie points and of marks from their residuals, px."""
    block, tie = foreign.block, foreign.block.points.of_role("tie")[foreign.block.observations.point]
    for _ in range(_WEIGHTINGS):
        try:
            # Control that is exchanged says nothing of the marks.
            residuals = adjust_network(_by_rays_alone(block)).residuals
        except (IllPosedError, NotConvergedError):
            residuals = _solved(replace(foreign, block=block)).residuals
        kinds = tie if len(residuals) == len(tie) else tie[_crossed(block)]
        free = [float(np.nansum(residuals.redundancy[rays])) for rays in (kinds, ~kinds)]
        squares = [float(np.nansum(residuals.residual[rays] ** 2)) for rays in (kinds, ~kinds)]
        sigma = np.full_like(block.observations.sigma, np.sqrt(sum(squares) / sum(free)))
        # Marks get a sigma of their own where theirs is another for certain.
        if min(free) > FEWEST_FREE:
            ratio = squares[1] / free[1] / (squares[0] / free[0])
            if not LEAST < float(f.cdf(ratio, free[1], free[0])) < 1 - LEAST:
                for rays, square, count in zip((tie, ~tie), squares, free, strict=True):
                    sigma[rays] = np.sqrt(square / count)
        block = replace(block, observations=replace(block.observations, sigma=sigma))
    return replace(foreign, block=block)


def _crossed(block: Block) -> Flags:
    """Observations of points that two rays and more see, shape (n,)."""
    seen = block.observations.point
    return np.asarray(np.bincount(seen, minlength=len(block.points.names))[seen] > 1)


def _as_residuals_agree(block: Block) -> dict[str, Floats]:
    """Variances of control points and of positions along the axes, m^2, (3,), that the residuals show."""
    network = assemble(block).network
    try:
        # Frames may be as stiff as they are stated to be, or stiffer.
        estimated = estimate_components(network, hold=("rig",), settled=_SETTLED)
        members = member_tests(factored(estimated.network, estimated.solution.state), estimated.solution)
    except (IllPosedError, NotConvergedError):
        return {}
    points, positions = estimated.network.points, estimated.network.positions
    given = dict(zip(positions.image.tolist(), positions.covariance, strict=True))
    variances: dict[str, list[Floats]] = {}
    for member in members:
        own = (
            given[member.index] if member.kind == "position" else np.linalg.pinv(points.weight[member.index])
        )
        # What the others say departs from an observation by its error and by theirs.
        variances.setdefault(member.kind, []).append(
            np.where(
                np.isfinite(np.diag(member.covariance)),
                member.error**2 - np.diag(member.covariance - own),
                np.nan,
            )
        )
    return {kind: np.nanmean(rows, axis=0) for kind, rows in variances.items() if np.isfinite(rows).any()}


def _solved(foreign: ForeignProject) -> Result:
    block = _with_positions(foreign)
    return result_of(block, *adjusted(assemble(block)))

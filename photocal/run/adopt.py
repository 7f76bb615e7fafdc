"""`photocal adopt`: the project of another program adjusted anew, and side by side what both say."""

import datetime as dt
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import f

from acquire.outputs import write_json, write_rows
from drivers.arrays import Flags, Floats
from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.variance_components import estimate_components
from photocal.block.folder import read_block
from photocal.block.network import assemble, block_frame
from photocal.block.setup import MountingKeys
from photocal.exchange.project_detection import read_foreign_project
from photocal.exchange.reconstruction import ForeignProject, estimating_what_it_has, without_weak_points
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.geometry.similarity import similarity
from photocal.measurement.block_files import SCHEMA as MEASURED
from photocal.measurement.block_files import write_block
from photocal.measurement.marks import in_map_system, named_after, read_control_marks, with_marks
from photocal.measurement.start_block import without_images
from photocal.measurement.tie_block import intersected, views_of
from photocal.measurement.tracks import Tracks
from photocal.results.adjusted import adjust_block, adjusted, result_of
from photocal.results.result import Result
from photocal.run.block import mounting_text
from photocal.run.folder_survey import ASSUMED_M
from photocal.tasks.progress import Progress

# A common shift of the positions is told as one of the datum from here on, in its standard deviations.
SHIFTED = 3.0
SCHEMA = "photocal.adoption/1"
FIGURES = "adoption.json"
FEWEST_CONTROL = 3
# Three rays give a pose that nothing checks; images that are named in one remark.
FEWEST_RAYS, MOST_NAMED = 4, 6
# How often the sigmas of image coordinates are estimated, where the program states none.
_WEIGHTINGS = 2
FEWEST_FREE = 5.0
# Sigmas are found to one per cent.
_SETTLED = 0.02
# Two variances are different from this significance on.
LEAST = 0.0005


def camera_figures(foreign: ForeignProject, result: Result) -> dict[str, Any]:
    """Their parameters of each camera and ours, with sigmas and the difference in ours."""
    figures: dict[str, Any] = {}
    stated = {camera.id: camera for camera in (*foreign.block.cameras, *foreign.cameras)}
    for camera in stated.values():
        ours, promised = result.cameras[camera.id], foreign.camera_sigma.get(camera.id, {})
        figures[camera.id] = {"unit": camera.unit, "model": camera.model, "parameters": {}}
        for name in PARAMETERS:
            if name not in ours.free and not camera.value(name):
                continue
            sigma = ours.sigma_of(name) if name in ours.free else None
            figures[camera.id]["parameters"][name] = {
                "theirs": camera.value(name),
                "their_sigma": promised.get(name),
                "ours": ours.value(name),
                "sigma": sigma,
                "difference_in_sigmas": (ours.value(name) - camera.value(name)) / sigma if sigma else None,
            }
    return figures


def sigma_figures(
    foreign: ForeignProject, result: Result, factors: Mapping[str, float]
) -> list[dict[str, Any]]:
    """What each group of observations was promised to be, and what its residuals show."""
    tie, seen = ties_of(result), result.residuals
    rows: list[dict[str, Any]] = []
    for name, rays in (("image coordinates of tie points", tie), ("marks of surveyed points", ~tie)):
        free = float(seen.redundancy[rays].sum())
        if free > 1:
            stated = float(np.sqrt(np.mean(foreign.block.observations.sigma[rays] ** 2)))
            sigma = float(np.sqrt((seen.residual[rays] ** 2).sum() / free))
            rows.append(
                {
                    "group": name,
                    "unit": "px",
                    "n": int(rays.sum()),
                    "stated": stated if foreign.weighted else None,
                    "found": sigma,
                }
            )
    points = foreign.block.points
    control = np.flatnonzero(points.of_role("control"))
    if len(control):
        place = dict(zip(result.points.names, result.points.values, strict=True))
        error = np.array([place[points.names[k]] - points.values[k] for k in control])
        for name, axes in (("control in plane", slice(0, 2)), ("control in height", slice(2, 3))):
            rows.append(_group(name, axes, error, points.sigma[control], factors.get("control")))
    known = np.isfinite(foreign.position).all(axis=1)
    if known.any():
        error = (result.images.values[:, 3:] - foreign.position)[known]
        error -= np.mean(error, axis=0)
        for name, axes in (("positions in plane", slice(0, 2)), ("positions in height", slice(2, 3))):
            rows.append(_group(name, axes, error, foreign.position_sigma[known], factors.get("position")))
    return rows


def ties_of(result: Result) -> Flags:
    """Which observations are of tie points, shape (n,)."""
    seen = result.residuals
    roles = dict(zip(result.points.names, result.points.role, strict=True))
    tie = np.array([roles.get(name, "tie") == "tie" for name in seen.point_names])
    return np.asarray(tie[seen.point])


def _group(name: str, axes: slice, error: Floats, stated: Floats, factor: float | None) -> dict[str, Any]:
    """Some axes of a group; the errors share among them what was found for all together."""
    usable = np.isfinite(stated) & np.isfinite(error)
    used = usable[:, axes]
    row = {"group": name, "unit": "m", "n": len(error), "stated": None, "found": None}
    if not used.any():
        return row
    typical = float(np.sqrt(np.mean(stated[:, axes][used] ** 2)))
    if factor is None:
        return {**row, "stated": typical}
    # Residuals are smaller than errors by what the adjustment takes from their observations.
    whole = np.sqrt(np.mean((error[usable] / stated[usable]) ** 2))
    share = np.sqrt(np.mean((error[:, axes][used] / stated[:, axes][used]) ** 2)) / whole
    return {**row, "stated": typical, "found": float(typical * factor * share)}


def position_figures(foreign: ForeignProject, result: Result) -> dict[str, Any] | None:
    """The shift that all positions have in common, adjusted minus given."""
    mounting = result.mounting
    known = np.isfinite(foreign.position).all(axis=1)
    if mounting is None or not known.any():
        return None
    # The shift belongs to the observed positions: observed = true + shift.
    shift = {axis: -mounting[f"shift_{axis}"].value for axis in "xyz"}
    sigma = {axis: mounting[f"shift_{axis}"].sigma for axis in "xyz"}
    theirs = np.mean((foreign.block.images.values[:, 3:] - foreign.position)[known], axis=0)
    return {
        "images": int(known.sum()),
        "estimated": bool(mounting["shift_x"].estimated),
        "common_shift_m": shift,
        "sigma_m": sigma,
        "theirs_m": dict(zip("xyz", theirs.tolist(), strict=True)),
    }


def control_figures(foreign: ForeignProject, result: Result) -> list[dict[str, Any]]:
    """Adjusted minus surveyed at control and check points, theirs and ours."""
    survey = dict(zip(foreign.block.points.names, foreign.block.points.values, strict=True))
    rows = []
    for k, (name, role) in enumerate(zip(result.points.names, result.points.role, strict=True)):
        if role == "tie":
            continue
        theirs = foreign.adjusted.get(name)
        rows.append(
            {
                "point": name,
                "role": role,
                "rays": int(result.points.rays[k]),
                "theirs_m": None if theirs is None else (theirs - survey[name]).tolist(),
                "ours_m": (result.points.values[k] - survey[name]).tolist(),
            }
        )
    return rows


def exterior_figures(foreign: ForeignProject, result: Result) -> dict[str, Any] | None:
    """How far our orientations lie from theirs, and the sigmas that both promise (medians)."""
    theirs, values = foreign.block.images.values, result.images.values
    if np.isnan(theirs).any():
        return None
    away = values[:, 3:] - theirs[:, 3:]
    turn = matrix_from_angles(values[:, :3]) @ np.swapaxes(matrix_from_angles(theirs[:, :3]), 1, 2)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    covariance = result.images.covariance
    ours = None if covariance is None else np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 3:])
    promised = foreign.pose_sigma[np.isfinite(foreign.pose_sigma).all(axis=1)]
    return {
        "position_rms_m": np.sqrt(np.mean(away**2, axis=0)).tolist(),
        "rotation_rms_deg": float(np.degrees(np.sqrt(np.mean(angle**2)))),
        "their_position_sigma_m": np.median(promised[:, 3:], axis=0).tolist() if len(promised) else None,
        "our_position_sigma_m": None if ours is None else np.median(ours, axis=0).tolist(),
    }


def adoption_text(figures: dict[str, Any]) -> str:
    """Write it for people, side by side."""
    size = f"{figures['images']} images, {figures['points']} points, {figures['observations']} observations"
    lines = [
        f"{figures['program']}: {size}, sigma0^2 {figures['sigma0_squared'] or 0:.3f}",
        *(f"note: {remark}" for remark in figures["remarks"]),
    ]
    for name, camera in figures["cameras"].items():
        lines.append(
            f"camera {name} ({camera['unit']})          theirs            ours +- sigma     difference"
        )
        for key, parameter in camera["parameters"].items():
            sigma = parameter["sigma"]
            theirs = f"{parameter['theirs']:.8g}" + (
                f" +- {parameter['their_sigma']:.2g}" if parameter["their_sigma"] else ""
            )
            ours = f"{parameter['ours']:.8g}" + (f" +- {sigma:.2g}" if sigma else " held")
            away = "" if sigma is None else f"{parameter['difference_in_sigmas']:+.2f} sd"
            lines.append(f"  {key:<4}{theirs:>28}{ours:>28}{away:>14}")
    for row in figures["sigmas"]:
        stated = "not stated" if row["stated"] is None else f"stated {row['stated']:.3g} {row['unit']}"
        kept = (
            "" if not row["stated"] or row["found"] is None else f": {row['found'] / row['stated']:.2f} times"
        )
        shown = "-" if row["found"] is None else f"{row['found']:.3g} {row['unit']}"
        lines.append(f"{row['group']} ({row['n']}): {stated}, found {shown}{kept}")
    shift = figures["positions"]
    if shift is not None and shift["estimated"]:
        text = ", ".join(f"{shift['common_shift_m'][a]:+.3f} +- {shift['sigma_m'][a]:.3f}" for a in "xyz")
        large = any(abs(shift["common_shift_m"][a]) > SHIFTED * shift["sigma_m"][a] for a in "xyz")
        verdict = "positions and control are not of one datum" if large else "not significant"
        lines.append(f"all positions, adjusted minus given: {text} m (X, Y, Z): {verdict}")
    for row in figures["control"]:
        cells = [
            "-" if row[key] is None else ", ".join(f"{1e3 * v:+.0f}" for v in row[key])
            for key in ("theirs_m", "ours_m")
        ]
        lines.append(
            f"{row['role']} {row['point']} ({row['rays']} rays): theirs {cells[0]}; ours {cells[1]} mm"
        )
    lines += [f"hidden: {sentence}" for sentence in figures["hidden"]]
    return "\n".join(lines)


def adopt(
    path: Path, output: Path, day: dt.date, progress: Progress, gcp: Path | None = None
) -> dict[str, Any]:
    """Adjust a project anew; `output` gets its block, the run, `adoption.json` and the certificate.

    raises PhotocalError: for a project that cannot be read or adjusted.
    """
    from photocal.findings.texts import catalogue, finding_text, plain
    from photocal.report.analysis_record import analyse_run
    from photocal.report.issue import issue

    with progress("reading the project", None):
        foreign = with_control(read_foreign_project(path), path, gcp)
        block = estimating_what_it_has(foreign.block, weighted=foreign.weighted)
        foreign = _without_what_hangs_loose(replace(foreign, block=block))
    source, run = output / "block", output / "calibration"
    source.mkdir(parents=True, exist_ok=True)
    with progress("weights of the image coordinates", None):
        foreign = _determined(source, foreign)
        if not foreign.weighted:
            _weighted(source, foreign)
    with progress("adjustment", None):
        result = adjust_block(source, run)
    with progress("analysis", None):
        hidden = analyse_run(run, source).findings
    with progress("sigmas of control and positions", None):
        weighed, factors = _as_residuals_agree(source)
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
        "sigmas": sigma_figures(foreign, weighed or result, factors),
        "positions": position_figures(foreign, result),
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
    fit = similarity(places[met], control.points.values[kept[met]])
    if fit is None:
        raise IllPosedError(
            f"{int(met.sum())} control points of the list are marked in two images and more",
            "three that are not in a line bring the block onto them",
            where=lists[0],
        )
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
    remarks = [f"control of {lists[0].name}, in {control.crs}, taken as Cartesian"]
    remarks += [f"{len(unknown)} marks are in no image of the project"] if unknown else []
    return replace(given, block=moved, remarks=(*given.remarks, *remarks))


def _write(folder: Path, foreign: ForeignProject) -> None:
    """Write the block folder; positions may be shifted all alike where control says so."""
    block = foreign.block
    known = np.asarray(np.isfinite(foreign.position).all(axis=1))
    controlled = int(block.points.of_role("control").sum()) >= FEWEST_CONTROL
    held = np.isfinite(block.images.sigma).any()
    if not (known.any() or block.points.of_role("control").any() or held):
        block = replace(block, datum="free")
    write_block(folder, block, {"schema": MEASURED, "kind": f"project of {foreign.program}"})
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
        listed = ", ".join(names[:MOST_NAMED]) + (" ..." if len(names) > MOST_NAMED else "")
        remarks += [f"{len(names)} images have fewer than {FEWEST_RAYS} rays: left out ({listed})"]
    return replace(foreign, block=block, remarks=(*foreign.remarks, *remarks))


def _determined(folder: Path, foreign: ForeignProject) -> ForeignProject:
    """Hold the cameras where the block does not determine what the program's camera has."""
    _write(folder, foreign)
    try:
        _solved(folder)
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
        _write(folder, foreign)
    return foreign


def _weighted(folder: Path, foreign: ForeignProject) -> None:
    """Estimate the sigmas of tie points and of marks from their residuals, px, and write them."""
    for _ in range(_WEIGHTINGS):
        result = _solved(folder)
        residuals, tie = result.residuals, ties_of(result)
        sigma = foreign.block.observations.sigma.copy()
        free = [float(residuals.redundancy[rays].sum()) for rays in (tie, ~tie)]
        squares = [float((residuals.residual[rays] ** 2).sum()) for rays in (tie, ~tie)]
        sigma[:] = np.sqrt(sum(squares) / sum(free))
        # Marks get a sigma of their own where theirs is another for certain.
        if min(free) > FEWEST_FREE:
            ratio = squares[1] / free[1] / (squares[0] / free[0])
            if not LEAST < float(f.cdf(ratio, free[1], free[0])) < 1 - LEAST:
                for rays, square, count in zip((tie, ~tie), squares, free, strict=True):
                    sigma[rays] = np.sqrt(square / count)
        observations = replace(foreign.block.observations, sigma=sigma)
        _write(folder, replace(foreign, block=replace(foreign.block, observations=observations)))


def _as_residuals_agree(folder: Path) -> tuple[Result | None, dict[str, float]]:
    """Adjust with the sigmas that the residuals of each group show, and by what they were multiplied."""
    block = read_block(folder)
    assembly = assemble(block)
    try:
        estimated = estimate_components(assembly.network, settled=_SETTLED)
    except (IllPosedError, NotConvergedError):
        return None, {}
    factors = {component.name: component.factor for component in estimated.components if component.estimated}
    return result_of(block, replace(assembly, network=estimated.network), estimated.solution), factors


def _solved(folder: Path) -> Result:
    block = read_block(folder)
    return result_of(block, *adjusted(assemble(block)))

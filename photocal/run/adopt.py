"""`photocal adopt`: the project of another program adjusted anew, and side by side what both say."""

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import f

from acquire.outputs import write_json, write_rows
from drivers.arrays import Flags, Floats, Integers
from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.datum import with_datum
from photocal.adjustment.factored import factored
from photocal.adjustment.groups import member_tests
from photocal.adjustment.network import NO_RELATIONS
from photocal.adjustment.normal import prepare
from photocal.adjustment.rig import OF_HEAD
from photocal.adjustment.snooping import ray_fit, robust_state, subset
from photocal.adjustment.state import start_state
from photocal.adjustment.variance_components import estimate_components
from photocal.block.folder import read_block
from photocal.block.model import ROLES, Block, ObjectPoints
from photocal.block.network import assemble, behind_cameras, block_frame
from photocal.block.setup import MountingKeys
from photocal.exchange.project_detection import read_foreign_project
from photocal.exchange.reconstruction import ForeignProject, estimating_what_it_has, without_weak_points
from photocal.geometry.camera import PARAMETERS, Camera, among
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.geometry.similarity import aligned_similarity, robust_similarity
from photocal.measurement.block_files import SCHEMA as MEASURED
from photocal.measurement.block_files import write_block
from photocal.measurement.marks import in_map_system, named_after, read_control_marks, with_marks
from photocal.measurement.start_block import without_images
from photocal.measurement.tie_block import TIE, intersected, views_of
from photocal.measurement.tracks import Tracks
from photocal.results.adjusted import adjust_block, adjust_network, adjusted, result_of
from photocal.results.result import Result
from photocal.run.block import mounting_text
from photocal.run.folder_survey import ASSUMED_M
from photocal.tasks.progress import Progress

# A common shift of the positions is told as one of the datum from here on, in its standard deviations.
SHIFTED = 3.0
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


def head_figures(foreign: ForeignProject, result: Result) -> list[dict[str, Any]]:
    """Relative orientation of each head (deg, m): ours with sigmas, and its difference from theirs."""
    given = {
        head.camera: dict(zip(OF_HEAD, head.values.tolist(), strict=True)) for head in foreign.block.heads
    }
    return [
        {
            "camera": head.camera,
            "of": head.of,
            "exposures": head.exposures,
            "rotation_deg": head.rotation_deg,
            "values": {
                key: {
                    "ours": value.value,
                    "sigma": value.sigma,
                    # Turns count from the rotation that they have.
                    "difference": value.value - (given[head.camera][key] if key in "xyz" else 0.0),
                }
                for key, value in head.values.items()
                if value.estimated
            },
        }
        for head in result.heads
    ]


def sigma_figures(
    foreign: ForeignProject, result: Result, found: Mapping[str, Floats]
) -> list[dict[str, Any]]:
    """What each group of observations was promised to be, and what its residuals show."""
    tie, seen = ties_of(foreign, result), result.residuals
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
    points, known = foreign.block.points, np.isfinite(foreign.position).all(axis=1)
    stated_of = {
        "control": points.sigma[points.of_role("control")],
        "position": foreign.position_sigma[known],
    }
    for kind, sigmas in stated_of.items():
        for axes, where in ((slice(0, 2), "in plane"), (slice(2, 3), "in height")) if len(sigmas) else ():
            # A held coordinate promises nothing that could be kept.
            promised = sigmas[:, axes][np.isfinite(sigmas[:, axes])]
            variance = np.mean(found[kind][axes]) if kind in found else np.nan
            rows.append(
                {
                    "group": f"{kind if kind == 'control' else 'positions'} {where}",
                    "unit": "m",
                    "n": len(sigmas),
                    "stated": float(np.sqrt(np.mean(promised**2))) if len(promised) else None,
                    "found": float(np.sqrt(variance)) if variance > 0 else None,
                }
            )
    return rows


def ties_of(foreign: ForeignProject, result: Result) -> Flags:
    """Which observations are of tie points, shape (n,)."""
    points, seen = foreign.block.points, result.residuals
    role = dict(zip(points.names, points.of_role("tie").tolist(), strict=True))
    return np.array([role[name] for name in seen.point_names])[seen.point]


def position_figures(
    foreign: ForeignProject, result: Result, sigmas: Sequence[dict[str, Any]]
) -> dict[str, Any] | None:
    """The shift that all positions have in common, adjusted minus given; its sigma as positions are found."""
    worse = max(
        [1.0]
        + [
            row["found"] / row["stated"]
            for row in sigmas
            if row["group"].startswith("positions") and row["found"] and row["stated"]
        ]
    )
    mounting = result.mounting
    known = np.isfinite(foreign.position).all(axis=1)
    if mounting is None or not known.any():
        return None
    # The shift belongs to the observed positions: observed = true + shift.
    shift = {axis: -mounting[f"shift_{axis}"].value for axis in "xyz"}
    sigma = {axis: worse * mounting[f"shift_{axis}"].sigma for axis in "xyz"}
    theirs = np.mean((foreign.block.images.values[:, 3:] - foreign.position)[known], axis=0)
    return {
        "images": int(known.sum()),
        "estimated": bool(mounting["shift_x"].estimated),
        "common_shift_m": shift,
        "sigma_m": sigma,
        "theirs_m": dict(zip("xyz", theirs.tolist(), strict=True)),
    }


def control_figures(foreign: ForeignProject, result: Result) -> list[dict[str, Any]]:
    """Adjusted minus surveyed at control and check points, theirs and ours, and what the adjustment promises.

    `sigma_m`: of what is adjusted, at check points with the survey where that is stated.
    """
    given = foreign.block.points
    survey = dict(zip(given.names, given.values, strict=True))
    sigma = dict(zip(given.names, np.where(np.isfinite(given.sigma), given.sigma, 0.0), strict=True))
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
                "sigma_m": np.hypot(result.points.sigma[k], sigma[name] * (role == "check")).tolist(),
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
    for head in figures["heads"]:
        turns, places = (
            ", ".join(
                f"{factor * value['difference']:+.2f} +- {factor * value['sigma']:.2f}"
                for key, value in head["values"].items()
                if key.startswith("turn") == turning
            )
            for turning, factor in ((True, 3600.0), (False, 1000.0))
        )
        lines.append(
            f"head {head['camera']} on {head['of']} ({head['exposures']} exposures), ours minus theirs: "
            f"turned by {turns} arcsec, centre {places} mm (x, y, z)"
        )
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
        promised = ", ".join(f"{1e3 * v:.0f}" for v in row["sigma_m"])
        lines.append(
            f"{row['role']} {row['point']} ({row['rays']} rays): theirs {cells[0]}; ours {cells[1]} mm "
            f"(+- {promised})"
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
    with progress("gross errors of the rays", None):
        foreign = _without_what_hangs_loose(_without_gross_rays(foreign, output))
    with progress("weights of the image coordinates", None):
        foreign = _determined(source, foreign)
        if not foreign.weighted:
            _weighted(source, foreign)
    with progress("adjustment", None):
        result = adjust_block(source, run)
    with progress("analysis", None):
        hidden = analyse_run(run, source).findings
    with progress("sigmas of control and positions", None):
        sigmas = sigma_figures(foreign, result, _as_residuals_agree(source))
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
        remarks += [f"{len(names)} images have fewer than {FEWEST_RAYS} rays: left out ({_some(names)})"]
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
    block, tie = foreign.block, foreign.block.points.of_role("tie")[foreign.block.observations.point]
    for _ in range(_WEIGHTINGS):
        try:
            # Control that is exchanged says nothing of the marks.
            residuals = adjust_network(_by_rays_alone(block)).residuals
        except (IllPosedError, NotConvergedError):
            residuals = _solved(folder).residuals
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
        _write(folder, replace(foreign, block=block))


def _crossed(block: Block) -> Flags:
    """Observations of points that two rays and more see, shape (n,)."""
    seen = block.observations.point
    return np.asarray(np.bincount(seen, minlength=len(block.points.names))[seen] > 1)


def _as_residuals_agree(folder: Path) -> dict[str, Floats]:
    """Variances of control points and of positions along the axes, m^2, (3,), that the residuals show."""
    network = assemble(read_block(folder)).network
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


def _solved(folder: Path) -> Result:
    block = read_block(folder)
    return result_of(block, *adjusted(assemble(block)))

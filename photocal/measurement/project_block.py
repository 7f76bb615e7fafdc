"""From a project to its block: tie points, targets and marks in all images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.readout import left_by_movement
from photocal.base.arrays import Flags, Integers
from photocal.base.errors import ConfigurationError, IllPosedError, InputNotFoundError, NotConvergedError
from photocal.base.progress import Progress
from photocal.base.workers import one_crew
from photocal.block.folder import read_points
from photocal.block.model import NO_POINTS, Block, Images, ObjectPoints
from photocal.block.rig import make_heads
from photocal.block.table import known_rows, read_table
from photocal.exchange.parts import Mark
from photocal.findings.finding import Figure, Finding, Severity
from photocal.findings.texts import as_record
from photocal.geometry.camera import PARAMETERS, Camera, among
from photocal.geometry.frames import Frame, ShiftedFrame, reference_frame
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.block_files import Measured
from photocal.measurement.image_facts import ABOVE_TAKE_OFF, ImageFacts, clock_seconds, read_facts
from photocal.measurement.image_file import each_picture, list_images
from photocal.measurement.lens_choice import before_the_choice, with_chosen_lenses
from photocal.measurement.maker_camera import NO_LENS
from photocal.measurement.marks import read_any_marks, read_marks, with_marks
from photocal.measurement.match_images import Footprints, MatchingPlan, footprints
from photocal.measurement.measure_ties import (
    SAME,
    Sighted,
    position_figures,
    sight,
    stated_footprints,
    tie_record,
)
from photocal.measurement.orientation import Orientation
from photocal.measurement.oriented_ties import FEWEST_CONTROL, orient_ties
from photocal.measurement.placing import KEPT_MISFIT, OF_POSITIONS, pictures_turned, position_sigmas
from photocal.measurement.plain_targets import targets_of_project
from photocal.measurement.position_files import Given, map_places, read_positions
from photocal.measurement.recorded_turns import motion_while_read
from photocal.measurement.start_block import (
    POSITION_SIGMA_M,
    position_sigma,
    without_images,
    without_single_rays,
)
from photocal.measurement.tie_adjustment import Adjusted, adjust_ties, assembled, by_ray, scatter
from photocal.measurement.tie_block import GROSS, brought_nearer, marked_control, place, with_ties
from photocal.measurement.tracks import Tracks, of_images
from photocal.project import Project

# While gross errors are sought these are held: a level block determines them only with precise positions,
# which the measurement does not use.
HELD = ("c", "x0", "y0")
# What is held, step by step, where a block does not bear all that its project estimates.
HOLDING: tuple[tuple[str, ...], ...] = ((), HELD, PARAMETERS)
# How far heads move (m) and turn (rad) on their frame while gross errors are sought.
LOOSE_FRAME = 0.05, 0.002
# A principal distance that leaves its given value by so many prior sigmas is not that of the lens: what the
# model lacks (a rolling shutter above all) went into it.
CREDIBLE_SIGMAS = 4.0
# From this share on poses of one principal distance are no start for another.
ANOTHER_C = 0.02
# With enough control points heights of the images are hardly needed; they may count from another surface.
OTHER_SURFACE_M = 50.0
# Of more marks that do not fit only the worst are named.
MARKS_NAMED = 3
# Rays that miss by more leave something to explain. Movement while images are read leaves 0.19 of v'Pv in a
# flight with 30 ms, 0.79 in one with two principal distances, and 0.996 to 0.998 in four with neither.
ROUGH_PX, MOVES = 0.3, 0.5
# With fewer marks nobody knows what they scatter by.
FEWEST_MARKS = 20


@one_crew()
def measure_project(
    project: Project,
    exposures: Orientation | None,
    plan: MatchingPlan,
    progress: Progress,
    marks_files: Sequence[Path] = (),
) -> Measured:
    """Measure the images of a project.

    exposures: exterior orientations of some or all images in the project's system, NaN where unknown: good to
        start from, and with their covariances to predict targets. Without: the positions that the images
        state.
    returns: block in the project's system with the project's cameras; exterior orientations without sigma are
        those of the tie points, good enough to start from.
    raises PhotocalError: when too few images can be read, fit a camera, or are oriented.
    """
    control = control_points(project)
    paths, marks_file = list_images(project.picture_folder), project.control.marks
    by_hand = read_marks(marks_file) if marks_file is not None and marks_file.exists() else ()
    if marks_files:
        sizes = {facts.name: facts.size_px for facts in each_picture(paths, read_facts)[0]}
        by_hand += tuple(mark for file in marks_files for mark in read_any_marks(file, sizes))
    # What was observed of them stands elsewhere: in the block they are start values.
    starts: Images | None = None
    if exposures is not None:
        starts = Images.observed(replace(exposures.images, covariance=None))
    unmarked = not by_hand and not project.control.coded_targets
    if starts is None and project.crs == "local" and unmarked and control.of_role("control").any():
        raise _nowhere(project.name)
    looking = stated_footprints if starts is None else partial(_footprints, project, starts, control)
    known = better_known(project, [path.name for path in paths])
    sighted = sight(paths, plan, progress, looking, known)
    camera_of, exposure = pictures_of_heads(project)
    if starts is not None:
        camera_of |= dict(zip(starts.names, starts.camera.tolist(), strict=True))
    sighted, member = _with_cameras(sighted, project.cameras, camera_of)
    given = _starts(project, sighted.facts, member, starts, exposure)
    block = Block(
        project.name,
        project.crs,
        project.height if project.crs != "local" else "",
        "control",
        project.cameras,
        given,
        control,
        heads=make_heads(project.contents.head, [camera.id for camera in project.cameras], project.path),
    )
    targets = targets_of_project(project, sighted.sources, exposures, control, plan.processes, progress)
    block, unknown = with_marks(block, (*by_hand, *targets.marks))
    if not len(marked_control(block)) and not np.isfinite(given.values[:, 3:]).all(axis=1).any():
        if project.crs != "local" or control.of_role("control").any():
            raise _nowhere(project.name)
        block = replace(block, datum="free")
    soft = _softened(block)
    tracks = from_two_exposures(sighted.tracks, given.exposure)
    oriented = orient_ties(soft, sighted.sources, tracks, sighted.pairs, plan.processes, progress)
    # Positions of a flight log come later, and with them what determines c.
    held, open_lens = oriented.adjusted, project.images.lens == "unknown"
    held = before_the_choice(held) if open_lens else held
    released, block, more = release(held, block, HOLDING if starts is None else ((),))
    if open_lens:
        # What one lens refused may fit the other.
        stay = np.isin(oriented.adjusted.block.images.names, released.block.images.names)
        tracks = of_images(oriented.adjusted.tracks, stay)
        released, block, chosen = with_chosen_lenses(released, block, tracks)
        more += chosen
    more += _moving(released)
    suspects = suspected_marks(released, control)
    gone = (*oriented.left_out, *released.left_out)
    measured, of_positions = _restored(oriented.adjusted, released, block)
    if starts is None:
        gimbal = {facts.name: facts.gimbal_deg for facts in sighted.facts}
        recorded = np.radians([gimbal[name] for name in measured.images.names])
        more += pictures_turned(measured.images.names, released.values, recorded)
        above = any(facts.altitude_kind == ABOVE_TAKE_OFF for facts in sighted.facts)
        if above and project.crs != "local" and len(marked_control(block)) < FEWEST_CONTROL:
            more.append(Finding("heights-above-take-off", "doubtful"))
    record = {
        **tie_record(sighted, replace(oriented, adjusted=released, left_out=gone)),
        "kind": "project",
        "marks": {
            "by_hand": len(by_hand),
            "targets": len(targets.marks),
            "used": int(np.count_nonzero(released.block.observations.point < len(control.names))),
        },
        "targets": targets.record,
        "positions": None if starts is not None else position_figures(sighted.facts, given.sigma[:, 3:]),
        "unknown_marks": [f"{mark.point} in {mark.image}" for mark in unknown],
        "unknown_targets": list(targets.strangers),
        "suspected_marks": suspects,
        **as_record(
            [
                *targets.findings,
                *(finding for finding in oriented.findings if not _outdated(finding, project.cameras)),
                *of_positions,
                *more,
                *findings_of_marks(unknown, targets.strangers, suspects, (*sighted.left_out, *gone)),
            ]
        ),
    }
    return Measured(measured, record)


def _with_cameras(
    sighted: Sighted, cameras: Sequence[Camera], stated: Mapping[str, int]
) -> tuple[Sighted, Integers]:
    """Camera of each image: as the table says, else the one of its size; others are left out."""
    if not cameras:
        raise ConfigurationError("the project has no [[camera]]", "add one: see docs/block-folder.md")
    member, reasons = [], []
    for image in sighted.facts:
        alike = [k for k, camera in enumerate(cameras) if camera.size_px == image.size_px]
        k = stated.get(image.name, alike[0] if alike else 0)
        member.append(k)
        fits = cameras[k].size_px == image.size_px
        width, height = image.size_px
        reasons.append("" if fits else f"its {width} x {height} px are not those of camera {cameras[k].id}")
    sighted = sighted.without(reasons)
    return sighted, np.array([k for k, why in zip(member, reasons, strict=True) if not why], dtype=np.int64)


def from_two_exposures(tracks: Tracks, exposure: Sequence[str]) -> Tracks:
    """Tracks that more than one exposure shows: heads of one frame see a point from one place."""
    if not any(exposure):
        return tracks
    keys = [name or f"image {k}" for k, name in enumerate(exposure)]
    number = np.unique(keys, return_inverse=True)[1]
    places = np.unique(np.column_stack([tracks.track, number[tracks.image]]), axis=0)[:, 0]
    return tracks.some((np.bincount(places, minlength=tracks.count) > 1)[tracks.track])


def pictures_of_heads(project: Project) -> tuple[dict[str, int], dict[str, str]]:
    """Camera and exposure of the pictures that a project's table names; none without a table."""
    path = project.images.pictures
    if path is None:
        return {}, {}
    table = read_table(path, ("image", "camera"), ("exposure",))
    names = table.unique_names("image")
    member = known_rows(table, "camera", tuple(camera.id for camera in project.cameras), project.path.name)
    exposure = table.texts("exposure") if table.has("exposure") else ("",) * len(names)
    return dict(zip(names, member.tolist(), strict=True)), dict(zip(names, exposure, strict=True))


def _starts(
    project: Project,
    facts: Sequence[ImageFacts],
    camera: Integers,
    starts: Images | None,
    exposure: Mapping[str, str],
) -> Images:
    values, sigma = np.full((len(facts), 6), np.nan), np.full((len(facts), 6), np.inf)
    if starts is None:
        if project.crs != "local":
            values[:, 3:] = map_places(facts, project.crs)
            # That of a picture, the project's, or what is assumed.
            stated = project.images.position_sigma_m
            if stated != "free":
                sigma[:, 3:] = position_sigma(facts, stated or POSITION_SIGMA_M)
            sigma[np.isnan(values[:, 3:]).any(axis=1)] = np.inf
    else:
        place = {name: k for k, name in enumerate(starts.names)}
        rows = np.array([place.get(image.name, -1) for image in facts])
        values[rows >= 0], sigma[rows >= 0] = starts.values[rows[rows >= 0]], starts.sigma[rows[rows >= 0]]
    names = tuple(image.name for image in facts)
    exposures = tuple(exposure.get(name, "") for name in names)
    # The grid's axes are east and north but for its convergence.
    velocity = np.array([picture.velocity_m_s for picture in facts]).reshape(-1, 3)
    readout = np.array([given.value("readout") for given in project.cameras])[camera]
    motion, motion_sigma = motion_while_read(velocity, [picture.turns for picture in facts], readout)
    return Images(
        names, camera, values, sigma, motion, motion_sigma, clock_seconds(facts), exposure=exposures
    )


def better_known(project: Project, names: Sequence[str]) -> Given:
    """What a project's table of positions says in place of the pictures."""
    path = project.images.positions
    return NO_LENS.of if path is None else read_positions(path, names)


def control_points(project: Project) -> ObjectPoints:
    """Surveyed points of a project; none without a table."""
    path = project.control.points
    return NO_POINTS if path is None else read_points(path)


def _footprints(
    project: Project, starts: Images, control: ObjectPoints, facts: Sequence[ImageFacts]
) -> Footprints:
    """Footprints by the exposures, on the level of the control points."""
    places = np.vstack([starts.values[:, 3:], control.values])
    middle = np.nanmean(places, axis=0)
    local = project.crs == "local"
    frame: Frame = ShiftedFrame(middle) if local else reference_frame(project.crs, project.height, middle)
    poses = local_poses(frame, starts.values)
    view = -matrix_from_angles(poses[:, :3])[:, 2]
    ground = float(np.mean(frame.to_local(control.values)[:, 2]))
    row = {name: k for k, name in enumerate(starts.names)}
    rows = [row.get(f.name) for f in facts]
    unknown = np.full(6, np.nan)
    image_poses = np.array([unknown if k is None else poses[k] for k in rows])
    looks = np.array([unknown[:3] if k is None else view[k] for k in rows])
    yaw_pitch = np.column_stack([np.arctan2(looks[:, 0], looks[:, 1]), np.arcsin(looks[:, 2])])
    cameras = [project.cameras[0 if k is None else starts.camera[k]] for k in rows]
    return footprints(
        image_poses[:, 3:5],
        image_poses[:, 5] - ground,
        yaw_pitch,
        np.array([f.size_px for f in facts], dtype=float),
        np.array([camera.value("c") / camera.pitch[0] for camera in cameras]),
    )


def _nowhere(name: str) -> InputNotFoundError:
    return InputNotFoundError(
        "neither the images nor marks of control points say where the block is",
        "give exposures, images with positions, or marks of at least three control points",
        where=name,
    )


def _softened(block: Block) -> Block:
    """Block for finding gross errors: positions without sigma are loosely observed, c is held."""
    known: Flags = np.asarray(np.isfinite(block.images.values[:, 3:]).all(axis=1))
    marked = marked_control(block)
    loosely = (
        *POSITION_SIGMA_M[:2],
        OTHER_SURFACE_M if len(marked) >= FEWEST_CONTROL else POSITION_SIGMA_M[2],
    )
    sigma = block.images.sigma.copy()
    loose = known[:, None] & np.isinf(sigma[:, 3:])
    sigma[:, 3:] = np.where(loose, loosely, sigma[:, 3:])
    cameras = tuple(replace(camera, estimated=camera.estimated & ~among(*HELD)) for camera in block.cameras)
    # Heads lie as firmly as their first poses tell.
    heads = tuple(replace(head, stiffness=LOOSE_FRAME) for head in block.heads)
    return replace(block, cameras=cameras, images=replace(block.images, sigma=sigma), heads=heads)


def release(
    held: Adjusted, block: Block, holding: Sequence[Sequence[str]]
) -> tuple[Adjusted, Block, list[Finding]]:
    """Adjust once more with all parameters that the project estimates and the block bears.

    Only now the residuals are those of the measurements: a principal point that is held wrongly would go
    into the sigmas. The exterior orientation of it is not used, for c may drift with the heights. What runs
    away, or leaves all that is known of it beforehand, is held as it was given; unless the rays then miss by
    far more: what was known is not of these pictures, which were cut or enlarged.
    """
    asked = {camera.id: camera for camera in block.cameras}
    refusal: dict[str, Figure] = {}
    apart: Adjusted | None = None
    for held_here in holding:
        # Nobody asks for a readout: that it has one, an unknown shutter has shown.
        free, readout = ~among(*held_here), among("readout")
        cameras = tuple(
            replace(
                camera,
                estimated=(asked[camera.id].estimated | (camera.estimated & readout)) & free,
                prior_sigma=asked[camera.id].prior_sigma,
                values=np.where(free, camera.values, asked[camera.id].values),
                given=asked[camera.id].values,
            )
            for camera in held.start.cameras
        )
        poses, start = held.values, replace(held.start, cameras=cameras)
        ratio = np.array(
            [a.value("c") / b.value("c") for a, b in zip(cameras, held.start.cameras, strict=True)]
        )
        if np.abs(ratio - 1.0).max() > ANOTHER_C:
            poses = brought_nearer(held.start, poses, held.tracks, ratio[start.images.camera])
        try:
            released = adjust_ties(start, poses, held.tracks)
            why = _not_borne(released, asked, cameras)
        except (IllPosedError, NotConvergedError):
            if held_here == holding[-1]:
                raise
            why = {"camera": cameras[0].id}
        if not why or held_here == holding[-1]:
            break
        refusal = refusal or why
        if "value" in why:
            apart = released
    if apart is not None and scatter(released) > KEPT_MISFIT * scatter(apart):
        refuted = str(refusal["camera"])
        cameras = tuple(
            replace(
                camera, prior_sigma=np.where(among("c") & (camera.id == refuted), np.inf, camera.prior_sigma)
            )
            for camera in block.cameras
        )
        findings = [Finding("c-refuted-by-rays", "doubtful", refuted, refusal)]
        return apart, replace(block, cameras=cameras), findings
    # What is held has no prior: it would be an observation of what is no unknown.
    kept = tuple(
        replace(
            camera, estimated=camera.estimated & free, prior_sigma=np.where(free, camera.prior_sigma, np.inf)
        )
        for camera in block.cameras
    )
    findings = list[Finding]()
    used = np.isin(np.arange(len(kept)), released.start.images.camera)
    for camera, before, in_use in zip(kept, block.cameras, used, strict=True):
        gone = before.estimated & ~camera.estimated
        if in_use and gone.any():
            names = tuple(n for n, lost in zip(PARAMETERS, gone, strict=True) if lost)
            clause = "would-become" if "value" in refusal else "run-away"
            findings.append(
                Finding("camera-held", "doubtful", camera.id, {"names": names, **refusal}, (clause,))
            )
    return released, replace(block, cameras=kept), findings


def _not_borne(
    released: Adjusted, given: Mapping[str, Camera], wanted: Sequence[Camera]
) -> dict[str, Figure]:
    """What shows that a block does not bear the parameters that were to be estimated; empty when it does."""
    ids = {camera.id for camera in released.start.cameras}
    wanted = [camera for camera in wanted if camera.id in ids]
    for camera, used in zip(wanted, released.assembly.network.cameras, strict=True):
        if (camera.estimated & ~used.estimated).any():
            return {"camera": camera.id}
    for camera in released.start.cameras:
        first = given[camera.id]
        away, prior = abs(camera.value("c") - first.value("c")), float(first.prior_sigma[0])
        if camera.estimated[0] and away > (CREDIBLE_SIGMAS * prior if np.isfinite(prior) else np.inf):
            given_c = first.value("c")
            return {"camera": camera.id, "value": camera.value("c"), "given": given_c, "unit": camera.unit}
    return {}


def _restored(held: Adjusted, released: Adjusted, block: Block) -> tuple[Block, list[Finding]]:
    """The measured block with cameras, surveyed coordinates and observed values as they were given.

    Also what the rays say of its positions, beside the released cameras: a principal point that is held
    wrongly moves images by more than good positions are wrong.
    """
    names = released.block.images.names
    bare = without_images(block, ~np.isin(block.images.names, names))
    remaining = np.isin(held.block.images.names, names)
    borne, findings = np.full_like(bare.images.sigma, np.inf), list[Finding]()
    if released.start.datum == "free":
        bare = without_single_rays(bare)
    else:
        shifted = len(marked_control(block)) >= FEWEST_CONTROL
        borne, _, findings = position_sigmas(bare.images, released.values, shifted=shifted)
        # An image may be held level where all positions lie in a line.
        borne[:, :3] = released.start.images.sigma[:, :3]
    bare = replace(bare, datum=released.start.datum, images=replace(bare.images, sigma=borne))
    known = np.hstack([released.start.images.values[:, :3], bare.images.values[:, 3:]])
    poses = np.where(np.isfinite(borne), known, held.values[remaining])
    oriented = without_images(held.start, ~remaining)
    oriented = replace(oriented, images=replace(oriented.images, values=held.values[remaining]))
    values = place(oriented, released.tracks, 0.0)
    sigma = released.block.observations.sigma[len(bare.observations.image) :, 0]
    bare = replace(bare, images=replace(bare.images, values=poses))
    return with_ties(bare, released.tracks, values, sigma), findings


def _outdated(finding: Finding, cameras: Sequence[Camera]) -> bool:
    """Whether the released cameras tell it better, or it says only that c is estimated, as is asked for."""
    if finding.code in OF_POSITIONS:
        return True
    if finding.code != "c-refuted-by-rays":
        return False
    camera = next(camera for camera in cameras if camera.id == finding.subject)
    change = abs(finding.figures["value"] - finding.figures["given"])
    return bool(camera.estimated[0]) and change <= CREDIBLE_SIGMAS * float(camera.prior_sigma[0])


def _moving(adjusted: Adjusted) -> list[Finding]:
    """Images that move while they are read, where the flight does not tell how long that takes."""
    cameras, px = adjusted.start.cameras, scatter(adjusted)
    doubtful = [camera.id for camera in cameras if camera.shutter == "unknown" and not camera.rolling]
    if not doubtful or px < ROUGH_PX:
        return []
    network = assembled(replace(adjusted.block, cameras=cameras), adjusted.values)[0].network
    share = left_by_movement(network, adjusted.solution)
    if share > MOVES:
        return []
    figures: dict[str, Figure] = {"px": px, "left_px": px * float(np.sqrt(share))}
    return [Finding("images-move", "doubtful", name, figures) for name in doubtful]


def suspected_marks(adjusted: Adjusted, control: ObjectPoints) -> list[dict[str, Any]]:
    """Marks whose residual is too large for their sigma, the largest first."""
    block = adjusted.block
    size, redundancy = by_ray(adjusted.assembly, adjusted.solution)
    seen = block.observations
    spread = np.sqrt((seen.sigma**2).sum(axis=1) * np.maximum(redundancy, 0.05))
    share = size / spread
    marked = seen.point < len(control.names)
    # What the model of this stage lacks, such as vibration within a readout, moves all marks: none is off.
    # Squares of such shares are exponential, with a median of ln 2 where the sigmas are right.
    typical = np.median(share[marked]) / np.sqrt(np.log(2.0)) if marked.sum() >= FEWEST_MARKS else 1.0
    bad = np.flatnonzero(marked & (share > GROSS * max(1.0, typical)))
    order = bad[np.argsort(-share[bad])]
    return [
        {
            "image": block.images.names[seen.image[k]],
            "point": block.points.names[seen.point[k]],
            "residual_px": float(size[k]),
            "in_sigmas": float(share[k]),
        }
        for k in order
    ]


def findings_of_marks(
    unknown: Sequence[Mark],
    strangers: Sequence[str],
    suspects: Sequence[dict[str, Any]],
    left_out: Sequence[dict[str, str]],
) -> list[Finding]:
    """Find what must not pass silently: images, marks and targets that take no part, marks far off."""
    findings = []
    for cause in dict.fromkeys(entry.get("code", "unusable") for entry in left_out):
        images = tuple(entry["image"] for entry in left_out if entry.get("code", "unusable") == cause)
        lost: Severity = "note" if cause == SAME else "doubtful"
        findings.append(Finding("image-left-out", lost, figures={"images": images}, cause=cause))
    findings += [Finding("unknown-mark", "doubtful", f"{mark.point} ({mark.image})") for mark in unknown]
    findings += [Finding("unknown-target", "doubtful", name) for name in strangers]
    return findings + _marks_off(suspects)


def _marks_off(suspects: Sequence[dict[str, Any]]) -> list[Finding]:
    """Each mark that is far off; of many the worst, with their number and those that come next."""
    places = [f"{suspect['point']} ({suspect['image']})" for suspect in suspects]
    findings = []
    for suspect, name in zip(suspects, places, strict=True):
        figures = {"point": suspect["point"], "image": suspect["image"]}
        figures |= {"px": suspect["residual_px"], "sigmas": suspect["in_sigmas"]}
        if len(suspects) > MARKS_NAMED:
            figures |= {"n": float(len(suspects) - 1), "marks": tuple(places[1 : MARKS_NAMED + 1])}
            return [Finding("mark-off", "doubtful", name, figures, ("marks-off",))]
        findings.append(Finding("mark-off", "doubtful", name, figures))
    return findings

"""The step from pictures to a block: of a project, of a folder, of a board or a field of coded targets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Flags, Integers
from photocal.base.errors import ConfigurationError
from photocal.base.operating_system import cache_folder
from photocal.base.policy import policy
from photocal.base.progress import Progress, quiet
from photocal.base.text_tables import known_rows, read_table
from photocal.base.workers import Cluster, one_crew
from photocal.block.folder import read_points
from photocal.block.model import NO_POINTS, ROLES, Block, ObjectPoints
from photocal.block.network import OTHER_SURFACE_M, block_frame
from photocal.block.project import Project
from photocal.block.rig import make_heads
from photocal.findings.finding import Finding
from photocal.findings.texts import as_record
from photocal.geometry.camera import Camera, among
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.realizations import FrameShift
from photocal.measurement.control_review import stray_points
from photocal.measurement.image_facts import ABOVE_TAKE_OFF, ImageFacts, motion_while_read, read_facts
from photocal.measurement.image_file import each_picture, list_images
from photocal.measurement.image_pairs import Footprints, exposed_footprints, stated_footprints
from photocal.measurement.maker_camera import stated_camera, with_lens
from photocal.measurement.mark_frames import settle_marks
from photocal.measurement.markers import parse_board
from photocal.measurement.marks import (
    ControlMarks,
    Sizes,
    in_map_system,
    named_after,
    read_any_marks,
    read_control_marks,
    read_marks,
    with_marks,
)
from photocal.measurement.match_images import ImageTracks, MatchingPlan, too_few, track_images
from photocal.measurement.measurement_record import (
    MeasuredBlock,
    findings_of_marks,
    position_figures,
    suspected_marks,
    tie_record,
)
from photocal.measurement.options import MeasureOptions
from photocal.measurement.orientation import Orientation, of_exposures
from photocal.measurement.oriented_ties import orient_ties
from photocal.measurement.picture_tests import judge_cameras
from photocal.measurement.plain_targets import FoundTargets, targets_of_project
from photocal.measurement.position_files import (
    Given,
    frames_of,
    in_project,
    local_places,
    map_places,
    moved_finding,
    read_positions,
    shift_of_positions,
)
from photocal.measurement.release import HELD, HOLDING, STEPS, with_released_cameras
from photocal.measurement.target_block import measure_board, measure_field
from photocal.measurement.tie_block import POSITION_SIGMA_M, marked_control, start_block
from photocal.measurement.tie_orientation import pictures_turned
from photocal.measurement.tracks import Tracks

# How far heads move (m) and turn (rad) on their frame during the search for gross errors.
LOOSE_FRAME = 0.05, 0.002
NO_CONTROL = ControlMarks("", NO_POINTS, ())


@dataclass(frozen=True)
class KnownPictures:
    """Pictures to measure, and what is known of them beside what they state.

    stated: a picture's facts, with what is known better.
    control: points and marks, as pictures of these sizes show them; its system is empty where nobody names
        one: then coordinates are local, about the positions of the pictures.
    height: kind of the heights.
    position_sigma: of positions without; None leaves all positions free.
    told: what the record says besides.
    project: its cameras are released in the end, its targets searched for. Without one the pictures state
        their cameras, and c, x0, y0 are held.
    camera_of, exposure_of: cameras of pictures, and what those of heads on one frame have in common.
    exposures: orientations from a flight log, to start from and to predict targets.
    """

    name: str
    paths: Sequence[Path]
    stated: Given
    footprints: Callable[[Sequence[ImageFacts]], Footprints]
    control: Callable[[Sizes], ControlMarks]
    height: str
    told: Callable[[ImageTracks, ControlMarks], dict[str, Any]]
    project: Project | None = None
    position_sigma: tuple[float, float, float] | None = POSITION_SIGMA_M
    camera_of: Mapping[str, int] = field(default_factory=dict)
    exposure_of: Mapping[str, str] = field(default_factory=dict)
    exposures: Orientation | None = None


def measure(
    pictures: Project | Path | str, options: MeasureOptions | None = None, progress: Progress = quiet
) -> MeasuredBlock:
    """Measure pictures, and make the block that `photocal.adjust` takes.

    Parameters
    ----------
    pictures
        A project that was read, or the folder of the pictures.
    options
        What is measured in a folder (tie points, with marked control, a board, a field of coded targets), and
        with which means. A project names its own control and targets.
    progress
        Told how far the work is.

    Returns
    -------
    MeasuredBlock
        The block, and the record of how it was measured (`measurement.json`).

    Raises
    ------
    ConfigurationError
        When options do not go with what is measured.
    PhotocalError
        When too few pictures can be read, show the targets, or are oriented.
    """
    options = options or MeasureOptions()
    if isinstance(pictures, Project):
        if options.board or options.gcp is not None:
            raise ConfigurationError("a project names its own control", "give --images with --board or --gcp")
        # What `photocal exposures` or `photocal run` left in the work folder: good to start from.
        folder = pictures.output / "exposures"
        exposures = of_exposures(pictures, folder) if (folder / "images.csv").exists() else None
        plan = _plan(options, pictures.picture_folder)
        return measure_project(pictures, exposures, plan, progress, options.marks)
    if options.marks:
        raise ConfigurationError(
            "--marks has no coordinates of its points",
            "give PROJECT.toml, whose control table has them, or --gcp with both",
        )
    folder = Path(pictures)
    paths, name = list_images(folder), folder.resolve().name
    if options.field:
        cache = (options.cache or cache_folder()).resolve()
        lens = partial(with_lens, c_px=options.c_px, focal_mm=options.focal_mm)
        return measure_field(paths, options.field, options.distances, name, lens, cache, progress)
    if options.board:
        board = parse_board(options.board, options.square_m, options.charuco)
        return measure_board(paths, board, name, progress)
    return measure_images(paths, name, _plan(options, folder), progress, options)


def _plan(options: MeasureOptions, images: Path) -> MatchingPlan:
    usual = MatchingPlan()
    cache = (options.cache or usual.cache).resolve()
    if not options.cluster:
        return MatchingPlan(cache, options.workers or usual.processes)
    cluster = Cluster(options.cluster)
    cluster.require_shared(images, cache)
    return MatchingPlan(cache, cluster)


def measure_images(
    paths: Sequence[Path],
    name: str,
    plan: MatchingPlan,
    progress: Progress,
    options: MeasureOptions | None = None,
) -> MeasuredBlock:
    """Measure tie points in images, join them with marked control points, and make their block.

    options: lens, and the file of the control points.
    raises PhotocalError: when the file or too few images can be read, or the images are not oriented.
    """
    options = options or MeasureOptions()
    file, sigma_m, height, crs = options.gcp, options.gcp_sigma_m, options.height, options.crs
    # What is wrong with the file is reported before the images are examined.
    placed = file is not None and read_control_marks(file, sigma_m, {}).crs not in ("", "local")
    if placed and height not in ("ellipsoidal", "orthometric"):
        raise ConfigurationError(
            "does not state its height kind", "give --height ellipsoidal or --height orthometric", where=file
        )

    def read(sizes: Sizes) -> ControlMarks:
        """Points and marks, in a map system or local, as the images of these sizes show them."""
        if file is None:
            return NO_CONTROL
        given = read_control_marks(file, sigma_m, sizes)
        given = replace(given, crs=crs) if crs else in_map_system(given)
        return replace(given, marks=named_after(given.marks, sizes))

    def told(tracked: ImageTracks, given: ControlMarks) -> dict[str, Any]:
        """Say for the record where the camera and the places come from."""
        sources = sorted({stated_camera("", facts).source for facts in tracked.facts})
        if file is None:
            _, origin = local_places(tracked.facts)
            at = dict(zip(("latitude_deg", "longitude_deg", "height_m"), origin, strict=True))
            own: dict[str, Any] = {"kind": "tie points", "origin": at if np.isfinite(origin[0]) else None}
        else:
            control = {"file": file.name, "sigma_assumed_m": list(sigma_m), "marks": len(given.marks)}
            own = {
                "kind": "tie and control points",
                "system": {"crs": given.crs, "height": height},
                "control": control,
            }
        return {"principal_distance_from": sources, **own}

    lens = partial(with_lens, c_px=options.c_px, focal_mm=options.focal_mm)
    kind = "" if file is None else height
    known = KnownPictures(name, paths, lens, stated_footprints, read, kind, told)
    return _measured(known, plan, progress)


def measure_project(
    project: Project,
    exposures: Orientation | None,
    plan: MatchingPlan,
    progress: Progress,
    marks_files: Sequence[Path] = (),
) -> MeasuredBlock:
    """Measure the images of a project.

    exposures: exterior orientations of some or all images in the project's system, NaN where unknown: good to
        start from, and with their covariances to predict targets. Without: the positions that the images
        state.
    returns: block in the project's system with the project's cameras; exterior orientations without sigma are
        those of the tie points, good enough to start from.
    raises PhotocalError: when too few images can be read, fit a camera, or are oriented.
    """
    points = control_points(project)
    paths, marks_file = list_images(project.picture_folder), project.control.marks
    by_hand = read_marks(marks_file) if marks_file is not None and marks_file.exists() else ()
    if marks_files:
        sizes = {facts.name: facts.size_px for facts in each_picture(paths, read_facts)[0]}
        by_hand += tuple(mark for file in marks_files for mark in read_any_marks(file, sizes))
    if not project.cameras:
        raise ConfigurationError("the project has no [[camera]]", "add one: see docs/block-folder.md")
    camera_of, exposure_of = pictures_of_heads(project)
    if exposures is not None:
        camera_of |= dict(zip(exposures.images.names, exposures.images.camera.tolist(), strict=True))
    sigma = project.images.position_sigma_m
    known = KnownPictures(
        project.name,
        paths,
        better_known(project, paths),
        stated_footprints if exposures is None else partial(exposed_footprints, exposures, points),
        lambda _: ControlMarks(project.crs, points, tuple(by_hand)),
        project.height if project.crs != "local" else "",
        lambda *_: {"kind": "project"},
        project,
        None if sigma == "free" else sigma or POSITION_SIGMA_M,
        camera_of,
        exposure_of,
        exposures,
    )
    return _measured(known, plan, progress)


@one_crew()
def _measured(known: KnownPictures, plan: MatchingPlan, progress: Progress) -> MeasuredBlock:
    """Track features, orient the images by them, and measure tie points; targets and marks with them."""
    project, given = known.project, None
    if project is not None:
        plan = replace(plan, coded=tuple(coded.dictionary for coded in project.control.coded_targets))
    tracked = track_images(known.paths, plan, progress, known.footprints, known.stated)
    if project is not None:
        tracked, member = _with_cameras(tracked, project.cameras, known.camera_of)
        given = project.cameras, member
        if len(tracked.facts) < 2:
            where = known.paths[0].parent
            raise too_few(len(tracked.facts), len(known.paths), tracked.left_out, where)
    control = known.control({image.name: image.size_px for image in tracked.facts})
    control, strays = _without_strays(control)
    start = _start(known, control, tracked.facts, given)
    lenses = [start.cameras[k] for k in start.images.camera]
    targets = FoundTargets()
    if project is not None:
        surveyed, workers = control.points, plan.processes
        targets = targets_of_project(
            project, tracked.sources, lenses, known.exposures, surveyed, workers, progress
        )
    folder = {path.name: path for path in known.paths}
    settled, _, unused, settling = settle_marks(control.marks, control.points.names, tracked.facts, folder)
    block, _ = with_marks(start, (*settled, *targets.marks))
    positions_known = np.isfinite(start.images.values[:, 3:]).all(axis=1).any()
    if project is not None and not positions_known and not block.points.of_role("control").any():
        block = replace(block, datum="free")
    tracks = from_two_exposures(tracked.tracks, start.images.exposure)
    soft = _with_loose_positions(block, any_surface=project is None)
    oriented = orient_ties(soft, tracked.sources, tracks, tracked.pairs, plan.processes, progress)
    block = _as_fitted(block, oriented.marked)
    final, measured, findings = oriented.adjusted, oriented.adjusted.block, list(oriented.findings)
    if project is not None:
        holding = HOLDING if known.exposures is None else ((),)
        open_lens = project.images.lens == "unknown"
        with progress("adjusting the cameras", STEPS) as done:
            final, measured, findings = with_released_cameras(
                oriented, block, holding, open_lens=open_lens, done=done
            )
        oriented = replace(oriented, adjusted=final, left_out=(*oriented.left_out, *final.left_out))
        if known.exposures is None:
            gimbal = {facts.name: facts.gimbal_deg for facts in tracked.facts}
            recorded = np.radians([gimbal[name] for name in measured.images.names])
            findings += pictures_turned(measured.images.names, final.values, recorded)
            above = any(facts.altitude_kind == ABOVE_TAKE_OFF for facts in tracked.facts)
            if above and control.crs != "local" and len(marked_control(block)) < policy.fewest_control:
                findings.append(Finding("heights-above-take-off", "doubtful"))
    suspects = suspected_marks(final)
    bare = [Finding("no-coordinates", "doubtful", point) for point in control.without_coordinates]
    left_out = (*tracked.left_out, *oriented.left_out)
    lost = [*settling, *(finding for _, finding in unused)]
    marks = findings_of_marks(lost, targets.strangers, suspects, left_out)
    cameras = [camera.id for camera in start.cameras]
    findings += judge_cameras(tracked.facts, cameras, start.images.camera.tolist())
    frame = None if project is None or known.exposures is not None else project.images.position_frame
    placed = next((facts for facts in tracked.facts if facts.has_position), None)
    if project is not None and frame is not None and placed is not None:
        findings.append(moved_finding(shift_of_positions(frame, project.crs, placed)))
    used = int(np.count_nonzero(final.block.observations.point < len(final.start.points.names)))
    positions = position_figures(tracked.facts, start.images.sigma[:, 3:])
    record: dict[str, Any] = {
        **tie_record(tracked, oriented),
        **known.told(tracked, control),
        "marks": {"by_hand": len(control.marks), "targets": len(targets.marks), "used": used},
        "targets": targets.record,
        "positions": positions if known.exposures is None else None,
        "unknown_marks": [f"{m.point} in {m.image}" for m, _ in unused],
        "unknown_targets": list(targets.strangers),
        "suspected_marks": suspects,
        **as_record([*targets.findings, *strays, *bare, *findings, *marks]),
    }
    # Sigmas of ties come from their own residuals, and are not tested with them.
    return MeasuredBlock(replace(without_a_place(measured), global_test=(0.95, "none")), record)


def _without_strays(control: ControlMarks) -> tuple[ControlMarks, list[Finding]]:
    """Control without the coordinates that are none of the site: their points are unknown ones."""
    strays = stray_points(control.points, control.crs)
    if not strays:
        return control, []
    rows, points = list(strays), control.points
    values, sigma, role = points.values.copy(), points.sigma.copy(), points.role.copy()
    values[rows], sigma[rows], role[rows] = np.nan, np.inf, ROLES.index("tie")
    named = list(strays.values())
    return replace(control, points=replace(points, values=values, sigma=sigma, role=role)), named


def _as_fitted(block: Block, marked: Block) -> Block:
    """The block with the control and the marks of another of its images."""
    place = {name: k for k, name in enumerate(block.images.names)}
    image = np.array([place[name] for name in marked.images.names], dtype=np.int64)
    seen = marked.observations
    return replace(block, points=marked.points, observations=replace(seen, image=image[seen.image]))


def without_a_place(block: Block) -> Block:
    """A free block in a system of its own: in that of the project it would seem to have a place."""
    if block.datum != "free" or block.frame == "local":
        return block
    frame = block_frame(block)
    poses = local_poses(frame, block.images.values)
    points = frame.to_local(block.points.values)
    return replace(
        block,
        frame="local",
        height="",
        images=replace(block.images, values=poses),
        points=replace(block.points, values=points),
    )


def _start(
    known: KnownPictures,
    control: ControlMarks,
    facts: Sequence[ImageFacts],
    given: tuple[tuple[Camera, ...], Integers] | None,
) -> Block:
    """The block that marks and tie points are added to."""
    places = np.full((len(facts), 3), np.nan)
    if not control.crs:
        return start_block(facts, local_places(facts)[0], known.name)
    # Where the images say they are; in a local system that says nothing.
    if control.crs != "local" and known.exposures is None:
        places = map_places(facts, control.crs)
    block = start_block(facts, places, known.name, known.position_sigma, given)
    block = replace(
        block,
        frame=control.crs,
        height="" if control.crs == "local" else known.height,
        datum="control",
        points=control.points,
    )
    if known.project is None:
        return block
    images, cameras = block.images, block.cameras
    if known.exposures is not None:
        # What was observed of them stands elsewhere: in the block they are start values.
        oriented = known.exposures.images.named(images.names)
        images = replace(images, values=oriented.values, sigma=np.full_like(images.sigma, np.inf))
    # The grid's axes are east and north but for its convergence.
    velocity = np.array([picture.velocity_m_s for picture in facts]).reshape(-1, 3)
    readout = np.array([camera.value("readout") for camera in cameras])[images.camera]
    motion, motion_sigma = motion_while_read(velocity, [picture.turns for picture in facts], readout)
    exposure = tuple(known.exposure_of.get(image.name, "") for image in facts)
    return replace(
        block,
        images=replace(images, motion=motion, motion_sigma=motion_sigma, exposure=exposure),
        heads=make_heads(known.project.contents.head, [own.id for own in cameras], known.project.path),
    )


def _with_cameras(
    tracked: ImageTracks, cameras: Sequence[Camera], stated: Mapping[str, int]
) -> tuple[ImageTracks, Integers]:
    """Camera of each image: as the table says, else the one of its size; others are left out."""
    member, reasons = [], []
    for image in tracked.facts:
        alike = [k for k, camera in enumerate(cameras) if camera.size_px == image.size_px]
        k = stated.get(image.name, alike[0] if alike else 0)
        member.append(k)
        fits = cameras[k].size_px == image.size_px
        width, height = image.size_px
        reasons.append("" if fits else f"its {width} x {height} px are not those of camera {cameras[k].id}")
    tracked = tracked.without(reasons)
    return tracked, np.array([k for k, why in zip(member, reasons, strict=True) if not why], dtype=np.int64)


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


def better_known(project: Project, pictures: Sequence[Path]) -> Given:
    """What a project's table of positions says in place of the pictures, in the project's frame."""
    path, frame = project.images.positions, project.images.position_frame
    told: Given = with_lens
    if path is not None:
        told = read_positions(path, each_picture(pictures, read_facts)[0])
    if frame is None:
        return told
    # Said once for all, and not of each picture.
    frames_of(frame, project.crs)
    shifts: list[FrameShift] = []

    def moved(facts: ImageFacts) -> ImageFacts:
        """Facts in the frame of the project; one shift holds for a whole site."""
        known = told(facts)
        if known.has_position and not shifts:
            shifts.append(shift_of_positions(frame, project.crs, known))
        return in_project(known, shifts[0]) if shifts else known

    return moved


def control_points(project: Project) -> ObjectPoints:
    """Surveyed points of a project; none without a table."""
    path = project.control.points
    return NO_POINTS if path is None else read_points(path)


def _with_loose_positions(block: Block, *, any_surface: bool) -> Block:
    """Block for finding gross errors: positions without sigma are loosely observed, c is held.

    any_surface: whether the heights of the positions are of no known kind; control is better, where it places
    the block.
    """
    known: Flags = np.asarray(np.isfinite(block.images.values[:, 3:]).all(axis=1))
    controlled = len(marked_control(block)) >= policy.fewest_control
    loosely = (*POSITION_SIGMA_M[:2], OTHER_SURFACE_M if controlled else POSITION_SIGMA_M[2])
    sigma = block.images.sigma.copy()
    loose = known[:, None] & np.isinf(sigma[:, 3:])
    sigma[:, 3:] = np.where(loose, loosely, sigma[:, 3:])
    if any_surface and controlled:
        sigma[known, 5] = OTHER_SURFACE_M
    cameras = tuple(replace(camera, estimated=camera.estimated & ~among(*HELD)) for camera in block.cameras)
    # Heads lie as firmly as their first poses tell.
    heads = tuple(replace(head, stiffness=LOOSE_FRAME) for head in block.heads)
    return replace(block, cameras=cameras, images=replace(block.images, sigma=sigma), heads=heads)

"""Stage `measurements`: tie points, targets and marks in the images, or observations that were given."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import InputMalformedError
from photocal.base.progress import Progress
from photocal.base.text_tables import read_table
from photocal.block.folder import read_images, read_observations, read_points
from photocal.block.model import ROLES, Block, Images, fingerprint
from photocal.block.network import observed_plane
from photocal.block.project import Project
from photocal.block.setup import ObservationKeys
from photocal.geometry.distortion import slopes_of
from photocal.geometry.rotation import matrix_from_angles
from photocal.run.stage import Stage, pictures_of


def given_block(project: Project, images: Images, without_exposure: Collection[str] = ()) -> Block:
    """Make the block of given observations: points that the control table does not have are tie points."""
    given = project.contents.measurements
    path = given.observations if given is not None and given.observations is not None else Path()
    control = read_points(project.control.points or Path())
    table = read_table(path, ("image", "point", "x", "y"), ("sx", "sy"))
    ties = tuple(sorted(set(table.names("point")[1]) - set(control.names)))
    left_out = tuple(sorted(set(without_exposure) - set(images.names)))
    unknown = sorted(set(table.names("image")[1]) - set(images.names) - set(left_out))
    if unknown:
        raise InputMalformedError(
            f"image {unknown[0]} has no exposure" + (f", as {len(unknown) - 1} more" if unknown[1:] else ""),
            "remove its observations, or complete the exposures",
            where=path,
        )
    points = control.with_ties(ties, np.full((len(ties), 3), np.nan))
    keys = ObservationKeys(unit="px", axes="pixel", sigma=None if given is None else given.sigma_px)
    seen, _ = read_observations(path, keys, images.names + left_out, points.names)
    kept = seen.image < len(images.names)
    # Points that the images left out alone made determined go with them.
    before, after = (np.bincount(seen.point[some], minlength=len(points.names)) for some in (..., kept))
    starved = (before >= 2) & (after < 2) & (points.role != ROLES.index("control"))
    kept &= ~starved[seen.point]
    block = Block(
        name=project.name,
        frame=project.crs,
        height=project.height,
        datum="control",
        cameras=project.cameras,
        images=images,
        points=points,
        observations=seen.rows(kept),
        inputs=(fingerprint(path),),
    )
    return with_points_on_the_ground(block)


def with_points_on_the_ground(block: Block) -> Block:
    """Give points without coordinates the place where their rays meet the level of the control points."""
    level = float(np.nanmedian(block.points.values[:, 2]))
    seen = block.observations
    plane, _ = observed_plane(block)
    slopes = slopes_of(block.cameras, block.images.camera[seen.image], plane)
    sight = np.column_stack([slopes, -np.ones(len(slopes))])
    rotation = matrix_from_angles(block.images.values[:, :3])[seen.image]
    direction = np.einsum("nji,nj->ni", rotation, sight)
    centre = block.images.values[seen.image, 3:]
    drop = level - centre[:, 2]
    down = np.isfinite(direction[:, 2]) & (direction[:, 2] * drop > 0)
    reach = np.divide(drop, direction[:, 2], out=np.zeros(len(drop)), where=down)
    place = centre + reach[:, None] * direction
    count = np.bincount(seen.point[down], minlength=len(block.points.names))
    values = block.points.values.copy()
    missing = np.isnan(values).any(axis=1) & (count > 0)
    for axis in range(3):
        total = np.bincount(seen.point[down], place[down, axis], len(count))
        values[missing, axis] = total[missing] / count[missing]
    return replace(block, points=replace(block.points, values=values))


def measurements_stage(project: Project, exposures: Path | None) -> Stage:
    """Describe the stage, which follows the one whose folder is `exposures`; None without a flight."""
    control, given = project.control, project.contents.measurements
    inputs = {} if control.points is None else {"control points": control.points}
    if given is not None and given.observations is not None:
        inputs["observations"] = given.observations
    else:
        inputs |= pictures_of(project)
        if project.images.positions is not None:
            inputs["positions"] = project.images.positions
        if project.images.pictures is not None:
            inputs["pictures"] = project.images.pictures
        if control.marks is not None and control.marks.exists():
            inputs["marks"] = control.marks
    settings = {
        "crs": project.crs,
        "height": project.height,
        "camera": [keys.model_dump(mode="json") for keys in project.contents.camera],
        "head": [keys.model_dump(mode="json") for keys in project.contents.head],
        "targets": [target.model_dump(mode="json") for target in control.targets],
        "sigma_px": None if given is None else given.sigma_px,
        "position_sigma_m": project.images.position_sigma_m,
        "position_frame": project.images.position_frame,
        "lens": project.images.lens,
    }
    return Stage(
        "measurements",
        "points in the images",
        lambda out, show: _make(project, exposures, out, show),
        inputs,
        settings,
        () if exposures is None else (exposures,),
    )


def _make(project: Project, exposures: Path | None, folder: Path, show: Progress) -> None:
    from photocal.measurement.measurement_record import SCHEMA, MeasuredBlock
    from photocal.measurement.picture_block import control_points
    from photocal.run.exposures import FIGURES, ExposureFigures
    from photocal.run.project_checks import check_near, picture_places

    if exposures is None:
        check_near(project, control_points(project), picture_places(project))
    if project.contents.measurements is not None and exposures is not None:
        starts = read_images(exposures / "images.csv", project.cameras)
        # The orientations are start values: what was observed stands in positions.csv and attitudes.csv.
        starts = replace(starts, sigma=np.full_like(starts.sigma, np.inf))
        # Images that belong to no event: the exposures' summary warns of them.
        cameras = ExposureFigures.read(exposures / FIGURES).cameras
        unmatched = [name for camera in cameras for name in camera.unmatched_images + camera.ambiguous_images]
        block = given_block(project, starts, unmatched)
        MeasuredBlock(block, {"schema": SCHEMA, "kind": "given observations"}).write(folder)
        return
    from photocal.measurement.match_images import MatchingPlan
    from photocal.measurement.orientation import of_exposures
    from photocal.measurement.picture_block import measure_project

    oriented = None if exposures is None else of_exposures(project, exposures)
    measure_project(project, oriented, MatchingPlan(), show).write(folder)

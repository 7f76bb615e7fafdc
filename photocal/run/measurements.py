"""Stage `measurements`: tie points, targets and marks in the images, or observations that were given."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.errors import InputMalformedError
from photocal.block.folder import fingerprint, read_images, read_observations, read_points
from photocal.block.model import ROLES, Block, Images, ObjectPoints
from photocal.block.setup import ObservationKeys
from photocal.block.table import read_table
from photocal.project import Project
from photocal.run.stage import Progress, Stage

RECORD = "measurement.json"


def measurements_stage(project: Project, exposures: Path) -> Stage:
    """Describe the stage, which follows the one whose folder is `exposures`."""
    control, given = project.control, project.contents.measurements
    inputs = {"control points": control.points}
    if given is not None and given.observations is not None:
        inputs["observations"] = given.observations
    else:
        inputs["images"] = project.picture_folder
        if control.marks is not None and control.marks.exists():
            inputs["marks"] = control.marks
    settings = {
        "crs": project.crs,
        "height": project.height,
        "camera": [keys.model_dump(mode="json") for keys in project.contents.camera],
        "targets": None if control.targets is None else control.targets.model_dump(mode="json"),
        "sigma_px": None if given is None else given.sigma_px,
    }
    return Stage(
        "measurements",
        "points in the images",
        lambda out, show: _make(project, exposures, out, show),
        inputs,
        settings,
        (exposures,),
    )


def _make(project: Project, exposures: Path, folder: Path, show: Progress) -> None:
    from photocal.measurement.block_files import write_block

    starts = read_images(exposures / "images.csv", project.cameras)
    # The orientations are start values: what was observed stands in positions.csv and attitudes.csv.
    starts = replace(starts, sigma=np.full_like(starts.sigma, np.inf))
    if project.contents.measurements is not None:
        block = given_block(project, starts)
        write_block(folder, block, {"schema": "photocal.measurement/1", "kind": "given observations"})
        return
    from photocal.measurement.cache import default_cache
    from photocal.measurement.match_images import MatchingPlan
    from photocal.measurement.project_block import measure_project

    plan = MatchingPlan(default_cache(), os.cpu_count() or 1)
    measured = measure_project(project, starts, plan, show)
    write_block(folder, measured.block, measured.record)


def given_block(project: Project, images: Images) -> Block:
    """Make the block of given observations: points that the control table does not have are tie points.

    Parameters
    ----------
    project : Project
        With `observations` in `[measurements]`.
    images : Images
        With start values.

    Returns
    -------
    Block

    Raises
    ------
    InputMalformedError
        When the observations are of other images.
    """
    given = project.contents.measurements
    path = given.observations if given is not None and given.observations is not None else Path()
    control = read_points(project.control.points)
    table = read_table(path, ("image", "point", "x", "y"), ("sx", "sy"))
    named = table.names("point")[1]
    ties = tuple(sorted(set(named) - set(control.names)))
    unknown = sorted(set(table.names("image")[1]) - set(images.names))
    if unknown:
        raise InputMalformedError(
            f"image {unknown[0]} has no exposure" + (f", as {len(unknown) - 1} more" if unknown[1:] else ""),
            where=path,
            remedy="take its observations out, or complete the exposures",
        )
    count = len(ties)
    points = ObjectPoints(
        control.names + ties,
        np.vstack([control.values, np.full((count, 3), np.nan)]),
        np.vstack([control.sigma, np.full((count, 3), np.inf)]),
        np.concatenate([control.role, np.full(count, ROLES.index("tie"))]),
        None if control.cross is None else np.vstack([control.cross, np.zeros((count, 3))]),
    )
    sigma = None if given is None else given.sigma_px
    keys = ObservationKeys(unit="px", axes="pixel", sigma=sigma)
    return Block(
        project.name,
        project.crs,
        project.height,
        "control",
        (),
        project.cameras,
        images,
        points,
        read_observations(path, keys, images.names, points.names),
        (fingerprint(path.parent, path.name),),
    )

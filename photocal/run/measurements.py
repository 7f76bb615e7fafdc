"""Stage `measurements`: tie points, targets and marks in the images, or observations that were given."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.block.folder import read_images
from photocal.project import Project
from photocal.run.stage import Progress, Stage

RECORD = "measurement.json"
_UNMATCHED = ("unmatched_images", "ambiguous_images")


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
        if control.marks is not None and control.marks.exists():
            inputs["marks"] = control.marks
    settings = {
        "crs": project.crs,
        "height": project.height,
        "camera": [keys.model_dump(mode="json") for keys in project.contents.camera],
        "targets": [own.model_dump(mode="json") for own in control.targets],
        "sigma_px": None if given is None else given.sigma_px,
        "position_sigma_m": project.images.position_sigma_m,
    }
    return Stage(
        "measurements",
        "points in the images",
        lambda out, show: _make(project, exposures, out, show),
        inputs,
        settings,
        () if exposures is None else (exposures,),
    )


def pictures_of(project: Project) -> dict[str, Path]:
    """The pictures as inputs of a stage; their folder may hold the project, too."""
    from photocal.measurement.image_file import list_images

    return {f"image {path.name}": path for path in list_images(project.picture_folder)}


def _without_exposure(exposures: Path) -> list[str]:
    """Images of the project that belong to no event; the exposures' summary warns of them."""
    cameras = json.loads((exposures / "exposures.json").read_text(encoding="utf-8"))["cameras"]
    return [name for own in cameras for kind in _UNMATCHED for name in own[kind]]


def _make(project: Project, exposures: Path | None, folder: Path, show: Progress) -> None:
    from photocal.measurement.block_files import write_block
    from photocal.measurement.project_block import control_points
    from photocal.run.given_observations import given_block
    from photocal.run.project_checks import check_near, picture_places

    if exposures is None:
        check_near(project, control_points(project), picture_places(project))
    if project.contents.measurements is not None and exposures is not None:
        starts = read_images(exposures / "images.csv", project.cameras)
        # The orientations are start values: what was observed stands in positions.csv and attitudes.csv.
        starts = replace(starts, sigma=np.full_like(starts.sigma, np.inf))
        block = given_block(project, starts, _without_exposure(exposures))
        write_block(folder, block, {"schema": "photocal.measurement/1", "kind": "given observations"})
        return
    from acquire.operating_system import cache_folder
    from photocal.measurement.match_images import MatchingPlan
    from photocal.measurement.orientation import of_exposures
    from photocal.measurement.project_block import measure_project

    plan = MatchingPlan(cache_folder(), os.cpu_count() or 1)
    oriented = None if exposures is None else of_exposures(project, exposures)
    measured = measure_project(project, oriented, plan, show)
    write_block(folder, measured.block, measured.record)

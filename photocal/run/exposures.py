"""Stage `exposures`: antenna position and attitude of every exposure, matched to its image."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.errors import ConfigurationError, IllPosedError, InputNotFoundError
from photocal.project import Project
from photocal.run.measurements import pictures_of
from photocal.run.ppk import FIGURES as PPK_FIGURES
from photocal.run.ppk import TRAJECTORY, ppk_stage
from photocal.run.stage import Progress, Stage

if TYPE_CHECKING:
    from photocal.navigation.exposure_run import ExposureRun
    from photocal.navigation.rig import Rig
    from photocal.navigation.trajectory import Trajectory

FIGURES = "exposures.json"


def exposures_stage(project: Project, ppk: Path) -> Stage:
    """Describe the stage, which follows the one whose folder is `ppk`."""
    flight, images = project.flight, project.images
    inputs = {f"log {k + 1}": path for k, path in enumerate(flight.logs)}
    inputs |= {"images": images.times} if images.times is not None else pictures_of(project)
    settings = {
        "flight": flight.model_dump(
            mode="json", include={"vehicle", "rover", "base", "edge", "delay_s", "clock_offset_s"}
        ),
        "rig": project.rig.model_dump(mode="json"),
        "crs": project.crs,
        "height": project.height,
        "camera": project.camera.id,
    }
    return Stage(
        "exposures",
        "exposures and their images",
        lambda out, show: _make(project, ppk, out, show),
        inputs,
        settings,
        (ppk,),
    )


def _make(project: Project, ppk: Path, folder: Path, show: Progress) -> None:
    from photocal.navigation.exposure_files import (
        with_images,
        write_block_images,
        write_exposures,
        write_geo_txt,
    )
    from photocal.navigation.exposure_plot import plot_exposures
    from photocal.run.antenna_tables import write_attitudes, write_positions
    from photocal.run.trajectory_file import kept_trajectory

    trajectory = kept_trajectory(ppk / TRAJECTORY)
    figures_of_ppk = json.loads((ppk / PPK_FIGURES).read_text(encoding="utf-8"))
    with show("exposures and their images", None):
        run, rig = _placed(project, trajectory, figures_of_ppk)
    if not len(with_images(run.antenna)):
        raise IllPosedError(
            "no image has an exposure with a position",
            where=project.path,
            remedy="check clock_offset_s, the images and the log with `photocal exposures`",
        )
    write_exposures(folder / "exposures.csv", run.exposures)
    write_block_images(folder / "images.csv", run.exposures, project.camera.id, None, project.crs)
    write_geo_txt(folder / "geo.txt", run.exposures, rig)
    write_positions(folder / "positions.csv", run.antenna, project.crs)
    write_attitudes(folder / "attitudes.csv", run.antenna)
    (folder / FIGURES).write_text(json.dumps(run.figures, indent=2) + "\n", encoding="utf-8")
    plot_exposures(run, folder / "exposures.png")


def _placed(
    project: Project, trajectory: Trajectory | None, figures_of_ppk: dict[str, Any] | None
) -> tuple[ExposureRun, Rig]:
    from photocal.navigation.exposure_run import choices_of_project, place_exposures

    choices = choices_of_project(project)
    try:
        run = place_exposures(choices, trajectory, figures_of_ppk)
    except ConfigurationError:
        # Exposures without attitude, whose lever arm nothing turns: they stay at the antenna, which is
        # all that a block needs. Whatever else is wrong is said again.
        unturned = replace(choices, rig=replace(choices.rig, lever_m=None))
        run = place_exposures(unturned, trajectory, figures_of_ppk)
    return run, choices.rig


def exposures_of(project: Project, show: Progress) -> tuple[ExposureRun, Rig, str]:
    """Place the exposures of a project that may lack something: by PPK, else by what logs or pictures say.

    PPK is a stage of the project: it is not done again. The text says why it was not possible, if so.
    """
    from photocal.navigation.exposure_run import Choices, place_exposures
    from photocal.navigation.ppk_inputs import Sources
    from photocal.navigation.rig import Rig
    from photocal.run.digests import Digests
    from photocal.run.stage import made_in, update_stage
    from photocal.run.trajectory_file import kept_trajectory

    if project.contents.flight is None:
        choices = Choices(Sources(), project.picture_folder)
        return place_exposures(choices, None, None), Rig(), ""
    stage = ppk_stage(project)
    digests = Digests(project.output / ".digests.json")
    try:
        update_stage(stage, project.output, digests, show)
    except (ConfigurationError, IllPosedError, InputNotFoundError) as refusal:
        return *_placed(project, None, None), refusal.what
    finally:
        digests.keep()
    folder = made_in(project.output) / stage.name
    figures = json.loads((folder / PPK_FIGURES).read_text(encoding="utf-8"))
    return *_placed(project, kept_trajectory(folder / TRAJECTORY), figures), ""

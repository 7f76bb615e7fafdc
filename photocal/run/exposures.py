"""Stage `exposures`: antenna position and attitude of every exposure, matched to its image."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from photocal.base.codec import object_of, parsed_json
from photocal.base.errors import ConfigurationError, IllPosedError, InputNotFoundError
from photocal.base.files import write_json
from photocal.base.progress import Progress
from photocal.block.project import Project
from photocal.navigation.common_errors import CommonErrors
from photocal.run.ppk import FIGURES as PPK_FIGURES
from photocal.run.ppk import TRAJECTORY, ppk_stage
from photocal.run.stage import Stage, pictures_of

if TYPE_CHECKING:
    from photocal.navigation.exposure_run import ExposureRun
    from photocal.navigation.rig import CameraOnBody

# The exposures at the antenna.
FIGURES, EXPOSURES = "exposures.json", "exposures.parquet"


@dataclass(frozen=True)
class MatchedCamera:
    """How many images of a camera have an event, and which have none, or may have several."""

    matched: int
    unmatched_images: tuple[str, ...]
    ambiguous_images: tuple[str, ...]
    unmatched_events: tuple[int, ...]


@dataclass(frozen=True)
class ExposureFigures:
    """What later stages take from `exposures.json`; nothing in common without PPK."""

    events: int = 0
    placed: int = 0
    cameras: tuple[MatchedCamera, ...] = ()
    common: CommonErrors | None = None

    @classmethod
    def read(cls, path: Path) -> "ExposureFigures":
        """Read `exposures.json`; errors as of `photocal.base.codec.object_of`."""
        remedy = "compute the exposures again"
        return object_of(cls, parsed_json(path, remedy), path, remedy)


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
        plot_exposures,
        with_images,
        write_block_images,
        write_exposures,
        write_geo_txt,
    )

    with show("exposures and their images", None):
        run, rig = _placed(project, ppk)
    if not len(with_images(run.antenna)):
        raise IllPosedError(
            "no image has an exposure with a position",
            "check clock_offset_s, the images and the log with `photocal exposures`",
            where=project.path,
        )
    write_exposures(folder / "exposures.csv", run.exposures)
    write_block_images(folder / "images.csv", run.exposures, project.camera.id, None, project.crs)
    left_out = write_geo_txt(folder / "geo.txt", run.exposures, rig)
    run.antenna.write(folder / EXPOSURES)
    write_json(folder / FIGURES, {**run.figures, **({"geo_txt": left_out} if left_out else {})}, 2)
    plot_exposures(run, folder / "exposures.png")


def _placed(project: Project, ppk: Path | None) -> "tuple[ExposureRun, CameraOnBody]":
    """Exposures by the trajectory in a folder of PPK, or without one."""
    from photocal.navigation.exposure_run import choices_of_project, place_exposures
    from photocal.navigation.ppk_result import PpkFigures
    from photocal.navigation.trajectory import Trajectory

    choices = choices_of_project(project)
    trajectory = None if ppk is None else Trajectory.read(ppk / TRAJECTORY)
    figures_of_ppk = None if ppk is None else PpkFigures.read(ppk / PPK_FIGURES)
    try:
        run = place_exposures(choices, trajectory, figures_of_ppk)
    except ConfigurationError:
        # Exposures without attitude, whose lever arm nothing turns: they stay at the antenna, which is
        # all that a block needs. Whatever else is wrong is said again.
        unturned = replace(choices, rig=replace(choices.rig, lever_m=None))
        run = place_exposures(unturned, trajectory, figures_of_ppk)
    return run, choices.rig


def exposures_of(project: Project, show: Progress) -> "tuple[ExposureRun, CameraOnBody, str]":
    """Place the exposures of a project that may lack something: by PPK, else by what logs or pictures say.

    PPK is a stage of the project: it is not done again. The text says why it was not possible, if so.
    """
    from photocal.navigation.exposure_run import ExposureChoices, place_exposures
    from photocal.navigation.ppk_inputs import Sources
    from photocal.navigation.rig import CameraOnBody
    from photocal.run.stage import Digests, made_in, update_stage

    if project.contents.flight is None:
        return (
            place_exposures(ExposureChoices(Sources(), project.picture_folder), None, None),
            CameraOnBody(),
            "",
        )
    stage = ppk_stage(project)
    digests = Digests(project.output / ".digests.json")
    try:
        update_stage(stage, project.output, digests, show)
    except (ConfigurationError, IllPosedError, InputNotFoundError) as refusal:
        return *_placed(project, None), refusal.what
    finally:
        digests.keep()
    return *_placed(project, made_in(project.output) / stage.name), ""


def fixes_of_images(path: Path) -> dict[str, str] | None:
    """Whether the position of each image was fixed, float or single, by name; None without a flight."""
    from photocal.navigation.exposures import Exposures

    if not path.is_file():
        return None
    exposures = Exposures.read(path)
    return {
        name: str(status)
        for names, status in zip(exposures.images, exposures.placed.status, strict=True)
        for name in names
    }

"""Stage `exposures`: antenna position and attitude of every exposure, matched to its image."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.base.codec import object_of, parsed_json
from photocal.base.errors import ConfigurationError, IllPosedError, InputNotFoundError
from photocal.base.files import write_json, write_rows
from photocal.base.progress import Progress
from photocal.block.motion import strips
from photocal.block.mounting import ATTITUDE_COLUMNS, POSITION_COLUMNS, POSITION_EXTRAS, RATE_COLUMNS
from photocal.navigation.exposure_files import projected, with_images
from photocal.navigation.exposures import Exposures
from photocal.project import Project
from photocal.run.ppk import FIGURES as PPK_FIGURES
from photocal.run.ppk import TRAJECTORY, ppk_stage
from photocal.run.stage import Stage, pictures_of

if TYPE_CHECKING:
    from photocal.navigation.exposure_run import ExposureRun
    from photocal.navigation.rig import CameraOnBody
    from photocal.navigation.trajectory import Trajectory

FIGURES = "exposures.json"
# Of a rate between two attitudes of an autopilot, some hundredths of a second apart, deg/s.
_RATE_SIGMA = 2.0


@dataclass(frozen=True)
class MatchedCamera:
    """How many images of a camera have an event, and which have none, or may have several."""

    matched: int
    unmatched_images: tuple[str, ...]
    ambiguous_images: tuple[str, ...]
    unmatched_events: tuple[int, ...]


@dataclass(frozen=True)
class CommonSigmas:
    """What the errors of all positions have in common, see `navigation.common_errors.CommonErrors`."""

    shift_sigma_m: tuple[float, float, float]
    zenith_scale_sigma: float
    base_height_m: float


@dataclass(frozen=True)
class ExposureFigures:
    """What later stages take from `exposures.json`; nothing in common without PPK."""

    cameras: tuple[MatchedCamera, ...] = ()
    common: CommonSigmas | None = None


def read_figures(folder: Path) -> ExposureFigures:
    """Read `exposures.json` of the stage's folder."""
    path, remedy = folder / FIGURES, "make the exposures again"
    return object_of(ExposureFigures, parsed_json(path, remedy), path, remedy)


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
        write_block_images,
        write_exposures,
        write_geo_txt,
    )
    from photocal.run.ppk import kept_trajectory

    trajectory = kept_trajectory(ppk / TRAJECTORY)
    figures_of_ppk = parsed_json(ppk / PPK_FIGURES, "make the PPK again")
    with show("exposures and their images", None):
        run, rig = _placed(project, trajectory, figures_of_ppk)
    if not len(with_images(run.antenna)):
        raise IllPosedError(
            "no image has an exposure with a position",
            "check clock_offset_s, the images and the log with `photocal exposures`",
            where=project.path,
        )
    write_exposures(folder / "exposures.csv", run.exposures)
    write_block_images(folder / "images.csv", run.exposures, project.camera.id, None, project.crs)
    left_out = write_geo_txt(folder / "geo.txt", run.exposures, rig)
    write_positions(folder / "positions.csv", run.antenna, project.crs)
    write_attitudes(folder / "attitudes.csv", run.antenna)
    write_json(folder / FIGURES, {**run.figures, **({"geo_txt": left_out} if left_out else {})}, 2)
    plot_exposures(run, folder / "exposures.png")


def _placed(
    project: Project, trajectory: "Trajectory | None", figures_of_ppk: dict[str, Any] | None
) -> "tuple[ExposureRun, CameraOnBody]":
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


def exposures_of(project: Project, show: Progress) -> "tuple[ExposureRun, CameraOnBody, str]":
    """Place the exposures of a project that may lack something: by PPK, else by what logs or pictures say.

    PPK is a stage of the project: it is not done again. The text says why it was not possible, if so.
    """
    from photocal.navigation.exposure_run import ExposureChoices, place_exposures
    from photocal.navigation.ppk_inputs import Sources
    from photocal.navigation.rig import CameraOnBody
    from photocal.run.ppk import kept_trajectory
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
        return *_placed(project, None, None), refusal.what
    finally:
        digests.keep()
    folder = made_in(project.output) / stage.name
    figures = parsed_json(folder / PPK_FIGURES, "make the PPK again")
    return *_placed(project, kept_trajectory(folder / TRAJECTORY), figures), ""


def write_positions(path: Path, antenna: Exposures, crs: str) -> None:
    """Write where the antenna was."""
    rows = with_images(antenna)
    p = antenna.placed
    xyz, turn = projected(p.lat_deg[rows], p.lon_deg[rows], p.height_m[rows], crs)
    covariance = turn @ p.covariance_m2[rows] @ np.swapaxes(turn, 1, 2)
    velocity = np.einsum("nab,nb->na", turn, p.velocity_m_s[rows])
    strip, elapsed = strips((antenna.time.ns[rows] - antenna.time.ns[rows[0]]) / 1e9, velocity)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    lines = []
    for k, row in enumerate(rows.tolist()):
        cells = [f"{v:.4f}" for v in xyz[k]] + [f"{v:.5f}" for v in sigma[k]]
        cells += [f"{covariance[k][a, b]:.4e}" for a, b in ((0, 1), (0, 2), (1, 2))]
        cells += [f"{v:.4f}" for v in velocity[k]] + [f"strip {strip[k] + 1}", f"{elapsed[k]:.3f}"]
        lines += [[name, *cells] for name in antenna.images[row]]
    write_rows(path, (*POSITION_COLUMNS, *POSITION_EXTRAS), lines)


def write_attitudes(path: Path, antenna: Exposures) -> None:
    """Write how the vehicle was turned, degrees; exposures without attitude are left out."""
    lines = []
    for row in with_images(antenna).tolist():
        angles, sigma = antenna.angles[row], antenna.angle_sigma[row]
        if np.isfinite(angles).all():
            cells = [f"{v:.6f}" for v in np.degrees([*angles, *sigma])]
            rate = np.degrees(antenna.attitude.rate[row])
            cells += [f"{v:.4f}" for v in rate] + 3 * [f"{_RATE_SIGMA}"] if rate.any() else [""] * 6
            lines += [[name, *cells] for name in antenna.images[row]]
    write_rows(path, (*ATTITUDE_COLUMNS, *RATE_COLUMNS), lines)

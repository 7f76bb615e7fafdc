"""Where images are oriented and how well that is known, from whatever stage has come farthest."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.block.folder import read_images
from photocal.block.model import Images
from photocal.geometry.camera import PARAMETERS, Camera, camera
from photocal.geometry.frames import Frame, ShiftedFrame, reference_frame
from photocal.measurement.views import Views, local_poses
from photocal.project import Project

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Orientation:
    """Images in the coordinates of the points, oriented as well as is known.

    Attributes
    ----------
    cameras : tuple of Camera
    images : Images
        Values are NaN where unknown, sigmas infinite where nothing is said of them.
    frame, height : str
        System of the coordinates, "local" among them, and kind of the heights.
    source : str
        Where this comes from, for people.
    """

    cameras: tuple[Camera, ...]
    images: Images
    frame: str
    height: str
    source: str

    def to_local(self, points: Floats) -> Frame:
        """Give the Cartesian frame about the middle of images and points, shape (n, 3)."""
        middle = np.nanmean(np.vstack([self.images.values[:, 3:], points]), axis=0)
        if self.frame == "local":
            return ShiftedFrame(middle)
        return reference_frame(self.frame, self.height, middle)

    def views(self, frame: Frame) -> Views:
        """Give the images in a local frame; NaN where they are not oriented."""
        from photocal.geometry.rotation import matrix_from_angles

        poses = local_poses(frame, self.images.values)
        return Views(self.cameras, self.images.camera, matrix_from_angles(poses[:, :3]), poses[:, 3:])


def of_run(run: Path) -> Orientation:
    """Read the orientation that an adjustment found.

    Parameters
    ----------
    run : Path
        Run folder of `photocal adjust`.

    Returns
    -------
    Orientation

    Raises
    ------
    InputNotFoundError, InputMalformedError
        When it is no run folder.
    """
    result = run / "result.json"
    if not result.is_file():
        raise InputNotFoundError("does not exist", where=result, remedy="name the folder of an adjustment")
    try:
        content = json.loads(result.read_text(encoding="utf-8"))
        cameras = tuple(_camera(name, entry) for name, entry in content["cameras"].items())
        frame, height = str(content["block"]["frame"]), str(content["block"]["height"])
    except (ValueError, KeyError, TypeError, AttributeError) as failure:
        raise InputMalformedError(
            f"does not hold the cameras of an adjustment ({type(failure).__name__}: {failure})",
            where=result,
            remedy="adjust the block again",
        ) from failure
    return Orientation(cameras, read_images(run / "images.csv", cameras), frame, height, "adjustment")


def _camera(name: str, entry: dict[str, Any]) -> Camera:
    pitch = entry["pitch_mm"] or (1.0, 1.0)
    values = {parameter: entry["parameters"][parameter]["value"] for parameter in PARAMETERS}
    width, height = entry["size_px"]
    return replace(
        camera(name, entry["model"], entry["unit"], (width, height), (pitch[0], pitch[1]), values),
        reference_radius=float(entry["reference_radius"]),
        affinity=entry["affinity"],
        affinity_form=entry["affinity_form"],
    )


def of_project(project: Project, names: tuple[str, ...]) -> Orientation | None:
    """Give what is known of a project's images: adjusted, or as the flight log has them.

    Parameters
    ----------
    project : Project
    names : tuple of str
        Of its pictures.

    Returns
    -------
    Orientation or None
        None without a camera: nothing can be said then, whatever is known of the images.
    """
    adjusted, exposures = project.output / "calibration", project.output / "exposures" / "images.csv"
    if (adjusted / "result.json").is_file():
        return of_run(adjusted)
    if not project.cameras:
        return None
    if exposures.is_file():
        images, source = _with_boresight(project, read_images(exposures, project.cameras)), "exposures"
    else:
        count = len(names)
        nothing = np.full((count, 6), np.nan)
        images = Images(names, np.zeros(count, np.int64), nothing, np.full((count, 6), np.inf))
        source = "nothing yet"
    return Orientation(project.cameras, images, project.crs, project.height, source)


def _with_boresight(project: Project, images: Images) -> Images:
    """Let angles of the body be as unsure, as angles of the camera, as the boresight is."""
    rig = project.contents.rig
    if rig is None or rig.boresight_sigma_deg == "free":
        return images
    sigma = images.sigma.copy()
    sigma[:, :3] = np.hypot(sigma[:, :3], np.radians(np.broadcast_to(rig.boresight_sigma_deg, 3)))
    return replace(images, sigma=sigma)

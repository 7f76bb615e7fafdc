"""Where images are oriented and how well that is known, from whatever stage has come farthest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from photocal.block.folder import read_images
from photocal.geometry.frames import Frame, ShiftedFrame, reference_frame
from photocal.geometry.oriented_images import OrientedImages
from photocal.project import Project
from photocal.results.folder import RESULT, image_covariances, read_result


@dataclass(frozen=True)
class Orientation:
    """Images in the coordinates of the points, oriented as well as is known.

    frame, height: system of the coordinates, "local" among them, and kind of the heights.
    source: where this comes from, for people.
    """

    images: OrientedImages
    frame: str
    height: str
    source: str

    def to_local(self, points: Floats) -> Frame:
        """Give the Cartesian frame about the middle of images and points, shape (n, 3)."""
        middle = np.nanmean(np.vstack([self.images.station, points]), axis=0)
        if self.frame == "local":
            return ShiftedFrame(middle)
        return reference_frame(self.frame, self.height, middle)


def of_run(run: Path) -> Orientation:
    """Read the orientation that an adjustment found."""
    result = read_result(run)
    return Orientation(result.images, result.block.frame, result.block.height, "adjustment")


def of_project(project: Project, names: tuple[str, ...]) -> Orientation | None:
    """Give what is known of a project's images: adjusted, or as the flight log has them."""
    adjusted, exposures = project.output / "calibration", project.output / "exposures"
    if (adjusted / RESULT).is_file():
        return of_run(adjusted)
    if not project.cameras:
        return None
    if (exposures / "images.csv").is_file():
        return of_exposures(project, exposures)
    count = len(names)
    images = OrientedImages(names, project.cameras, np.zeros(count, np.int64), np.full((count, 6), np.nan))
    return Orientation(images, project.crs, project.height, "nothing yet")


def of_exposures(project: Project, folder: Path) -> Orientation:
    """Read how images are oriented by the flight log.

    The covariances of the attitudes hold how unsure the boresight is.

    raises InputNotFoundError, InputMalformedError.
    """
    images = read_images(folder / "images.csv", project.cameras)
    known = np.where(np.isfinite(images.sigma), images.sigma, np.nan)
    boresight = np.diag(np.r_[_boresight_sigma(project), 0, 0, 0] ** 2)
    covariance = image_covariances(folder, images.names, known) + boresight
    oriented = OrientedImages(images.names, project.cameras, images.camera, images.values, covariance)
    return Orientation(oriented, project.crs, project.height, "exposures")


def _boresight_sigma(project: Project) -> Floats:
    """How unsure the camera's attitude is beyond that of the body, radians, shape (3,)."""
    rig = project.contents.rig
    if rig is None or rig.boresight_sigma_deg == "free":
        return np.zeros(3)
    return np.asarray(np.radians(np.broadcast_to(rig.boresight_sigma_deg, 3)), dtype=np.float64)

"""Where images are oriented and how well that is known, from whatever stage has come farthest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from photocal.block.folder import read_images
from photocal.block.model import Images
from photocal.geometry.camera import Camera
from photocal.geometry.frames import Frame, ShiftedFrame, reference_frame
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.views import Views, local_poses
from photocal.project import Project
from photocal.results.folder import image_covariances, read_result

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Orientation:
    """Images in the coordinates of the points, oriented as well as is known.

    Attributes
    ----------
    images : Images
        Values are NaN where unknown, sigmas infinite where nothing is said of them.
    frame, height : str
        System of the coordinates, "local" among them, and kind of the heights.
    source : str
        Where this comes from, for people.
    covariance : ndarray, shape (m, 6, 6)
        Of the values of the images (rad, m): position and attitude of an adjusted image are correlated
        strongly. NaN where nothing is said.
    """

    cameras: tuple[Camera, ...]
    images: Images
    frame: str
    height: str
    source: str
    covariance: Floats

    def to_local(self, points: Floats) -> Frame:
        """Give the Cartesian frame about the middle of images and points, shape (n, 3)."""
        middle = np.nanmean(np.vstack([self.images.values[:, 3:], points]), axis=0)
        if self.frame == "local":
            return ShiftedFrame(middle)
        return reference_frame(self.frame, self.height, middle)

    def views(self, frame: Frame) -> Views:
        """Give the images in a local frame; NaN where they are not oriented."""
        poses = local_poses(frame, self.images.values)
        return Views(self.cameras, self.images.camera, matrix_from_angles(poses[:, :3]), poses[:, 3:])


def of_run(run: Path) -> Orientation:
    """Read the orientation that an adjustment found."""
    result = read_result(run)
    images = result.images
    held = np.where(np.isfinite(images.sigma), images.sigma, np.inf)
    return Orientation(
        images.cameras,
        Images(images.names, images.camera, images.values, held),
        result.block.frame,
        result.block.height,
        "adjustment",
        np.full((len(images), 6, 6), np.nan) if images.covariance is None else images.covariance,
    )


def of_project(project: Project, names: tuple[str, ...]) -> Orientation | None:
    """Give what is known of a project's images: adjusted, or as the flight log has them."""
    adjusted, exposures = project.output / "calibration", project.output / "exposures"
    if (adjusted / "result.json").is_file():
        return of_run(adjusted)
    if not project.cameras:
        return None
    if (exposures / "images.csv").is_file():
        return of_exposures(project, exposures)
    count = len(names)
    images = Images(
        names, np.zeros(count, np.int64), np.full((count, 6), np.nan), np.full((count, 6), np.inf)
    )
    covariance = np.full((count, 6, 6), np.nan)
    return Orientation(project.cameras, images, project.crs, project.height, "nothing yet", covariance)


def of_exposures(project: Project, folder: Path) -> Orientation:
    """Read how images are oriented by the flight log.

    Parameters
    ----------
    folder : Path
        That `photocal exposures` made.

    Returns
    -------
    Orientation
        The sigmas of the attitudes hold how unsure the boresight is.

    Raises
    ------
    InputNotFoundError, InputMalformedError
    """
    images = read_images(folder / "images.csv", project.cameras)
    boresight = _boresight_sigma(project)
    known = np.where(np.isfinite(images.sigma), images.sigma, np.nan)
    covariance = image_covariances(folder, images.names, known) + np.diag(np.r_[boresight, 0, 0, 0] ** 2)
    sigma = images.sigma.copy()
    sigma[:, :3] = np.hypot(sigma[:, :3], boresight)
    return Orientation(
        project.cameras,
        replace(images, sigma=sigma),
        project.crs,
        project.height,
        "exposures",
        covariance,
    )


def _boresight_sigma(project: Project) -> Floats:
    """How unsure the camera's attitude is beyond that of the body, radians, shape (3,)."""
    rig = project.contents.rig
    if rig is None or rig.boresight_sigma_deg == "free":
        return np.zeros(3)
    return np.asarray(np.radians(np.broadcast_to(rig.boresight_sigma_deg, 3)), dtype=np.float64)

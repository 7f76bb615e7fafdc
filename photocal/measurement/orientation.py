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
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.views import Views, local_poses
from photocal.project import Project

Floats = NDArray[np.float64]

# As in `Images`; tables have degrees.
_ORDER = ("omega", "phi", "kappa", "X", "Y", "Z")
_UNITS = np.array([*np.radians(np.ones(3)), 1.0, 1.0, 1.0])


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
    images = read_images(run / "images.csv", cameras)
    return Orientation(cameras, images, frame, height, "adjustment", _covariance(images, run))


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
    covariance = _covariance(images, folder) + np.diag(np.r_[boresight, 0, 0, 0] ** 2)
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


def _covariance(images: Images, folder: Path) -> Floats:
    """Covariances of exterior orientations: whole where the folder has them, else the sigmas squared."""
    variance = np.where(np.isfinite(images.sigma), images.sigma, np.nan) ** 2
    covariance = variance[:, :, None] * np.eye(6)
    table = folder / "covariance.parquet"
    if not table.is_file():
        return np.asarray(covariance)
    row = {name: k for k, name in enumerate(images.names)}
    for entry in _rows(table):
        k = row.get(entry["id"]) if entry["kind"] == "image" else None
        if k is None or sorted(entry["names"]) != sorted(_ORDER):
            continue
        lower = np.zeros((6, 6))
        lower[np.tril_indices(6)] = entry["lower"]
        whole = lower + np.tril(lower, -1).T
        order = [entry["names"].index(name) for name in _ORDER]
        covariance[k] = whole[np.ix_(order, order)] * np.outer(_UNITS, _UNITS)
    return np.asarray(covariance)


def _rows(path: Path) -> list[dict[str, Any]]:
    """Read the rows of `covariance.parquet`; InputMalformedError when it is none."""
    import pyarrow as pa
    import pyarrow.parquet

    try:
        rows: list[dict[str, Any]] = pyarrow.parquet.read_table(
            path, columns=["kind", "id", "names", "lower"], filters=[("kind", "==", "image")]
        ).to_pylist()
    except (pa.ArrowException, OSError) as failure:
        raise InputMalformedError(
            f"is no table of covariances ({str(failure).splitlines()[0]})",
            where=path,
            remedy="make the folder again",
        ) from failure
    return rows

"""Calibrations as bundles of rays, and the four ways of comparing two of them, each as a misfit on a grid."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from photocal.analysis.estimates import estimates_of
from photocal.base.arrays import Floats
from photocal.base.checked_toml import Table
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.geometry.camera import PARAMETERS, Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.rotation import matrix_from_angles


@dataclass(frozen=True)
class IdealImage:
    """Where a calibration places pixels: the ideal image of its rays.

    ideal (n, 2): image coordinates free of distortion, from the principal point, x right, y up, px.
    """

    ideal: Floats
    c: float


def sensor_grid(size_px: tuple[int, int], step_px: float | None = None) -> Floats:
    """Spread a regular grid of pixels over the format.

    step_px: distance of the grid points; 100 px unless the image is so small that fewer than 20 columns of
        points would fit. The first point stands half a step from the upper left.
    returns (n, 2): column and row of each point, px.

    With 100 px on 4608 x 3456 this is the grid of the Canon ELPH study: 46 x 35 points from (50, 50).
    """
    width, height = size_px
    step = min(100.0, width / 20.0) if step_px is None else step_px
    columns, rows = np.arange(step / 2, width, step), np.arange(step / 2, height, step)
    return np.column_stack([m.ravel() for m in np.meshgrid(columns, rows)])


def view(camera: Camera, pixels: Floats) -> IdealImage:
    """Correct pixels by a calibration."""
    plane = pixel_to_plane(camera.size_px, camera.pitch, pixels)
    ideal = undistorted(camera, plane) / camera.pitch[0]
    if not np.all(np.isfinite(ideal)):
        column, row = pixels[np.flatnonzero(~np.all(np.isfinite(ideal), axis=1))[0]]
        raise IllPosedError(
            f"the distortion folds within the image, pixel ({column:g}, {row:g}) has no ray",
            "check sign and unit of the coefficients, and the direction of the model",
            where=f"camera {camera.id}",
        )
    return IdealImage(ideal, camera.value("c") / camera.pitch[0])


def wobble(camera: Camera, pixels: Floats) -> tuple[IdealImage, ...] | None:
    """Change of a view for each independent unit normal variable of a calibration; None without sigmas."""
    known = estimates_of(camera)
    if known is None:
        return None
    # The factor of the correlation matrix, by its eigenvalues: rounded correlations may leave it a
    # little indefinite, which a Cholesky factor would not survive.
    eigenvalues, vectors = np.linalg.eigh(known.correlation)
    factor = known.sigmas[:, None] * vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    ideal, c = [], []
    for name, sigma in zip(known.names, known.sigmas, strict=True):
        step = sigma * np.eye(len(PARAMETERS))[PARAMETERS.index(name)]
        above, below = (view(camera.with_values(camera.values + sign * step), pixels) for sign in (1.0, -1.0))
        ideal.append((above.ideal - below.ideal) / (2.0 * sigma))
        c.append((above.c - below.c) / (2.0 * sigma))
    changes = np.tensordot(factor.T, np.array(ideal), axes=1)
    return tuple(IdealImage(d, float(dc)) for d, dc in zip(changes, factor.T @ np.array(c), strict=True))


Misfit = Callable[[IdealImage, IdealImage, Floats], Floats]


@dataclass(frozen=True)
class Method:
    """One definition of likeness.

    name: "MIS", "ZROT", "ROT" or "SPR".
    definition: what distinguishes it from the other definitions of the same name.
    source: "equations": as the study defines it; "tables": as its printed figures were computed; "both".
    pose_size: number of free elements of the pose.
    mean_distance: whether the figure is the mean length of the misfit instead of its root mean square.
    misfits: the misfit, one for each terrain where there are terrains.
    """

    name: str
    definition: str
    source: str
    pose_size: int
    mean_distance: bool
    misfits: tuple[Misfit, ...] = field(repr=False)


class ResectionGround(Table):
    """Ground for the single photo resection.

    height_m: height of the exposure over the lowest ground.
    relief_m: heights of the ground are spread evenly from 0 to this.
    """

    height_m: PositiveFloat
    relief_m: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]

    @model_validator(mode="after")
    def _below_the_exposure(self) -> Self:
        if self.relief_m >= self.height_m:
            raise ValueError(
                f"relief of {self.relief_m:g} m reaches the exposure at {self.height_m:g} m; "
                "give a height_m above the highest ground"
            )
        return self


def misclosure_misfit(first: IdealImage, second: IdealImage, _pose: Floats) -> Floats:
    """Same centre, same principal distance, no rotation (equation 14 of the Canon ELPH study)."""
    return second.ideal - first.ideal


def zero_rotation_misfit(first: IdealImage, second: IdealImage, _pose: Floats) -> Floats:
    """Same centre, no rotation: set II scaled onto the plane of set I (equation 16)."""
    return second.ideal * (first.c / second.c) - first.ideal


def rotation_misfit(first: IdealImage, second: IdealImage, pose: Floats) -> Floats:
    """Same centre, free rotation, each with its principal distance (equations 17 to 19)."""
    return _imaged(second.ideal, second.c, pose, first.c) - first.ideal


def common_rotation_misfit(first: IdealImage, second: IdealImage, pose: Floats) -> Floats:
    """Same centre, free rotation, the principal distance of set I for both: so the tables were made."""
    return _imaged(second.ideal, first.c, pose, first.c) - first.ideal


def resection_misfit(heights: Floats) -> Misfit:
    """Make the misfit of the single photo resection over given ground."""

    def misfit(first: IdealImage, second: IdealImage, pose: Floats) -> Floats:
        """Ground of the first view in the second image at a pose, less where the second one sees it."""
        ground = np.column_stack([first.ideal / first.c, -np.ones(len(heights))]) * heights[:, None]
        rays = (ground - pose[3:]) @ matrix_from_angles(pose[:3]).T
        return np.asarray(-second.c * rays[:, :2] / rays[:, 2:] - second.ideal)

    return misfit


def methods(
    points: int, terrains: tuple[ResectionGround, ...], repeats: int, seed: int
) -> tuple[Method, ...]:
    """List every method with every definition."""
    fixed = (
        Method("MIS", "root mean square", "equations", 0, False, (misclosure_misfit,)),
        Method("MIS", "mean distance", "tables", 0, True, (misclosure_misfit,)),
        Method("ZROT", "root mean square", "equations", 0, False, (zero_rotation_misfit,)),
        Method("ZROT", "mean distance", "tables", 0, True, (zero_rotation_misfit,)),
        Method("ROT", "two principal distances", "equations", 3, False, (rotation_misfit,)),
        Method("ROT", "one principal distance", "tables", 3, False, (common_rotation_misfit,)),
    )
    generator = np.random.default_rng(seed)
    resections = []
    for terrain in terrains:
        ratio, name = terrain.relief_m / terrain.height_m, f"relief {terrain.relief_m:g} m"
        grounds = (1.0 - ratio * generator.random(points) for _ in range(repeats))
        misfits = tuple(resection_misfit(heights) for heights in grounds)
        resections.append(Method("SPR", name, "both", 6, False, misfits))
    return (*fixed, *resections)


def fitted_pose(
    method: Method, misfit: Misfit, first: IdealImage, second: IdealImage
) -> tuple[Floats, Floats]:
    """Find the pose of least misfit, and the derivatives of the misfit there."""
    pose = pose_of(method, misfit, first, second)
    return pose, _design(misfit, first, second, pose)


def step_of(method: Method, misfit: Misfit, first: IdealImage) -> Floats:
    """Give what turns a small misfit into minus a step of the pose: for views that are nearly alike."""
    return np.asarray(np.linalg.pinv(_design(misfit, first, first, np.zeros(method.pose_size))))


def pose_of(
    method: Method, misfit: Misfit, first: IdealImage, second: IdealImage, known: Floats | None = None
) -> Floats:
    """Find the pose of least misfit.

    known: of `step_of`, where the views are nearly alike.
    """
    # Steps of a pose below this (rad, or heights of the exposure) shrink by as much from one to the next.
    shrinking = 1e-3
    pose, step, before = np.zeros(method.pose_size), known, np.inf
    if method.pose_size == 0:
        return pose
    for _ in range(30):
        # Steps that shrink this fast need no new derivatives.
        if step is None or shrinking < before < np.inf:
            step = np.asarray(np.linalg.pinv(_design(misfit, first, second, pose)), dtype=np.float64)
        change = -step @ misfit(first, second, pose).ravel()
        if not np.all(np.isfinite(change)):
            break
        pose, before = pose + change, float(np.max(np.abs(change)))
        if before < 1e-10:
            return pose
    raise NotConvergedError(
        f"the two bundles cannot be brought together by method {method.name}",
        "check that both cameras have the same format, unit and sign of the distortion",
    )


def figure(method: Method, misfit_px: Floats) -> Floats:
    """Condense misfits into the figure of a method.

    Without a pose the root mean square is that of the distances, sqrt(sum(dx^2 + dy^2) / n); with a pose it
    is the standard deviation of unit weight of a coordinate, sqrt(v'v / (2n - k)), as in the study.
    """
    squares = np.sum(misfit_px**2, axis=-1)
    if method.mean_distance:
        return np.asarray(np.mean(np.sqrt(squares), axis=-1))
    return np.asarray(np.sqrt(np.sum(squares, axis=-1) / redundancy(method, misfit_px.shape[-2])))


def redundancy(method: Method, points: int) -> int:
    """Give the divisor of the sum of squares: 2n - k with a pose, n (distances) without."""
    return 2 * points - method.pose_size if method.pose_size else points


def _imaged(ideal: Floats, c: float, pose: Floats, c_of_plane: float) -> Floats:
    rays = np.column_stack([ideal, np.full(len(ideal), -c)]) @ matrix_from_angles(pose).T
    return np.asarray(-c_of_plane * rays[:, :2] / rays[:, 2:])


def _design(misfit: Misfit, first: IdealImage, second: IdealImage, pose: Floats) -> Floats:
    step = 1e-5
    columns = [
        (misfit(first, second, pose + move) - misfit(first, second, pose - move)).ravel() / (2.0 * step)
        for move in step * np.eye(len(pose))
    ]
    return np.column_stack(columns) if columns else np.zeros((2 * len(first.ideal), 0))

"""Where images are oriented and how well that is known, from whatever stage has come farthest."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import ndtr

from photocal.base.arrays import Flags, Floats
from photocal.block.folder import read_images
from photocal.block.project import Project
from photocal.block.results.folder import RESULT, image_covariances, read_result
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.frames import UNSTATED, LocalFrame, ShiftedFrame, reference_frame
from photocal.geometry.oriented_images import OrientedImages


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

    def to_local(self, points: Floats) -> LocalFrame:
        """Give the Cartesian frame about the middle of images and points, shape (n, 3)."""
        middle = np.nanmean(np.vstack([self.images.station, points]), axis=0)
        if self.frame == "local":
            return ShiftedFrame(middle)
        return reference_frame(self.frame, self.height, middle)


def of_run(run: Path) -> Orientation:
    """Read the orientation that an adjustment found."""
    result = read_result(run)
    # Adjusted heights are of the same kind as those of the points: no GNSS measurement is given with them.
    height = UNSTATED if result.block.height == "orthometric" else result.block.height
    return Orientation(result.images, result.block.frame, height, "adjustment")


def of_project(project: Project, names: tuple[str, ...]) -> Orientation | None:
    """Give what is known of a project's images: adjusted, or as the flight log has them."""
    adjusted, exposures = project.output / "calibration", project.output / "exposures"
    if (adjusted / RESULT).is_file():
        found = of_run(adjusted)
        # A block that nothing places says nothing of where surveyed points are shown.
        if found.frame == project.crs:
            return found
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
    rig = project.contents.rig
    unsure = 0.0 if rig is None or rig.boresight_sigma_deg == "free" else rig.boresight_sigma_deg
    boresight = np.diag(np.r_[np.radians(np.broadcast_to(unsure, 3)), 0, 0, 0] ** 2)
    covariance = image_covariances(folder, images.names, known) + boresight
    oriented = OrientedImages(images.names, project.cameras, images.camera, images.values, covariance)
    return Orientation(oriented, project.crs, project.height, "exposures")


# 95 percent of a plane normal distribution lie within this many standard deviations.
WITHIN_95 = math.sqrt(5.991464547107979)
_STEPS = np.array([1e-5, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2])


@dataclass(frozen=True)
class Prediction:
    """A point in the images.

    pixels (m, 2): columns and rows; NaN where the image is not oriented or cannot see that way.
    covariance (m, 2, 2): px squared; NaN where nothing is said of how well the image is oriented.
    probability (m,): that the point lies within the image; NaN where it is not oriented. Nothing is known of
        what may stand before the point.
    slope (m, 2, 3): how columns and rows change with the point, px/m; local axes, the third one up.
    """

    pixels: Floats
    covariance: Floats
    probability: Floats
    slope: Floats


def predict(orientation: Orientation, xyz: Floats, sigma: Floats) -> Prediction:
    """Predict where images show a point.

    Errors are carried over from position and attitude of the image, from the parameters of its camera that
    have an a priori sigma, and from the coordinates of the point (law of propagation of errors).
    """
    frame = orientation.to_local(xyz[None])
    point = frame.to_local(xyz[None])[0]
    views = orientation.images.in_local(frame)
    poses, count = views.values, len(views)
    image = np.arange(count)

    def seen(moved: Floats, place: Floats, views: OrientedImages) -> Floats:
        """Project a place with poses moved by small amounts."""
        return replace(views, values=moved).project(image, np.broadcast_to(place, (count, 3)))

    pixels = seen(poses, point, views)
    away = ~_before(views, point)
    pixels[away] = np.nan
    slopes = np.empty((count, 2, 6))
    for k, step in enumerate(_STEPS):
        ahead, behind = poses.copy(), poses.copy()
        ahead[:, k] += step
        behind[:, k] -= step
        slopes[:, :, k] = (seen(ahead, point, views) - seen(behind, point, views)) / (2 * step)
    covariance = slopes @ orientation.images.covariances @ np.swapaxes(slopes, 1, 2)
    moved = np.empty((count, 2, 3))
    for k, step in enumerate(1e-2 * np.eye(3)):
        moved[:, :, k] = (seen(poses, point + step, views) - seen(poses, point - step, views)) / 2e-2
        covariance += _spread(moved[:, :, k], np.full(count, sigma[k] if np.isfinite(sigma[k]) else 0.0))
    for ahead_views, behind_views, size in _camera_steps(views):
        slope = (seen(poses, point, ahead_views) - seen(poses, point, behind_views)) / 2
        # The cameras were moved by a standard deviation: the slope is in px.
        covariance += _spread(slope, size[views.camera])
    probability = _within(pixels, covariance, views.sizes())
    probability[away & np.isfinite(poses).all(axis=1)] = 0
    return Prediction(pixels, covariance, probability, moved)


def ellipse(covariance: Floats) -> dict[str, float] | None:
    """Give the error ellipse of 95 percent of a covariance, shape (2, 2); None where it is not known.

    returns: semi-axes `major` and `minor` in px, and `direction` of the first from columns to rows, radians.
    """
    if not np.isfinite(covariance).all():
        return None
    values, vectors = np.linalg.eigh(covariance)
    minor, major = np.sqrt(np.maximum(values, 0)) * WITHIN_95
    direction = np.arctan2(vectors[1, 1], vectors[0, 1])
    return {"major": float(major), "minor": float(minor), "direction": float(direction)}


def _spread(slope: Floats, sigma: Floats) -> Floats:
    moved = slope * sigma[:, None]
    return np.asarray(moved[:, :, None] * moved[:, None, :])


def _camera_steps(views: OrientedImages) -> list[tuple[OrientedImages, OrientedImages, Floats]]:
    """Views with a parameter moved by its a priori sigma ahead and back, and which cameras were moved."""
    steps = []
    prior = np.array(
        [
            np.where(camera.estimated & np.isfinite(camera.prior_sigma), camera.prior_sigma, 0)
            for camera in views.cameras
        ]
    )
    for k in np.flatnonzero(prior.any(axis=0)):
        move = np.where(np.arange(len(PARAMETERS)) == k, prior, 0)
        ahead, behind = (
            tuple(
                camera.with_values(camera.values + sign * by)
                for camera, by in zip(views.cameras, move, strict=True)
            )
            for sign in (1, -1)
        )
        steps.append(
            (replace(views, cameras=ahead), replace(views, cameras=behind), (prior[:, k] > 0).astype(float))
        )
    return steps


def _before(views: OrientedImages, point: Floats) -> Flags:
    """Whether images look towards a point, near enough to their field of view."""
    q = np.einsum("nij,nj->ni", views.rotation, point - views.station)
    c = np.array([camera.value("c") / camera.pitch[0] for camera in views.cameras])[views.camera]
    with np.errstate(divide="ignore", invalid="ignore"):
        aside = c * np.hypot(q[:, 0], q[:, 1]) / -q[:, 2]
    # Polynomials of distortion fold far outside of the image: what a lens without them would show farther out
    # than this many half diagonals is not seen.
    farthest = 1.25
    return np.asarray((q[:, 2] < 0) & (aside < farthest * np.hypot(*views.sizes().T) / 2))


def _within(pixels: Floats, covariance: Floats, sizes: Floats) -> Floats:
    """Probability that a point lies within its image, taking column and row as independent."""
    low, high = -0.5 - pixels, sizes - 0.5 - pixels
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    sharp = np.where(np.isfinite(sigma), np.maximum(sigma, 1e-6), 1e-6)
    with np.errstate(over="ignore"):
        inside = (ndtr(high / sharp) - ndtr(low / sharp)).prod(axis=1)
    return np.asarray(inside)

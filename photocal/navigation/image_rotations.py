"""Rotations between neighbouring images by matched points, against those of the recorded attitudes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.relative_orientation import RelativeOrientation, relative_orientations
from photocal.measurement.match_images import MatchingPlan, detect_all, match_all
from photocal.measurement.start_camera import principal_distance_px, start_camera
from photocal.navigation.exposures import Exposures, orientations
from photocal.navigation.image_metadata import ImageMetadata
from photocal.navigation.rig import Rig
from photocal.navigation.rotation_check import PairRotation, least_turn, places_of

Floats = NDArray[np.float64]
Progress = Callable[[str, float | None], AbstractContextManager[Callable[[float], None]]]
_LEAST_POINTS = 30
# Relative orientations whose sum of squares is within 5 % are not told apart by the points.
_AS_GOOD = 1.05


@dataclass(frozen=True)
class Neighbours:
    """How neighbouring images are matched.

    Parameters
    ----------
    plan : MatchingPlan
        Cache, processes, settings.
    progress : callable
        Shows a bar for a title and an amount of work.
    camera : Camera or None
        Calibration; None: principal distance from the EXIF, no distortion.
    """

    plan: MatchingPlan
    progress: Progress
    camera: Camera | None = None


def compare_rotations(
    exposures: Exposures,
    images: list[ImageMetadata],
    rig: Rig,
    how: Neighbours,
) -> list[PairRotation]:
    """Match every image with its follower and compare their relative rotations.

    Parameters
    ----------
    exposures : Exposures
        With attitudes.
    images : list of ImageMetadata
        Their images, with files.
    rig : Rig
        From body to camera axes.
    how : Neighbours
        How they are matched.

    Returns
    -------
    list of PairRotation
        Of pairs with enough matched points. The rotation is refined by least squares of the distances from
        the epipolar lines (Sampson's; Hartley and Zisserman 2004, eq. 11.9) with a robust loss.
    """
    by_name = {image.name: image for image in images if image.path is not None}
    rows = [
        row for row, name in enumerate(exposures.image) if name in by_name and exposures.attitude.known[row]
    ]
    paths = [path for row in rows if (path := by_name[exposures.image[row]].path) is not None]
    with how.progress("detecting features", len(paths)) as done:
        keys, reasons = detect_all(paths, how.plan, done)
    pairs = np.array([(i, i + 1) for i in range(len(rows) - 1) if not reasons[i] and not reasons[i + 1]])
    pairs = pairs.reshape(-1, 2).astype(np.int64)
    with how.progress("matching neighbours", len(pairs)) as done:
        tracks, _ = match_all(keys, pairs, how.plan, done)
    recorded = orientations(exposures, rig).rotation
    place = places_of(exposures)
    found = []
    for i, j in pairs.tolist():
        a, b = rows[i], rows[j]
        left, right = tracks.image == i, tracks.image == j
        _, at, to = np.intersect1d(tracks.track[left], tracks.track[right], return_indices=True)
        if len(at) < _LEAST_POINTS:
            continue
        first, second = (
            _rays(by_name[exposures.image[row]], how.camera, pixels)
            for row, pixels in ((a, tracks.pixels[left][at]), (b, tracks.pixels[right][to]))
        )
        base = recorded[a] @ (place[b] - place[a])
        pair = _pair(first, second, recorded[b] @ recorded[a].T, base / np.linalg.norm(base))
        if pair is not None:
            found.append(PairRotation(a, b, len(at), *pair))
    return found


def _pair(first: Floats, second: Floats, recorded: Floats, base: Floats) -> tuple[int, float, float] | None:
    fits = [_refined(start, first, second) for start in relative_orientations(first, second)]
    if not fits:
        return None
    least = min(cost for cost, _, _ in fits)
    best = (4, 180.0, np.nan)
    for cost, rotation, direction in fits:
        if cost > _AS_GOOD * least:
            continue
        turns, angle = least_turn(rotation, recorded)
        if angle < best[1]:
            best = (turns, angle, float(direction @ base))
    return best


def _refined(start: RelativeOrientation, first: Floats, second: Floats) -> tuple[float, Floats, Floats]:
    """Return the cost, the rotation and the direction to the second image of the best fit near a start."""
    one, other = (np.column_stack([rays, -np.ones(len(rays))]) for rays in (first, second))
    across = np.linalg.svd(start.base[None])[2][1:]

    def pose(x: Floats) -> tuple[Floats, Floats]:
        base = start.base + x[3:] @ across
        rotation = np.asarray(Rotation.from_rotvec(x[:3]).as_matrix() @ start.rotation)
        return rotation, np.asarray(base / np.linalg.norm(base))

    def distances(x: Floats) -> Floats:
        rotation, (u, v, w) = pose(x)
        essential = rotation @ np.array([[0.0, -w, v], [w, 0.0, -u], [-v, u, 0.0]])
        lines, back = one @ essential.T, other @ essential
        length = np.sqrt(np.sum(lines[:, :2] ** 2, axis=1) + np.sum(back[:, :2] ** 2, axis=1))
        return np.asarray(np.sum(other * lines, axis=1) / np.maximum(length, 1e-12))

    scale = max(1.4826 * float(np.median(np.abs(distances(np.zeros(5))))), 1e-6)
    fit = least_squares(distances, np.zeros(5), loss="soft_l1", f_scale=scale)
    rotation, base = pose(fit.x)
    # The same loss for all starts, so that their costs compare.
    return float(np.sum(np.minimum(np.abs(distances(fit.x)), 3e-3))), rotation, base


def _rays(image: ImageMetadata, camera: Camera | None, pixels: Floats) -> Floats:
    if camera is None:
        if image.facts is None:
            raise ValueError("a row of a table has no pixels")
        own = start_camera("image", image.facts, principal_distance_px(image.facts)[0], ())
    else:
        own = camera
    plane = pixel_to_plane(own.size_px, own.pitch, pixels)
    return np.asarray(undistorted(own, plane) / own.value("c"))

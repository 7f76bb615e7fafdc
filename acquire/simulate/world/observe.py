"""Where points appear in pictures, row by row where the shutter rolls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.world.camera import Camera
from acquire.simulate.world.exposures import TO_OPENCV, Exposures, Pose, Rig, pose_at
from acquire.simulate.world.motion import Motion
from drivers.arrays import Floats, Integers


def seen(points_m: Floats, pose: Pose, camera: Camera) -> Floats:
    """Give columns and rows of points, each by its own pose or all by one, shape (n, 2).

    points_m (n, 3): in the local frame.
    """
    rays = np.squeeze(pose.rotation @ (points_m - pose.centre_m)[..., None], axis=-1)
    return camera.project(rays @ TO_OPENCV)


@dataclass(frozen=True)
class Sight:
    """True image places: point `point` at `pixels` of picture `image`."""

    image: Integers
    point: Integers
    pixels: Floats


def sight(
    points_m: Floats, exposures: Exposures, motion: Motion, rig: Rig, readout_s: float, margin_px: float
) -> Sight:
    """Give where all points appear in all pictures.

    points_m (n, 3).
    """
    image, point, pixels = [], [], []
    for number in range(len(exposures)):
        place = seen_rolling(points_m, exposures, number, motion, rig, readout_s)
        rows = np.flatnonzero(exposures.cameras[number].sees(place, margin_px))
        image.append(np.full(len(rows), number))
        point.append(rows)
        pixels.append(place[rows])
    return Sight(np.concatenate(image), np.concatenate(point), np.concatenate(pixels))


def seen_rolling(
    points_m: Floats, exposures: Exposures, number: int, motion: Motion, rig: Rig, readout_s: float
) -> Floats:
    """Give where points appear in one picture, shape (n, 2)."""
    camera, pose = exposures.cameras[number], exposures.pose
    place = seen(points_m, Pose(pose.centre_m[number], pose.rotation[number]), camera)
    if readout_s == 0:
        return place
    # Each row has its own moment; the row moves far less than the image between two steps.
    for _ in range(4):
        rows = np.nan_to_num(place[:, 1], nan=(camera.height - 1) / 2)
        place = seen(points_m, pose_at(motion, rig, row_time(exposures, number, rows, readout_s)), camera)
    return place


def row_time(exposures: Exposures, number: int, rows: Floats, readout_s: float) -> Floats:
    """Give the middle of the exposure of rows, s."""
    height = exposures.cameras[number].height
    return np.asarray(exposures.middle_s[number] + (rows / (height - 1) - 0.5) * readout_s)

"""Image observations without pictures: targets and tie points with noise."""

from dataclasses import dataclass

import numpy as np

from acquire.simulate.world.camera import TrueCamera
from acquire.simulate.world.exposures import TO_OPENCV, Pose, TrueExposures, TrueRig, pose_at
from acquire.simulate.world.motion import Motion
from acquire.simulate.world.world import World
from photocal.base.arrays import Flags, Floats, Integers


def seen(points_m: Floats, pose: Pose, camera: TrueCamera) -> Floats:
    """Give columns and rows of points, each by its own pose or all by one, shape (n, 2).

    points_m (n, 3): in the local frame.
    """
    rays = np.squeeze(pose.rotation @ (points_m - pose.centre_m)[..., None], axis=-1)
    return camera.project(rays @ TO_OPENCV)


def seen_rolling(
    points_m: Floats, exposures: TrueExposures, number: int, motion: Motion, rig: TrueRig, readout_s: float
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


def row_time(exposures: TrueExposures, number: int, rows: Floats, readout_s: float) -> Floats:
    """Give the middle of the exposure of rows, s."""
    height = exposures.cameras[number].height
    return np.asarray(exposures.middle_s[number] + (rows / (height - 1) - 0.5) * readout_s)


@dataclass(frozen=True)
class MeasuredPoints:
    """Measured places of points in images.

    names: targets first, then ties.
    points_m (points, 3): true coordinates in the local frame.
    image, point, sigma_px (n,).
    pixels (n, 2): with noise.
    """

    names: tuple[str, ...]
    points_m: Floats
    image: Integers
    point: Integers
    pixels: Floats
    sigma_px: Floats


def kept_images(world: World) -> Flags:
    """Tell which pictures reach the office: some are lost from within a strip when that fault is on."""
    kept = np.ones(len(world.exposures), bool)
    if world.has("missing_images"):
        lost = max(int(len(kept) * world.configuration.fault_sizes.missing_share), 2)
        first = int(world.random("faults").integers(2, len(kept) - lost - 1))
        kept[first : first + lost] = False
    return kept


def observe(world: World) -> MeasuredPoints:
    """Measure targets and tie points in all pictures."""
    given = world.configuration
    random = world.random("observations")
    area = np.array(given.plan.area_m)
    middle = area.mean(axis=0)
    # Ties lie beyond the area, too, as far as pictures overlap there.
    low, high = (middle + 1.25 * (corner - middle) for corner in (area.min(axis=0), area.max(axis=0)))
    points = world.targets.centre_m
    if given.observing.ties:
        plan = random.uniform(low, high, (given.observing.ties, 2))
        heights = world.terrain.height(plan[:, 0], plan[:, 1])
        points = np.vstack([points, np.column_stack([plan, heights])])
    places, rows = [], []
    margin_px = 8.0
    for number in np.flatnonzero(kept_images(world)).tolist():
        place = seen_rolling(points, world.exposures, number, world.motion, world.rig, given.camera.readout_s)
        rows.append(np.flatnonzero(world.exposures.cameras[number].sees(place, margin_px)))
        places.append(place[rows[-1]])
    image = np.repeat(np.flatnonzero(kept_images(world)), [len(seen_there) for seen_there in rows])
    point, pixels = np.concatenate(rows), np.concatenate(places)
    rays = np.bincount(point, minlength=len(points))
    enough = rays[point] >= 2
    image, point, pixels = image[enough], point[enough], pixels[enough]
    count = len(world.targets.names)
    sigma = np.where(point < count, given.observing.target_sigma_px, given.observing.sigma_px)
    noisy = pixels + random.standard_normal(pixels.shape) * sigma[:, None]
    names = (*world.targets.names, *(f"T{number:04d}" for number in range(1, given.observing.ties + 1)))
    return MeasuredPoints(names, points, image, point, noisy, sigma)

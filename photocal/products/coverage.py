"""Which ground the images show."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats, Integers
from photocal.geometry.camera import pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.frames import Frame
from photocal.geometry.oriented_images import OrientedImages
from photocal.products.lens_tables import image_border
from photocal.products.terrain import Bounds


def border_directions(shots: OrientedImages) -> Floats:
    """Directions in object space of rays around the border of each image, shape (m, k, 3)."""
    rays = []
    for camera in shots.cameras:
        plane = pixel_to_plane(camera.size_px, camera.pitch, image_border(camera, 16))
        ideal = undistorted(camera, plane)
        rays.append(np.column_stack([ideal, np.full(len(ideal), -camera.values[0])]))
    return np.asarray(np.einsum("mkc,mcd->mkd", np.array(rays)[shots.camera], shots.rotation))


def candidates(shots: OrientedImages, borders: Floats, ground: Floats) -> Integers:
    """Images whose footprint, at the lowest or the highest ground, touches the ground."""
    finite = ground[np.isfinite(ground[:, 2])]
    if not len(finite):
        return np.zeros(0, dtype=np.int64)
    low, high = finite.min(axis=0), finite.max(axis=0)
    touches = np.ones(len(shots.names), dtype=np.bool_)
    for axis in range(2):
        reach = []
        for level in (low[2], high[2]):
            with np.errstate(divide="ignore", invalid="ignore"):
                steps = (level - shots.station[:, None, 2]) / borders[..., 2]
                steps[~((borders[..., 2] < 0) & (steps > 0))] = np.nan
                reach.append(shots.station[:, None, axis] + steps * borders[..., axis])
        both = np.concatenate(reach, axis=1)
        seen = np.isfinite(both).all(axis=1)
        # A border that looks to the horizon, or polynomials without inverse, say nothing of the reach.
        both[~seen] = 0
        margin = 0.05 * np.ptp(both, axis=1) + 1e-6
        apart = (both.min(axis=1) - margin > high[axis]) | (both.max(axis=1) + margin < low[axis])
        touches &= ~(apart & seen)
    return np.flatnonzero(touches).astype(np.int64)


def footprints(shots: OrientedImages, frame: Frame, height: float) -> Bounds:
    """Rectangle around what the images show at one height, in the terrain's coordinates.

    height: of the terrain, m.
    returns: west, south, east, north; images that look to the horizon count with their nadir only.
    """
    given = frame.to_given(shots.station)
    nadir = frame.to_local(np.column_stack([given[:, :2], np.full(len(given), height)]))
    borders = border_directions(shots)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = (nadir[:, None, 2] - shots.station[:, None, 2]) / borders[..., 2]
        points = shots.station[:, None, :] + steps[..., None] * borders
    downward = ((borders[..., 2] < 0) & (steps > 0)).all(axis=1)
    corners = [given[:, :2]]
    if downward.any():
        corners.append(frame.to_given(points[downward].reshape(-1, 3))[:, :2])
    reach = np.vstack(corners)
    west, south = np.nanmin(reach, axis=0)
    east, north = np.nanmax(reach, axis=0)
    return float(west), float(south), float(east), float(north)

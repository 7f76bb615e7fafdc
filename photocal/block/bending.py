"""Rays that the atmosphere bends, and heights above a curved earth, as a stated choice."""

from dataclasses import replace

import numpy as np

from photocal.adjustment.network import Network
from photocal.base.arrays import Floats
from photocal.geometry.oriented_images import OrientedImages

# Mean radius of the earth, m: a hundredth of it changes what is said here by a hundredth of itself.
RADIUS_M = 6_371_000.0


def apparent_rise(apart: Floats, refraction: float, *, curved: bool) -> Floats:
    """By how much points seem to lie higher than on a straight ray over a plane earth, m, shape (n,).

    A ray is an arc of the radius R/k: seen over the distance s a point rises by k s^2 / 2R. Where heights
    count from a curved earth but coordinates are plane, it sinks by d^2 / 2R, d its level distance.

    apart (n, 3): from the camera to the point, m.
    refraction: coefficient k, ratio of the radii of earth and ray; 0.13 by Gauss, 0.17 in the standard
        atmosphere, 503 p/T^2 (0.0343 + dT/dz) of pressure (hPa) and temperature (K).
    """
    level = np.sum(apart[:, :2] ** 2, axis=1)
    bent = refraction * (level + apart[:, 2] ** 2)
    return np.asarray((bent - curved * level) / (2.0 * RADIUS_M))


def straightened(network: Network, refraction: float, *, curved: bool) -> Network:
    """Give the image observations as straight rays over a plane earth would have made them.

    The start orientation is near enough: what it is wrong by changes these small corrections in proportion.
    """
    rays, exposures = network.rays, network.exposures
    images = OrientedImages(network.image_names, network.cameras, exposures.camera, exposures.values)
    points = network.points.values[rays.point]
    risen = points.copy()
    risen[:, 2] += apparent_rise(points - images.station[rays.image], refraction, curved=curved)
    shift = images.project(rays.image, risen) - images.project(rays.image, points)
    pitch = np.array([camera.pitch for camera in network.cameras])[exposures.camera[rays.image]]
    plane = rays.plane - np.nan_to_num(shift * pitch * [1.0, -1.0])
    return replace(network, rays=replace(rays, plane=plane))

"""Which points their rays determine: those whose rays come from places that are far enough apart."""

import numpy as np

from photocal.adjustment.network import Network
from photocal.base.arrays import Flags


def determined(network: Network, kept: Flags) -> Flags:
    """Points that some of the rays determine, (points,); others than those that lose rays are taken as such.

    kept (rays,): which ones stay.
    """
    rays, points = network.rays, network.points
    size = len(points.values)
    count = np.bincount(rays.point[kept], minlength=size)
    known = points.held.any(axis=1) | (np.diagonal(points.weight, axis1=1, axis2=2) > 0).any(axis=1)
    enough = (count >= 2) | (known & (count >= 1))
    loses = np.bincount(rays.point[~kept], minlength=size) > 0
    some = np.flatnonzero(kept & (loses & enough & ~known)[rays.point])
    point, image = rays.point[some], rays.image[some]
    towards = points.values[point] - network.exposures.values[image, 3:]
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    mean = np.column_stack([np.bincount(point, towards[:, axis], size) for axis in range(3)])
    c = np.array([camera.value("c") for camera in network.cameras])[network.exposures.camera[image]]
    # In units of the standard deviation of a direction, over the mean of the rays.
    away = np.linalg.norm(towards - mean[point] / count[point][:, None], axis=1)
    turned = np.zeros(size)
    np.maximum.at(turned, point, 2 * away * c / rays.sigma[some].max(axis=1))
    # Rays that turn by less than so many of their standard deviations tell a fifth of the distance at best.
    # Heads of one exposure are centimetres apart: a point that only they see has no distance.
    least = 5.0
    return enough & ~(loses & ~known & (turned < least))

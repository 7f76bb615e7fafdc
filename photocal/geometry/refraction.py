"""Rays that the atmosphere bends, and heights above a curved earth."""

import numpy as np

from photocal.base.arrays import Floats

# Mean radius of the earth, m: a hundredth of it changes what is said here by a hundredth of itself.
RADIUS_M = 6_371_000.0


def apparent_rise(apart: Floats, refraction: float, *, curved: bool) -> Floats:
    """By how much points seem to lie higher than on a straight ray over a plane earth, m, shape (n,).

    A ray is an arc of the radius R/k: seen over the distance s a point rises by k s^2 / 2R. Where heights
    refer to a curved earth but coordinates are plane, it sinks by d^2 / 2R, d its level distance.

    apart (n, 3): from the camera to the point, m.
    refraction: coefficient k, ratio of the radii of earth and ray; 0.13 by Gauss, 0.17 in the standard
        atmosphere, 503 p/T^2 (0.0343 + dT/dz) of pressure (hPa) and temperature (K).
    """
    level = np.sum(apart[:, :2] ** 2, axis=1)
    bent = refraction * (level + apart[:, 2] ** 2)
    return np.asarray((bent - curved * level) / (2.0 * RADIUS_M))

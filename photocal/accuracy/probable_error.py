"""CE90 and LE90: the circle and the interval that hold a given share of the errors.

Two definitions are in use and both are given, under different names:

- *from the second moments*: the radius (or half width) that holds the share if the errors were
  normal with mean zero and the second moments found, so that a bias counts as error. For a circular
  distribution this is 2.1460 sigma, for one dimension 1.6449 sigma (Greenwalt and Shultz 1962).
- *counted*: the smallest length that at least the share of the check points does not exceed.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from drivers.arrays import Floats

# Directions over half a turn; the integrand is smooth and periodic, so the rectangle rule converges
# exponentially and this many suffice for axis ratios down to about 1:100.
_DIRECTIONS = 2048


def counted_error(lengths_m: Floats, share: float) -> float:
    """Give the smallest length that at least a share of the points does not exceed."""
    n = len(lengths_m)
    # A share times n that is whole up to rounding (0.9 * 30) must not be rounded up.
    rank = max(1, math.ceil(share * n - 1e-9))
    return float(np.sort(lengths_m)[rank - 1])


def linear_error(rmse_m: float, probability: float) -> float:
    """Give the half width of the interval about zero that holds a share of normal errors (LE)."""
    return float(stats.norm.ppf(0.5 + probability / 2.0)) * rmse_m


def circular_error(second_moments_m2: Floats, probability: float) -> float:
    """Give the radius of the circle about zero that holds a share of normal plane errors (CE).

    Exact for any ellipse: P(r) is the integral over all directions of the radial part, which has a
    closed form, so one dimension is left to sum and one equation to solve.
    """
    small, large = (max(float(value), 0.0) for value in np.linalg.eigvalsh(second_moments_m2))
    if large == 0.0:
        return 0.0
    # Below this ratio the ellipse is a line for every printed digit.
    if math.sqrt(small / large) < 1e-2:
        return linear_error(math.sqrt(large), probability)
    angles = (np.arange(_DIRECTIONS) + 0.5) * math.pi / _DIRECTIONS
    inverse = np.cos(angles) ** 2 + np.sin(angles) ** 2 * (large / small)

    def missing(radius: float) -> float:
        # Radii in units of the larger standard deviation.
        held = np.mean((1.0 - np.exp(-0.5 * radius**2 * inverse)) / inverse) * math.sqrt(large / small)
        return float(held) - probability

    upper = math.sqrt(float(stats.chi2.ppf(probability, 2)))
    return math.sqrt(large) * float(brentq(missing, 0.0, upper * (1.0 + 1e-9), xtol=1e-12))

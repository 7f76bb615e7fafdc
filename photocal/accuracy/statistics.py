"""Moments of discrepancies: mean, standard deviation, root mean square error, lengths.

A discrepancy is product minus reference, everywhere; its opposite is called a correction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from drivers.arrays import Floats
from drivers.errors import InputMalformedError

# 1 / the 0.75 quantile of the standard normal distribution: the median of absolute deviations
# times this estimates the standard deviation of normal data (Hoehle and Hoehle 2009).
_MAD_TO_STD = 1.482602218505602


@dataclass(frozen=True)
class Moments:
    """First two moments of one component of the discrepancies.

    Published studies often print nothing else, therefore tests and classes are computed from these.

    n: number of points.
    mean_m: mean discrepancy, m.
    std_m: standard deviation about the mean with n - 1, m; NaN for a single point.
    """

    n: int
    mean_m: float
    std_m: float

    @property
    def rmse_m(self) -> float:
        """Root mean square error, m: bias and spread together."""
        spread = 0.0 if self.n == 1 else (self.n - 1) / self.n * self.std_m**2
        return math.sqrt(self.mean_m**2 + spread)

    @property
    def rmse_without_mean_m(self) -> float:
        """Root mean square error after the mean has been subtracted, m."""
        return 0.0 if self.n == 1 else self.std_m * math.sqrt((self.n - 1) / self.n)


@dataclass(frozen=True)
class Spread:
    """Figures of one component beyond its moments, all in m.

    minimum_m, maximum_m, median_m: extremes and median.
    nmad_m: normalised median absolute deviation: the standard deviation that a few outliers cannot spoil.
    """

    minimum_m: float
    maximum_m: float
    median_m: float
    nmad_m: float


@dataclass(frozen=True)
class LengthStatistics:
    """Lengths of residual vectors (2D or 3D) summed up in the two ways that the literature mixes.

    n: number of vectors.
    mean_m: arithmetic mean of the lengths, m. Smaller than, or equal to, the root mean square.
    rms_m: root mean square of the lengths, m: the 2D or 3D RMSE.
    maximum_m: longest vector, m.
    """

    n: int
    mean_m: float
    rms_m: float
    maximum_m: float


def moments(values_m: Floats) -> Moments:
    """Compute number, mean and standard deviation of one component.

    Notes
    -----
    Alves Junior et al. 2015, equations 2-4 and 9-11.
    """
    n = len(values_m)
    if n == 0:
        raise InputMalformedError(
            "no discrepancy to compute statistics from", remedy="give at least one check point"
        )
    return Moments(n, float(np.mean(values_m)), float(np.std(values_m, ddof=1)) if n > 1 else math.nan)


def spread(values_m: Floats) -> Spread:
    """Compute extremes, median and the robust standard deviation of one component.

    values_m (n,): discrepancies, m, n at least 1.
    returns: the figures in m. Normalised median absolute deviation after Hoehle and Hoehle 2009.
    """
    median = float(np.median(values_m))
    return Spread(
        float(np.min(values_m)),
        float(np.max(values_m)),
        median,
        _MAD_TO_STD * float(np.median(np.abs(values_m - median))),
    )


def lengths(vectors_m: Floats) -> Floats:
    """Compute the lengths of residual vectors."""
    squares: Floats = np.sum(np.square(vectors_m), axis=1)
    return np.sqrt(squares)


def length_statistics(lengths_m: Floats) -> LengthStatistics:
    """Sum up lengths of residual vectors by mean and by root mean square.

    Silva (tank survey, equation 5) defines Rxyz as the root mean square but prints the mean of the
    lengths, so both are given and named.
    """
    return LengthStatistics(
        len(lengths_m),
        float(np.mean(lengths_m)),
        math.sqrt(float(np.mean(np.square(lengths_m)))),
        float(np.max(lengths_m)),
    )


def combined_rmse(*components: Moments) -> float:
    """Join the RMSE of components into the 2D or 3D RMSE."""
    return math.sqrt(sum(component.rmse_m**2 for component in components))


def moments_from_rmse_and_t(rmse_m: float, t: float, n: int) -> Moments:
    """Recover mean and standard deviation from a published RMSE and Student statistic."""
    std = rmse_m * math.sqrt(n / (t**2 + n - 1))
    return Moments(n, t * std / math.sqrt(n), std)


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

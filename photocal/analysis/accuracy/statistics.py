"""Moments of discrepancies, and tests on them: bias, precision, normality, outliers, trends."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError
from photocal.base.policy import policy

# The approximation of Royston 1995 (AS R94) holds for these numbers of points.
SHAPIRO_WILK_SAMPLES = range(3, 5001)
# Its polynomials: weights of the two outer points; mean and logarithm of the deviation to 11 points; beyond.
_TAILS = (
    (-2.706056, 4.434685, -2.07119, -0.147981, 0.221157, 0.0),
    (-3.582633, 5.682633, -1.752461, -0.293762, 0.042981, 0.0),
)

_SMALL = ((-0.0006714, 0.025054, -0.39978, 0.544), (-0.0020322, 0.062767, -0.77857, 1.3822))
_LARGE = ((0.0038915, -0.083751, -0.31082, -1.5861), (0.0, 0.0030302, -0.082676, -0.4803))
PROBABLE_ERROR = 0.90


@dataclass(frozen=True)
class Moments:
    """First two moments of one component of the discrepancies.

    Published studies often print nothing else, therefore tests and classes are computed from these.

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

    nmad_m: normalised median absolute deviation: the standard deviation that a few outliers cannot spoil.
    """

    minimum_m: float
    maximum_m: float
    median_m: float
    nmad_m: float


def moments(values_m: Floats) -> Moments:
    """Compute number, mean and standard deviation of one component.

    Alves Junior et al. 2015, equations 2-4 and 9-11.
    """
    n = len(values_m)
    if n == 0:
        raise InputMalformedError(
            "no discrepancy to compute statistics from", "give at least one check point"
        )
    return Moments(n, float(np.mean(values_m)), float(np.std(values_m, ddof=1)) if n > 1 else math.nan)


def spread(values_m: Floats) -> Spread:
    """Compute extremes, median and the robust standard deviation of one component."""
    median = float(np.median(values_m))
    nmad = policy.mad_to_sigma * float(np.median(np.abs(values_m - median)))
    return Spread(float(np.min(values_m)), float(np.max(values_m)), median, nmad)


def lengths(vectors_m: Floats) -> Floats:
    """Compute the lengths of residual vectors."""
    squares: Floats = np.sum(np.square(vectors_m), axis=1)
    return np.sqrt(squares)


@dataclass(frozen=True)
class LengthStatistics:
    """Lengths of residual vectors summed up in the two ways that the literature mixes.

    mean_m: arithmetic mean of the lengths, m. Smaller than, or equal to, the root mean square.
    probable_m: CE90 (plane) or LE90 (height) from the second moments, m; None in space.
    counted_m: length that 90 % of the points do not exceed, m.
    within_gsd: points within one, and within two ground sampling distances; None where that is not known.
    """

    n: int
    mean_m: float
    rms_m: float
    maximum_m: float
    probable_m: float | None
    counted_m: float
    within_gsd: tuple[int, int] | None


def length_statistics(
    lengths_m: Floats, gsd_m: float | None = None, probable: Callable[[float], float | None] = lambda _: None
) -> LengthStatistics:
    """Sum up lengths of residual vectors by mean and by root mean square, with its probable error.

    Silva (tank survey, equation 5) defines Rxyz as the root mean square but prints the mean of the
    lengths, so both are given and named.
    """
    n, mean, rms = len(lengths_m), float(np.mean(lengths_m)), math.sqrt(float(np.mean(np.square(lengths_m))))
    counted = counted_error(lengths_m, PROBABLE_ERROR)
    within = None if gsd_m is None else within_gsd(lengths_m, gsd_m)
    return LengthStatistics(n, mean, rms, float(np.max(lengths_m)), probable(rms), counted, within)


def within_gsd(lengths_m: Floats, gsd_m: float) -> tuple[int, int]:
    """Count the points within one, and within two ground sampling distances (Alves Junior et al. 2015)."""
    return int(np.sum(lengths_m <= gsd_m)), int(np.sum(lengths_m <= 2.0 * gsd_m))


def counted_error(lengths_m: Floats, share: float) -> float:
    """Give the smallest length that at least a share of the points does not exceed."""
    # A share of the points that is whole up to rounding (0.9 * 30) must not be rounded up.
    rank = max(1, math.ceil(share * len(lengths_m) - 1e-9))
    return float(np.sort(lengths_m)[rank - 1])


def linear_error(rmse_m: float, probability: float) -> float:
    """Give the half width of the interval about zero that holds a share of normal errors (LE)."""
    return float(special.ndtri(0.5 + probability / 2.0)) * rmse_m


def circular_error(second_moments_m2: Floats, probability: float) -> float:
    """Give the radius of the circle about zero that holds a share of normal plane errors (CE).

    Exact for any ellipse: P(r) is the integral over all directions of the radial part, which has a
    closed form, so one dimension is left to sum and one equation to solve.
    """
    # Directions over half a turn; the integrand is smooth and periodic, so the rectangle rule converges
    # exponentially and this many suffice for axis ratios down to about 1:100.
    directions = 2048
    small, large = (max(float(value), 0.0) for value in np.linalg.eigvalsh(second_moments_m2))
    if large == 0.0:
        return 0.0
    # Below this ratio the ellipse is a line for every printed digit.
    if math.sqrt(small / large) < 1e-2:
        return linear_error(math.sqrt(large), probability)
    angles = (np.arange(directions) + 0.5) * math.pi / directions
    inverse = np.cos(angles) ** 2 + np.sin(angles) ** 2 * (large / small)

    def missing(radius: float) -> float:
        """Probability within a radius minus the required one; zero at the radius searched for."""
        # Radii in units of the larger standard deviation.
        held = np.mean((1.0 - np.exp(-0.5 * radius**2 * inverse)) / inverse) * math.sqrt(large / small)
        return float(held) - probability

    # Halved until nothing is left: scipy.optimize would take longer to be loaded.
    low, high = 0.0, math.sqrt(float(special.chdtri(2, 1.0 - probability))) * (1.0 + 1e-9)
    while high - low > 1e-12:
        middle = (low + high) / 2.0
        low, high = (middle, high) if missing(middle) < 0.0 else (low, middle)
    return math.sqrt(large) * (low + high) / 2.0


@dataclass(frozen=True)
class BiasTest:
    """Two-sided Student test of a mean against zero.

    t: mean over its standard deviation, with the sign of the mean; infinite when the spread is zero.
    critical: value that |t| must stay below.
    confidence: two-sided level of confidence, 0 to 1.
    p_value: probability of a larger |t| without bias.
    """

    t: float
    critical: float
    confidence: float
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether the mean differs from zero, that is, whether there is a bias."""
        return not abs(self.t) < self.critical


@dataclass(frozen=True)
class PrecisionTest:
    """One-sided chi-square test of a standard deviation against a required one."""

    chi_squared: float
    critical: float
    confidence: float

    @property
    def accepted(self) -> bool:
        """Whether the spread agrees with the required standard deviation."""
        return self.chi_squared < self.critical


@dataclass(frozen=True)
class NormalityTest:
    """Shapiro-Wilk test of normality."""

    w: float
    p_value: float
    confidence: float

    @property
    def rejected(self) -> bool:
        """Whether the data are not normal at the level of confidence."""
        return self.p_value < 1.0 - self.confidence


def bias_test(component: Moments, confidence: float) -> BiasTest:
    """Test whether the mean of a component is zero."""
    dof = _degrees_of_freedom(component)
    _require_level(confidence)
    critical = float(special.stdtrit(dof, 0.5 + confidence / 2.0))
    if component.std_m == 0.0:
        t = 0.0 if component.mean_m == 0.0 else math.copysign(math.inf, component.mean_m)
    else:
        t = component.mean_m / component.std_m * math.sqrt(component.n)
    return BiasTest(t, critical, confidence, 2.0 * float(special.stdtr(dof, -abs(t))))


def precision_test(component: Moments, sigma_m: float, confidence: float) -> PrecisionTest:
    """Test whether the spread of a component is not larger than a required standard deviation."""
    dof = _degrees_of_freedom(component)
    if not sigma_m > 0.0:
        raise ConfigurationError(f"required standard deviation {sigma_m} m is not positive")
    chi_squared = dof * (component.std_m / sigma_m) ** 2
    return PrecisionTest(chi_squared, precision_quantile(component.n, confidence), confidence)


def precision_quantile(n: int, confidence: float) -> float:
    """Give the chi-square value that the precision test compares with."""
    _require_level(confidence)
    return float(special.chdtri(n - 1, 1.0 - confidence))


def normality_test(values_m: Floats, confidence: float) -> NormalityTest | None:
    """Test whether a component is normally distributed (Shapiro and Wilk 1965)."""
    _require_level(confidence)
    # A smaller range is no measurement: all values are equal.
    no_range_m = 1e-9
    if len(values_m) not in SHAPIRO_WILK_SAMPLES or float(values_m.max() - values_m.min()) < no_range_m:
        return None
    statistic, p_value = _shapiro_wilk(np.sort(values_m))
    return NormalityTest(statistic, p_value, confidence)


def _shapiro_wilk(x: Floats) -> tuple[float, float]:
    """W and its probability by Royston 1995 (AS R94), without the import of the library's statistics.

    x: ascending.
    """
    n = len(x)
    m = special.ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    weight = m / np.linalg.norm(m)
    if n == 3:
        weight[[0, -1]] = -math.sqrt(0.5), math.sqrt(0.5)
    else:
        tails = 2 if n > 5 else 1
        for k in range(tails):
            weight[-1 - k] += np.polyval(_TAILS[k], 1.0 / math.sqrt(n))
            weight[k] = -weight[-1 - k]
        inner = slice(tails, n - tails)
        ends = np.r_[weight[:tails], weight[n - tails :]]
        weight[inner] = m[inner] * math.sqrt((1.0 - ends @ ends) / (m[inner] @ m[inner]))
    away = x - x.mean()
    w = min(float((weight @ away) ** 2 / (away @ away)), 1.0)
    if n == 3:
        return w, max(6.0 / math.pi * (math.asin(math.sqrt(w)) - math.asin(math.sqrt(0.75))), 0.0)
    left, size = math.log(max(1.0 - w, 1e-300)), math.log(n)
    if n <= 11:
        most, size = 0.459 * n - 2.273, float(n)
        if left >= most:
            return w, 0.0
        left = -math.log(most - left)
    mean, spread = _SMALL if n <= 11 else _LARGE
    return w, float(special.ndtr((np.polyval(mean, size) - left) / math.exp(np.polyval(spread, size))))


def std_interval_factors(n: int, confidence: float) -> tuple[float, float]:
    """Say how badly a standard deviation from n points is known."""
    _require_level(confidence)
    dof = n - 1
    low = float(special.chdtri(dof, 0.5 + confidence / 2.0))
    high = float(special.chdtri(dof, 0.5 - confidence / 2.0))
    return math.sqrt(dof / high), math.sqrt(dof / low)


def _degrees_of_freedom(component: Moments) -> int:
    if component.n < 2:
        raise IllPosedError(
            "a test needs at least two check points, there is one", "measure more check points"
        )
    return component.n - 1


def _require_level(confidence: float) -> None:
    if not 0.0 < confidence < 1.0:
        raise ConfigurationError(f"confidence {confidence} is not between 0 and 1", "give for example 0.90")


def outliers(values_m: Floats, confidence: float) -> tuple[int, ...]:
    """Find the values that do not belong to the normal distribution of the others."""
    if len(values_m) < policy.smallest_sample:
        return ()
    rows = np.arange(len(values_m))
    removed: list[int] = []
    count = 0
    # More outliers than this are no outliers any more but another distribution.
    most_tested = 100
    for _ in range(min(max(1, len(values_m) // 4), most_tested)):
        rest = values_m[rows]
        deviation = np.abs(rest - np.mean(rest))
        std = float(np.std(rest, ddof=1))
        if std == 0.0:
            break
        worst = int(np.argmax(deviation))
        removed.append(int(rows[worst]))
        # The number of outliers is the last step that passes, not the first that fails: two outliers
        # side by side hide each other in the first step.
        if float(deviation[worst]) / std > critical_deviate(len(rest), confidence):
            count = len(removed)
        rows = np.delete(rows, worst)
    return tuple(removed[:count])


def critical_deviate(n: int, confidence: float) -> float:
    """Give the largest Studentised deviate that n normal values may show."""
    t = float(special.stdtrit(n - 2, 1.0 - (1.0 - confidence) / (2.0 * n)))
    return (n - 1) * t / math.sqrt((n - 2 + t**2) * n)


@dataclass(frozen=True)
class SimilarityTrend:
    """Scale, rotation and shift that explain planimetric discrepancies best.

    scale: by which the product is too large: 0.01 is 1 %.
    rotation_rad: by which the product is turned counter-clockwise, rad.
    rmse_left_m: planimetric root mean square (over n) of what it does not explain, m.
    """

    shift_m: tuple[float, float]
    scale: float
    rotation_rad: float
    rmse_left_m: float


def rmse_after_trend_removal(component: Moments, confidence: float) -> float:
    """Give the RMSE after the mean has been subtracted where it is significant."""
    return component.rmse_without_mean_m if bias_test(component, confidence).significant else component.rmse_m


def similarity_trend(positions_m: Floats, discrepancies_m: Floats) -> SimilarityTrend:
    """Fit shift, scale and rotation to planimetric discrepancies by least squares."""
    if len(positions_m) < 3:
        raise IllPosedError("a similarity trend needs at least three check points with coordinates")
    reduced = positions_m - positions_m.mean(axis=0)
    inertia = float(np.sum(reduced**2))
    if inertia == 0.0:
        raise IllPosedError("all check points have the same coordinates", "check the columns E and N")
    shift = discrepancies_m.mean(axis=0)
    east, north = reduced.T
    scale = float(np.sum(reduced * discrepancies_m)) / inertia
    rotation = float(np.sum(east * discrepancies_m[:, 1] - north * discrepancies_m[:, 0])) / inertia
    explained = shift + np.column_stack((scale * east - rotation * north, rotation * east + scale * north))
    left = discrepancies_m - explained
    rmse_left = math.sqrt(float(np.sum(left**2)) / len(left))
    return SimilarityTrend((float(shift[0]), float(shift[1])), scale, rotation, rmse_left)

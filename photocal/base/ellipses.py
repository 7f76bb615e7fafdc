"""Error ellipses and ellipsoids at a stated probability, and the mean precision of many points."""

from dataclasses import dataclass

import numpy as np
from scipy import special

from photocal.base.arrays import Floats


@dataclass(frozen=True)
class MeanPrecision:
    """Precision of many points in few figures.

    The two means are not the same: the root mean square is never the smaller one.

    arithmetic_by_axis, root_mean_square_by_axis (3,): of the standard deviations in X, Y and Z, m.
    arithmetic, root_mean_square: of the standard deviations of all coordinates together, m; the latter is
        sqrt(tr C / 3 n).
    spread_by_axis (3,): largest less smallest standard deviation: how unlike the points are, m.
    spread, spread_in_plane: the same over all coordinates together, and over X and Y (Fraser 1984).
    proportional: largest dimension of the object over the arithmetic mean: one part in that many; 0 for a
        single point.
    """

    arithmetic_by_axis: Floats
    root_mean_square_by_axis: Floats
    arithmetic: float
    root_mean_square: float
    spread_by_axis: Floats
    spread: float
    spread_in_plane: float
    proportional: float


def enlargement(probability: float, dimensions: int) -> float:
    """Semi-axis of the ellipse or ellipsoid of a probability in units of the standard deviation."""
    return float(np.sqrt(special.chdtri(dimensions, 1.0 - probability)))


def ellipses(covariance: Floats, probability: float) -> tuple[Floats, Floats]:
    """Error ellipses of positions in the X, Y plane, inside of which the true ones lie with a probability.

    covariance (n, m, m): m^2, m at least 2; X and Y are the first two.
    returns: semi-axes (n, 2), the larger one first, m; and the azimuth of the larger one (n,), from the Y
        axis towards X, in [0, pi) radians, 0 for a circle.
    """
    lengths, vectors = _axes(covariance[:, :2, :2])
    azimuth = np.arctan2(vectors[:, 0, 0], vectors[:, 0, 1]) % np.pi
    # 1e-9 below pi is 0: the axis has no sign.
    azimuth = np.where((np.pi - azimuth < 1e-9) | np.isclose(lengths[:, 0], lengths[:, 1]), 0.0, azimuth)
    return lengths * enlargement(probability, 2), azimuth


def ellipsoids(covariance: Floats, probability: float) -> tuple[Floats, Floats]:
    """Error ellipsoids of positions, inside of which the true ones lie with a probability.

    covariance (n, 3, 3): m^2.
    returns: semi-axes (n, 3), from the largest to the smallest, m; and unit vectors of the axes (n, 3, 3),
        one in each row, whose Z is not negative.
    """
    lengths, vectors = _axes(covariance)
    return lengths * enlargement(probability, 3), vectors * np.where(vectors[..., 2:] < 0, -1.0, 1.0)


def azimuth_and_elevation(directions: Floats) -> tuple[Floats, Floats]:
    """Where vectors (..., 3) point: from the Y axis towards X, in [0, 2 pi), and above the plane, rad."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.arctan2(x, y) % (2 * np.pi), np.arctan2(z, np.hypot(x, y))


def _axes(covariance: Floats) -> tuple[Floats, Floats]:
    """Standard deviations along the principal axes, largest first, and the axes as rows."""
    variances, vectors = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(variances[:, ::-1], 0.0)), np.swapaxes(vectors, 1, 2)[:, ::-1]


def mean_precision(covariance: Floats, points: Floats) -> MeanPrecision:
    """Mean precision of points, in both definitions in use.

    covariance (n, 3, 3): of at least one point, m^2.
    points (n, 3): m.
    """
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    sigma = np.sqrt(variance)
    return MeanPrecision(
        sigma.mean(axis=0),
        np.sqrt(variance.mean(axis=0)),
        float(sigma.mean()),
        float(np.sqrt(variance.mean())),
        np.ptp(sigma, axis=0),
        float(np.ptp(sigma)),
        float(np.ptp(sigma[:, :2])),
        float(np.ptp(points, axis=0).max() / sigma.mean()) if sigma.any() else 0.0,
    )


def spheres(semi_axes: Floats) -> Floats:
    """Radii (n,) of the spheres of the same volume as error ellipsoids: never above their quadratic mean."""
    return np.asarray(np.cbrt(np.prod(semi_axes, axis=1)))


def hottier_factor(equations: int, parameters: int) -> float | None:
    """By what residuals of control points underestimate the error at check points.

    K = sqrt(p n / (p n - r)) (Hottier 1976): p n image coordinates of the control points, r parameters of
    calibration; None where there are no more equations than parameters.
    """
    return float(np.sqrt(equations / (equations - parameters))) if equations > parameters else None

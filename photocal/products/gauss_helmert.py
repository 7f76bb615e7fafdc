"""Adjustment with conditions that hold measured points and unknown parameters together (Gauss-Helmert)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from drivers.errors import IllPosedError, InputMalformedError, NotConvergedError

# Value of each point's condition (n,), its derivatives to the parameters (n, u) and to the point (n, d).
Condition = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]

ITERATIONS = 100
# A step is over when it is this small against the standard deviation of what it moves.
NEGLIGIBLE = 1e-7


@dataclass(frozen=True)
class Adjusted:
    """What the adjustment found.

    state: parameters of the surface, in its own order.
    covariance (u, u): of the steps of the parameters, with the a priori variance factor 1.
    residuals (n, d): adjusted minus measured, m.
    influence (u, n, d): derivative of the parameters to each coordinate of each point.
    chi_squared: weighted sum of the squared residuals.
    degrees_of_freedom: conditions less parameters.
    """

    state: Floats
    covariance: Floats
    residuals: Floats
    influence: Floats
    chi_squared: float
    degrees_of_freedom: int
    iterations: int

    @property
    def variance_factor(self) -> float:
        """Variance factor a posteriori; NaN without redundancy."""
        return self.chi_squared / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


def fit(
    points: Floats,
    covariance: Floats,
    start: Floats,
    condition: Condition,
    moved: Callable[[Floats, Floats], Floats],
    what: str,
) -> Adjusted:
    """Fit a surface so that every point, corrected within its covariance, lies on it.

    Each iteration linearises at the corrected points, so that the minimum is that of the weighted
    distances and no approximation of them.

    points (n, d): measured coordinates, m, near the origin.
    covariance (n, d, d): covariance of each point, m2; different points are uncorrelated.
    raises IllPosedError: for fewer points than parameters, or points that leave a parameter undetermined.
    raises InputMalformedError: for a covariance that gives a condition no variance.
    raises NotConvergedError: when the steps do not end.

    Notes
    -----
    Helmert (1872); in the form of Pope (1972) with the misclosure reduced to the measured points.
    """
    residuals = np.zeros_like(points)
    state = start
    for iteration in range(1, ITERATIONS + 1):
        value, by_parameter, by_point = condition(state, points + residuals)
        count, unknowns = by_parameter.shape
        if count < unknowns:
            raise IllPosedError(
                f"{count} points do not determine a {what}", remedy=f"give at least {unknowns}"
            )
        misclosure = value - np.einsum("ni,ni->n", by_point, residuals)
        variance = np.einsum("ni,nij,nj->n", by_point, covariance, by_point)
        if not (variance > 0).all():
            raise InputMalformedError(
                f"point {int(np.argmin(variance)) + 1} of the {what} has no variance across it",
                remedy="give every point a positive standard deviation",
            )
        cofactor = _inverse(by_parameter.T @ (by_parameter / variance[:, None]), what)
        step = -cofactor @ (by_parameter.T @ (misclosure / variance))
        state = moved(state, step)
        correlate = -(misclosure + by_parameter @ step) / variance
        across = np.einsum("nij,nj->ni", covariance, by_point)
        before, residuals = residuals, across * correlate[:, None]
        settled = np.abs(step) <= NEGLIGIBLE * np.sqrt(np.diag(cofactor))
        moved_points = np.abs(np.einsum("ni,ni->n", by_point, residuals - before))
        if settled.all() and (moved_points <= 10 * NEGLIGIBLE * np.sqrt(variance)).all():
            influence = -np.einsum("uv,nv,ni->uni", cofactor, by_parameter / variance[:, None], by_point)
            chi_squared = float(correlate**2 @ variance)
            return Adjusted(state, cofactor, residuals, influence, chi_squared, count - unknowns, iteration)
    raise NotConvergedError(
        f"the fit of the {what} did not end within {ITERATIONS} iterations",
        remedy="are the points on such a surface, and their sigmas in metres?",
    )


def _inverse(normal: Floats, what: str) -> Floats:
    scale = np.sqrt(np.diag(normal))
    if (scale > 0).all() and np.isfinite(normal).all():
        scaled = normal / np.outer(scale, scale)
        if np.linalg.eigvalsh(scaled)[0] > 1e-12:
            return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))
    raise IllPosedError(
        f"the points leave a parameter of the {what} undetermined", remedy="spread the points over it"
    )

"""Estimated parameters with their covariance: the common input of the statistical tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError, IllPosedError


@dataclass(frozen=True)
class Estimates:
    """Parameters of an adjustment with their covariance.

    names: names of the p parameters, in the order of the arrays.
    values (p,): estimated values, each in its own unit.
    covariance (p, p): their covariance, in products of those units.
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats

    @property
    def sigmas(self) -> Floats:
        """Standard deviations, (p,), in the units of the values."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Floats:
        """Correlation matrix, (p, p)."""
        return self.covariance / np.outer(self.sigmas, self.sigmas)

    def indices(self, parameters: Iterable[str]) -> list[int]:
        """Give the places of the named parameters.

        raises ConfigurationError: when a name is not among the parameters.
        """
        place = {name: i for i, name in enumerate(self.names)}
        wanted = tuple(parameters)
        unknown = [name for name in wanted if name not in place]
        if unknown:
            raise ConfigurationError(
                f"parameter {unknown[0]} is not among the estimated ones ({' '.join(self.names)})",
                remedy="name parameters that were estimated",
            )
        return [place[name] for name in wanted]

    def select(self, parameters: Iterable[str]) -> Estimates:
        """Give some of the parameters; the others stay estimated (marginal covariance)."""
        at = self.indices(parameters)
        return Estimates(tuple(self.names[i] for i in at), self.values[at], self.covariance[np.ix_(at, at)])


def from_sigmas(
    names: Sequence[str], values: Sequence[float], sigmas: Sequence[float], correlation: Floats | None = None
) -> Estimates:
    """Build estimates from standard deviations and correlations, the way they are published."""
    p = len(names)
    x, s = np.asarray(values, dtype=np.float64), np.asarray(sigmas, dtype=np.float64)
    r = np.eye(p) if correlation is None else np.asarray(correlation, dtype=np.float64)
    if x.shape != (p,) or s.shape != (p,) or r.shape != (p, p):
        raise ConfigurationError(
            f"{p} names, {x.size} values, {s.size} sigmas and correlations {r.shape} do not fit together",
            remedy="give one value, one sigma and one row of correlations for each parameter",
        )
    wrong = [name for name, sigma in zip(names, s, strict=True) if not (np.isfinite(sigma) and sigma > 0.0)]
    if wrong:
        raise ConfigurationError(
            f"sigma of {wrong[0]} is not a positive number", remedy="leave out what was held fixed"
        )
    if not (np.allclose(np.diag(r), 1.0) and np.allclose(r, r.T) and np.all(np.abs(r) <= 1.0 + 1e-9)):
        raise ConfigurationError(
            "the correlation matrix is not symmetric with ones on its diagonal and entries within -1 and 1",
            remedy="give the full matrix in the order of the names",
        )
    return Estimates(tuple(names), x, r * np.outer(s, s))


def scaled(estimates: Estimates, variance_factor: float) -> Estimates:
    """Multiply the covariance by a variance factor (from a priori to a posteriori)."""
    return Estimates(estimates.names, estimates.values, estimates.covariance * variance_factor)


def without(estimates: Estimates, removed: Iterable[str]) -> tuple[Estimates, float]:
    """Take parameters out of the adjustment: hold them at zero, and let the others follow.

    Deleting a parameter from an adjustment deletes its row and column of the reduced normal
    matrix, the inverse of the covariance: exact for a linear model, a prediction for ours.

    raises IllPosedError: when the covariance of the removed parameters is not positive definite.
    """
    out = estimates.indices(removed)
    stay = [i for i in range(len(estimates.names)) if i not in out]
    S, x = estimates.covariance, estimates.values
    gain = np.linalg.solve(
        positive_definite(estimates.select([estimates.names[i] for i in out])), S[np.ix_(out, stay)]
    )
    remaining = Estimates(
        tuple(estimates.names[i] for i in stay),
        x[stay] - gain.T @ x[out],
        S[np.ix_(stay, stay)] - S[np.ix_(stay, out)] @ gain,
    )
    return remaining, quadratic_form(estimates.select([estimates.names[i] for i in out]))


def positive_definite(estimates: Estimates) -> Floats:
    """Give the covariance, or refuse it."""
    least = float(np.linalg.eigvalsh(estimates.correlation)[0]) if estimates.names else 1.0
    if not least > 1e-14:
        raise IllPosedError(
            f"the correlation matrix of {' '.join(estimates.names)} is not positive definite "
            f"(least eigenvalue {least:.3g})",
            remedy="give more decimals, or correct the entry that was misprinted",
        )
    return estimates.covariance


def quadratic_form(estimates: Estimates) -> float:
    """Give x' S^-1 x of the parameters."""
    sigma = estimates.sigmas
    positive_definite(estimates)
    t = estimates.values / sigma
    return float(t @ np.linalg.solve(estimates.correlation, t))

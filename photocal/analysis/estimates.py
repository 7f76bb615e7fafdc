"""Estimated parameters with their covariance, and whether they, or groups of them, differ from zero.

Principal components of the additional parameters: how many of them the network determines.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.policy import policy
from photocal.findings.finding import Figure, Finding
from photocal.geometry.camera import Camera

GROUPS = (("x0", "y0"), ("K1", "K2", "K3"), ("P1", "P2"), ("B1", "B2"))
CUMULATIVE = (("K1",), ("K1", "K2"), ("K1", "K2", "K3"), ("K1", "K2", "K3", "K4"))


@dataclass(frozen=True)
class Estimates:
    """Parameters of an adjustment with their covariance."""

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
        """Give the places of the named parameters."""
        place = {name: i for i, name in enumerate(self.names)}
        wanted = tuple(parameters)
        unknown = [name for name in wanted if name not in place]
        if unknown:
            raise ConfigurationError(
                f"parameter {unknown[0]} is not among the estimated ones ({' '.join(self.names)})",
                "name parameters that were estimated",
            )
        return [place[name] for name in wanted]

    def select(self, parameters: Iterable[str]) -> "Estimates":
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
            "give one value, one sigma and one row of correlations for each parameter",
        )
    wrong = [name for name, sigma in zip(names, s, strict=True) if not (np.isfinite(sigma) and sigma > 0.0)]
    if wrong:
        raise ConfigurationError(
            f"sigma of {wrong[0]} is not a positive number", "leave out what was held fixed"
        )
    if not (np.allclose(np.diag(r), 1.0) and np.allclose(r, r.T) and np.all(np.abs(r) <= 1.0 + 1e-9)):
        raise ConfigurationError(
            "the correlation matrix is not symmetric with ones on its diagonal and entries within -1 and 1",
            "give the full matrix in the order of the names",
        )
    return Estimates(tuple(names), x, r * np.outer(s, s))


def estimates_of(camera: Camera) -> Estimates | None:
    """Give the parameters of an adjusted camera whose sigmas are known; None without any."""
    names = tuple(name for name in camera.free if camera.sigma_of(name) > 0)
    values, sigmas = ([of(name) for name in names] for of in (camera.value, camera.sigma_of))
    return from_sigmas(names, values, sigmas, camera.correlation_of(names)) if names else None


def scaled(estimates: Estimates, variance_factor: float) -> Estimates:
    """Multiply the covariance by a variance factor (from a priori to a posteriori)."""
    return Estimates(estimates.names, estimates.values, estimates.covariance * variance_factor)


def without(estimates: Estimates, removed: Iterable[str]) -> Estimates:
    """Take parameters out of the adjustment: hold them at zero, and let the others follow."""
    out = estimates.indices(removed)
    stay = [i for i in range(len(estimates.names)) if i not in out]
    S, x = estimates.covariance, estimates.values
    of_removed = estimates.select([estimates.names[i] for i in out])
    gain = np.linalg.solve(positive_definite(of_removed), S[np.ix_(out, stay)])
    return Estimates(
        tuple(estimates.names[i] for i in stay),
        x[stay] - gain.T @ x[out],
        S[np.ix_(stay, stay)] - S[np.ix_(stay, out)] @ gain,
    )


def positive_definite(estimates: Estimates) -> Floats:
    """Give the covariance, or refuse it."""
    least = float(np.linalg.eigvalsh(estimates.correlation)[0]) if estimates.names else 1.0
    if not least > 1e-14:
        raise IllPosedError(
            f"the correlation matrix of {' '.join(estimates.names)} is not positive definite "
            f"(least eigenvalue {least:.3g})",
            "give more decimals, or correct the entry that was misprinted",
        )
    return estimates.covariance


def quadratic_form(estimates: Estimates) -> float:
    """Give x' S^-1 x of the parameters."""
    sigma = estimates.sigmas
    positive_definite(estimates)
    t = estimates.values / sigma
    return float(t @ np.linalg.solve(estimates.correlation, t))


@dataclass(frozen=True)
class FTest:
    """Outcome of one test of "these parameters are zero".

    Attributes
    ----------
    kind
        "single", "group" or "cumulative".
    """

    kind: str
    parameters: tuple[str, ...]
    statistic: float
    critical: float
    p_value: float
    significant: bool


def f_test(
    estimates: Estimates,
    parameters: Iterable[str],
    degrees_of_freedom: float,
    alpha: float,
    kind: str = "group",
) -> FTest:
    """Test one group of parameters, F = x' S^-1 x / p against F(1 - alpha; p, dof).

    Canon ELPH study (FCT-UNESP), equations 11 to 13.
    """
    chosen = estimates.select(parameters)
    p = len(chosen.names)
    statistic = quadratic_form(chosen) / p
    # With sigmas that are known for sure p F is chi-squared; the library's F has no such limit.
    known = np.isinf(degrees_of_freedom)
    critical = float(
        special.chdtri(p, alpha) / p if known else special.fdtri(p, degrees_of_freedom, 1 - alpha)
    )
    p_value = float(
        special.chdtrc(p, p * statistic) if known else special.fdtrc(p, degrees_of_freedom, statistic)
    )
    return FTest(kind, chosen.names, statistic, critical, p_value, statistic >= critical)


def significance(estimates: Estimates, degrees_of_freedom: float, alpha: float = 0.10) -> tuple[FTest, ...]:
    """Test every parameter alone, the usual groups, and the radial terms one after the other."""
    single = [((name,), "single") for name in estimates.names]
    groups = [(tuple(n for n in group if n in estimates.names), "group") for group in GROUPS]
    cumulative = [(group, "cumulative") for group in CUMULATIVE if set(group) <= set(estimates.names)]
    wanted = single + [(names, kind) for names, kind in groups if len(names) > 1] + cumulative
    return tuple(f_test(estimates, names, degrees_of_freedom, alpha, kind) for names, kind in wanted)


ESSENTIAL = ("c", "x0", "y0")
# Who goes first when nothing else decides: the higher term of a series before the lower one.
ORDER_OF_LEAVING = ("K4", "K3", "P4", "P3", "K2", "B2", "B1", "P2", "P1", "K1")


@dataclass(frozen=True)
class Components:
    """Principal components of correlated parameters.

    eigenvalues (p,): of the correlation matrix, largest first; their sum is p.
    percent, cumulative_percent (p,): share of each component in the sum.
    vectors (p, p): eigenvectors, one a column.
    loadings (p, p): MCCP: correlation of each parameter (row) with each component (column).
    """

    names: tuple[str, ...]
    eigenvalues: Floats
    percent: Floats
    cumulative_percent: Floats
    vectors: Floats
    loadings: Floats


def principal_components(estimates: Estimates) -> Components:
    """Analyse the correlation matrix of parameters.

    Tank study (Silva, UFPR, 1995), equation 78: loading = c_ij sqrt(lambda_j) / sigma_i, sigma_i = 1 here.
    """
    positive_definite(estimates)
    ascending, columns = np.linalg.eigh(estimates.correlation)
    eigenvalues, vectors = ascending[::-1], columns[:, ::-1]
    largest = vectors[np.argmax(np.abs(vectors), axis=0), np.arange(len(eigenvalues))]
    vectors = vectors * np.sign(largest)
    percent = 100.0 * eigenvalues / eigenvalues.sum()
    return Components(
        estimates.names, eigenvalues, percent, np.cumsum(percent), vectors, vectors * np.sqrt(eigenvalues)
    )


@dataclass(frozen=True)
class RemovalStep:
    """One round of the removal rule.

    negligible: number of last components that hold less than the negligible share together.
    crowd: parameters that cannot be separated in this round.
    statistic: x' S^-1 x / p of the removed ones: large when they are needed although correlated; nan without
        values.
    """

    components: Components
    negligible: int
    crowd: tuple[str, ...]
    removed: tuple[str, ...]
    statistic: float


@dataclass(frozen=True)
class Proposal:
    """Result of the removal rule.

    Attributes
    ----------
    recommended
        Removed parameters that should be left out: not needed, or of unknown significance.
    """

    steps: tuple[RemovalStep, ...]
    removed: tuple[str, ...]
    kept: tuple[str, ...]
    recommended: tuple[str, ...]
    final: Components
    remarks: tuple[Finding, ...]


def propose_removal(estimates: Estimates) -> Proposal:
    """Apply the removal rule of the tank study until the remaining parameters are distinct.

    Tank study (Silva, UFPR, 1995), section on the choice of additional parameters.
    """
    current, steps = estimates, list[RemovalStep]()
    # The tank study neglects components with 0.74, 0.98 and 1.14 % of the variance together and keeps 3.15 %.
    negligible_percent = 2.0
    while True:
        components = principal_components(current)
        negligible = int(np.sum(np.cumsum(components.percent[::-1]) < negligible_percent))
        crowd = _crowd(components, negligible)
        candidates = _leaving_order(current, [name for name in crowd if name not in ESSENTIAL])
        # One of a crowd stays to speak for it, unless an essential parameter does that already.
        spared = 0 if any(name in ESSENTIAL for name in crowd) else 1
        leaving = tuple(candidates[: min(max(negligible, 1), len(candidates) - spared)])
        if not leaving:
            return _proposal(steps, components, negligible)
        known = bool(np.any(estimates.values))
        statistic = quadratic_form(current.select(leaving)) / len(leaving) if known else float("nan")
        steps.append(RemovalStep(components, negligible, crowd, leaving, statistic))
        current = without(current, leaving)


def _crowd(components: Components, negligible: int) -> tuple[str, ...]:
    """Name the parameters that cannot be separated, or none."""
    for column in np.abs(components.loadings).T:
        together = np.flatnonzero(column > policy.strong_correlation)
        if len(together) > 1:
            return tuple(components.names[i] for i in together)
    if negligible:
        # No crowd shows, but a combination has almost no variance: those that form it.
        weight = np.abs(components.vectors[:, -1])
        return tuple(components.names[i] for i in np.flatnonzero(weight > 0.5 * weight.max()))
    return ()


def _leaving_order(estimates: Estimates, candidates: list[str]) -> list[str]:
    t = dict(zip(estimates.names, np.abs(estimates.values / estimates.sigmas), strict=True))
    rank = {name: i for i, name in enumerate(ORDER_OF_LEAVING)}
    by_weakness = sorted(candidates, key=lambda name: (float(t[name]), rank.get(name, len(rank))))
    # A radial series loses its highest term first, whichever of its terms is the weakest.
    radial = iter(sorted((name for name in candidates if name[0] == "K"), reverse=True))
    return [next(radial) if name[0] == "K" else name for name in by_weakness]


def _proposal(steps: list[RemovalStep], final: Components, negligible: int) -> Proposal:
    removed = tuple(name for step in steps for name in step.removed)
    recommended = tuple(name for step in steps if not _needed(step) for name in step.removed)
    remarks = [_round(step) for step in steps]
    last: dict[str, Figure] = {
        "names": final.names,
        "components": float(len(final.names)),
        "percent": float(final.percent[-1]),
    }
    remarks.append(_remark("pca-kept" if removed else "pca-keep-all", last))
    if recommended:
        remarks.append(_remark("pca-leave-out", {"names": recommended}))
    elif removed:
        remarks.append(_remark("pca-needed", {}))
    if negligible:
        remarks.append(_remark("pca-network", {}))
    return Proposal(tuple(steps), removed, final.names, recommended, final, tuple(remarks))


def _remark(code: str, figures: dict[str, Figure], clauses: tuple[str, ...] = ()) -> Finding:
    return Finding(code, "note", "components", figures, clauses)


def _needed(step: RemovalStep) -> bool:
    # F from which parameters are needed although correlated: 2 standard deviations of a single one.
    needed = 4.0
    return step.statistic > needed


def _round(step: RemovalStep) -> Finding:
    figures: dict[str, Figure] = {
        "removed": step.removed,
        "crowd": step.crowd,
        "negligible": float(step.negligible),
        "percent": float(step.components.percent[len(step.components.names) - step.negligible :].sum()),
        "f": step.statistic,
    }
    clauses = ["pca-negligible" if step.negligible else "pca-none-negligible"]
    if not np.isnan(step.statistic):
        clauses += ["pca-together", "pca-real" if _needed(step) else "pca-nothing-lost"]
    return _remark("pca-round", figures, tuple(clauses))

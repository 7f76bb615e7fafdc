"""Principal components of the additional parameters: how many of them the network determines."""

from dataclasses import dataclass

import numpy as np

from photocal.analysis.estimates import Estimates, positive_definite, quadratic_form, without
from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.findings.finding import Figure, Finding

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
    crowd: parameters that cannot be told apart in this round.
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
    """What the removal rule ends with.

    Attributes
    ----------
    recommended
        Those of the removed that are worth leaving out: not needed, or of unknown significance.
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
        current, _ = without(current, leaving)


def _crowd(components: Components, negligible: int) -> tuple[str, ...]:
    """Name the parameters that cannot be told apart, or none."""
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

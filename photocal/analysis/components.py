"""Principal components of the additional parameters: how many of them the network determines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photocal.analysis.estimates import Array, Estimates, positive_definite, quadratic_form, without

# The tank study neglects components with 0.74, 0.98 and 1.14 % of the variance together and keeps 3.15 %.
NEGLIGIBLE_PERCENT = 2.0
STRONG = 0.8
# F from which parameters are needed although correlated: 2 standard deviations of a single one.
NEEDED = 4.0
ESSENTIAL = ("c", "x0", "y0")
# Who goes first when nothing else decides: the higher term of a series before the lower one.
ORDER_OF_LEAVING = ("K4", "K3", "P4", "P3", "K2", "B2", "B1", "P2", "P1", "K1")


@dataclass(frozen=True)
class Components:
    """Principal components of correlated parameters.

    Attributes
    ----------
    names : tuple of str
        The p parameters.
    eigenvalues : (p,) array
        Of the correlation matrix, largest first; their sum is p.
    percent, cumulative_percent : (p,) array
        Share of each component in the sum.
    vectors : (p, p) array
        Eigenvectors, one a column.
    loadings : (p, p) array
        MCCP: correlation of each parameter (row) with each component (column).
    """

    names: tuple[str, ...]
    eigenvalues: Array
    percent: Array
    cumulative_percent: Array
    vectors: Array
    loadings: Array


def principal_components(estimates: Estimates) -> Components:
    """Analyse the correlation matrix of parameters.

    The correlations are used, not the covariances, because the parameters have different units.

    Parameters
    ----------
    estimates : Estimates
        Parameters with their covariance.

    Returns
    -------
    Components
        Eigenvalues, shares and loadings; each component is signed so that its largest loading is positive.

    Raises
    ------
    IllPosedError
        When the matrix is not positive definite.

    Notes
    -----
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

    Attributes
    ----------
    components : Components
        What the rule looked at.
    negligible : int
        Number of last components that hold less than the negligible share together.
    crowd : tuple of str
        Parameters that cannot be told apart in this round.
    removed : tuple of str
        Those of the crowd that leave.
    statistic : float
        x' S^-1 x / p of the removed ones: large when they are needed although correlated; nan without values.
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
    steps : tuple of RemovalStep
        The rounds in which something was removed.
    removed, kept : tuple of str
        Parameters that the rule leaves out and keeps.
    recommended : tuple of str
        Those of the removed that are worth leaving out: not needed, or of unknown significance.
    final : Components
        Components of the kept parameters.
    sentences : tuple of str
        The proposal in words, one sentence a round and one for the end.
    """

    steps: tuple[RemovalStep, ...]
    removed: tuple[str, ...]
    kept: tuple[str, ...]
    recommended: tuple[str, ...]
    final: Components
    sentences: tuple[str, ...]


def propose_removal(
    estimates: Estimates,
    *,
    essential: tuple[str, ...] = ESSENTIAL,
    negligible_percent: float = NEGLIGIBLE_PERCENT,
    strong: float = STRONG,
) -> Proposal:
    """Apply the removal rule of the tank study until the remaining parameters are distinct.

    As many parameters leave in a round as there are negligible components; they are taken from those
    that load together on one component, the least significant first, higher radial terms before lower ones.
    The covariance without them follows from the inverse with their rows and columns deleted.

    Parameters
    ----------
    estimates : Estimates
        All parameters; values of zero throughout mean that only the covariance is known.
    essential : tuple of str
        Parameters that never leave.
    negligible_percent : float
        Share of the variance, in percent, below which the last components are negligible together.
    strong : float
        Loading above which parameters count as bound to a component.

    Returns
    -------
    Proposal
        The rounds, the outcome and the sentences.

    Raises
    ------
    IllPosedError
        When the correlation matrix is not positive definite.

    Notes
    -----
    Tank study (Silva, UFPR, 1995), section on the choice of additional parameters.
    """
    current, steps = estimates, list[RemovalStep]()
    while True:
        components = principal_components(current)
        negligible = int(np.sum(np.cumsum(components.percent[::-1]) < negligible_percent))
        crowd = _crowd(components, negligible, strong)
        candidates = _leaving_order(current, [name for name in crowd if name not in essential])
        # One of a crowd stays to speak for it, unless an essential parameter does that already.
        spared = 0 if any(name in essential for name in crowd) else 1
        leaving = tuple(candidates[: min(max(negligible, 1), len(candidates) - spared)])
        if not leaving:
            return _proposal(steps, components, negligible)
        known = bool(np.any(estimates.values))
        statistic = quadratic_form(current.select(leaving)) / len(leaving) if known else float("nan")
        steps.append(RemovalStep(components, negligible, crowd, leaving, statistic))
        current, _ = without(current, leaving)


def _crowd(components: Components, negligible: int, strong: float) -> tuple[str, ...]:
    """Name the parameters that cannot be told apart, or none."""
    for column in np.abs(components.loadings).T:
        together = np.flatnonzero(column > strong)
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
    sentences = [_sentence(step) for step in steps]
    last = f"the last of {len(final.names)} components holds {final.percent[-1]:.2f} % of the variance"
    if not removed:
        sentences.append(f"Proposal: keep all parameters; {last} and no two parameters load on the same one.")
    else:
        sentences.append(f"With {' '.join(final.names)} {last}.")
    if recommended:
        sentences.append(f"Proposal: leave out {' '.join(recommended)}.")
    elif removed:
        sentences.append(
            "Proposal: keep all parameters; those that the rule names are correlated but significant, which "
            "asks for a better network and not for a poorer model."
        )
    if negligible:
        sentences.append(
            "What remains alike concerns parameters that every camera needs: improve the network."
        )
    return Proposal(tuple(steps), removed, final.names, recommended, final, tuple(sentences))


def _needed(step: RemovalStep) -> bool:
    return step.statistic > NEEDED


def _sentence(step: RemovalStep) -> str:
    share = float(step.components.percent[len(step.components.names) - step.negligible :].sum())
    many = "s" if step.negligible > 1 else ""
    cause = (
        f"the last {step.negligible} component{many} hold{'' if many else 's'} {share:.2f} % of the variance"
        if step.negligible
        else "no component is negligible"
    )
    text = (
        f"The rule leaves out {' and '.join(step.removed)}: {' '.join(step.crowd)} load together and {cause}"
    )
    if np.isnan(step.statistic):
        return f"{text}."
    need = "they carry a real effect" if _needed(step) else "nothing is lost"
    return f"{text}; tested together F = {step.statistic:.3g}: {need}."

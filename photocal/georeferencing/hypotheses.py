"""Systematic errors of positions, attitudes and camera as hypotheses: tested, and the most probable chosen.

A group of values is a hypothesis: its values are freed in the integrated adjustment, and an F test of the
fall of v'Pv says whether it is needed beside the others that are freed. Of several the most probable one is
chosen; those that explain the same are said with it: the flight cannot tell them apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy import stats

from photocal.georeferencing.freed_groups import (
    CHANGE,
    PRINCIPAL_DISTANCE,
    SIGNIFICANCE,
    STRIP_SHIFTS,
    Estimate,
)

# Akaike (1974): models this close are not told apart; in units of v'Pv.
_AS_GOOD = 10.0
# A share of the gain: what explains as much of it is another name for the same error.
_SAME_GAIN = 0.95
# A principal distance that differs by less is no other camera, zoom or focus: warmth and correlated tie
# points do that too.
_NOTEWORTHY = 1e-3
# A shift of its own for each strip can imitate every other error, a second camera those of c and of the
# height where there are two heights. They are tried when nothing else is left; what they make needless is
# given up then.
_IMITATORS = (STRIP_SHIFTS, CHANGE)


@dataclass(frozen=True)
class Hypothesis:
    """One group of values freed.

    Attributes
    ----------
    gain : float
        By which v'Pv falls.
    factor : float
        Variance factor that is left.
    unknowns : int
        Freed values.
    f, critical : float
        gain / unknowns over the variance factor that is left, and its limit.
    """

    name: str
    gain: float
    factor: float
    unknowns: int
    f: float
    critical: float
    significant: bool
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class Fit:
    """What the tests need of an adjustment; its covariances would fill the memory.

    Attributes
    ----------
    estimates : dict of str to tuple of Estimate
        Of each group that was freed.
    """

    chi_squared: float
    degrees_of_freedom: int
    estimates: dict[str, tuple[Estimate, ...]]


def compare(name: str, before: Fit, after: Fit, unknowns: int, tests: int) -> Hypothesis:
    """Test a group of values.

    Parameters
    ----------
    name : str
        Of the group.
    before, after : Fit
        With the group held, and freed under weak observations of its values.
    unknowns : int
        Values that were freed.
    tests : int
        Groups that are tested: the significance of the whole is shared by them.
    """
    gain = max(before.chi_squared - after.chi_squared, 0.0)
    # As many weak observations as unknowns came in: the degrees of freedom are those of the data.
    freedom = max(before.degrees_of_freedom - unknowns, 1)
    factor = max(after.chi_squared / freedom, 1e-300)
    f = gain / unknowns / factor
    critical = float(stats.f(unknowns, freedom).ppf(1.0 - SIGNIFICANCE / tests))
    return Hypothesis(name, gain, factor, unknowns, f, critical, f > critical, after.estimates[name])


def most_probable(tries: tuple[Hypothesis, ...], observations: int) -> Hypothesis | None:
    """Choose the most probable significant hypothesis (Schwarz 1978): gain less ln(n) for each unknown."""
    penalty = _scale(tries) * math.log(observations)
    significant = tuple(one for one in tries if one.significant and _noteworthy(one))
    return max(causes_first(significant), key=lambda one: one.gain - one.unknowns * penalty, default=None)


def causes_first(tries: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
    """Leave imitators out where there are others."""
    return tuple(one for one in tries if one.name not in _IMITATORS) or tries


def _noteworthy(one: Hypothesis) -> bool:
    """Whether two principal distances differ by more than those of one camera may."""
    if one.name != CHANGE:
        return True
    before, after = one.estimates[0].value, one.estimates[1].value
    return abs(after - before) / before > _NOTEWORTHY


def _scale(tries: tuple[Hypothesis, ...]) -> float:
    """Variance factor of the observations: what the hypothesis that explains most leaves of it."""
    return max(1.0, min((one.factor for one in tries), default=1.0))


def _as_good(one: Hypothesis, scale: float) -> float:
    """Gain from which another hypothesis explains as much."""
    return min(one.gain - _AS_GOOD * scale, _SAME_GAIN * one.gain)


def as_good(best: Hypothesis, tries: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
    """Give the other hypotheses that explain nearly all of what the best explains, but for strip shifts."""
    limit, silent = _as_good(best, _scale(tries)), [best.name, STRIP_SHIFTS]
    if best.name == PRINCIPAL_DISTANCE:
        # Two of them contain the common one.
        silent.append(CHANGE)
    return tuple(one for one in tries if one.name not in silent and one.significant and one.gain >= limit)

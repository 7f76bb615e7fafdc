"""Which systematic error of positions, attitudes and camera a block shows: tested one by one, then named.

The integrated adjustment is repeated with one group of values freed at a time. The group that lowers v'Pv
most, for the unknowns that it costs, is accepted when an F test finds it significant; then the others
are tested again beside it. Groups that explain the same as the accepted one are said with it: the flight
cannot tell them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from scipy import stats

from drivers.errors import IllPosedError, NotConvergedError
from photocal.accuracy.georeferencing.camera_change import best_change
from photocal.accuracy.georeferencing.freed_groups import (
    CHANGE,
    LOOSE_CAMERA,
    MOUNTED,
    SIGNIFICANCE,
    Estimate,
    estimates_of,
    groups_of,
    left_free,
    with_freed,
)
from photocal.adjustment.adjust import adjust
from photocal.adjustment.solution import Solution
from photocal.block.model import Block
from photocal.block.network import assemble

# Akaike (1974): models this close are not told apart; in units of v'Pv.
_AS_GOOD = 10.0
# A share of the gain: what explains as much of it is another name for the same error.
_SAME_GAIN = 0.95
_ROUNDS = 4
# A principal distance that differs by less is no other camera, zoom or focus: warmth and correlated tie
# points do that too.
_NOTEWORTHY = 1e-3


@dataclass(frozen=True)
class Hypothesis:
    """One group of values freed.

    Attributes
    ----------
    name : str
    gain : float
        By which v'Pv falls.
    unknowns : int
        Freed values.
    f, critical : float
        gain / unknowns over the variance factor that is left, and its limit.
    significant : bool
    estimates : tuple of Estimate
    """

    name: str
    gain: float
    unknowns: int
    f: float
    critical: float
    significant: bool
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class SystematicError:
    """An error that was found, and what else might have caused it.

    Attributes
    ----------
    found : Hypothesis
        Tested beside all that were found before it.
    same : tuple of str
        Groups that explain it as well.
    """

    found: Hypothesis
    same: tuple[str, ...]


@dataclass(frozen=True)
class SystematicErrors:
    """The outcome of all tests.

    Attributes
    ----------
    tested : tuple of Hypothesis
        Each group alone, in the first round.
    errors : tuple of SystematicError
        In the order in which they were found.
    estimates : tuple of Estimate
        Of everything found, estimated together.
    untested : tuple of str
        Groups that could not be freed, with the reason.
    own : tuple of Estimate
        Values that the block itself leaves free, from its integrated adjustment.
    """

    tested: tuple[Hypothesis, ...]
    errors: tuple[SystematicError, ...]
    estimates: tuple[Estimate, ...]
    untested: tuple[str, ...]
    own: tuple[Estimate, ...]


def systematic_errors(block: Block, done: Callable[[], None] = lambda: None) -> SystematicErrors:
    """Look for systematic errors of the georeference.

    Parameters
    ----------
    block : Block
        With positions (see `as_mounted`) and control.
    done : callable
        Called after each adjustment.

    Returns
    -------
    SystematicErrors

    Raises
    ------
    PhotocalError
        When the block cannot be adjusted as it is.
    """
    base, solution = block, _adjusted(block)
    first = solution
    change = best_change(block, solution.cameras[0], LOOSE_CAMERA)
    names = groups_of(block) + (() if change is None else (CHANGE,))
    accepted: list[str] = []
    errors: list[SystematicError] = []
    tested: tuple[Hypothesis, ...] = ()
    untested: list[str] = []
    for turn in range(_ROUNDS):
        tries: dict[str, Hypothesis] = {}
        for name in names:
            if name in accepted or _settled(name, accepted):
                continue
            try:
                freed = with_freed(base, name, change)
                tries[name] = _compare(block, solution, name, freed, _adjusted(freed), len(names))
            except (IllPosedError, NotConvergedError) as refusal:
                if turn == 0:
                    untested.append(f"{name}: {refusal.what}")
            done()
        if turn == 0:
            tested = tuple(tries.values())
        best = _best(tuple(tries.values()), solution.observations)
        if best is None:
            break
        errors.append(SystematicError(best, _same(best, tuple(tries.values()))))
        accepted.append(best.name)
        base = with_freed(base, best.name, change)
        solution = _adjusted(base)
    estimates = tuple(e for name in accepted for e in estimates_of(block, base, solution, name))
    own = tuple(
        e for name in MOUNTED if left_free(block, name) for e in estimates_of(block, block, first, name)
    )
    return SystematicErrors(tested, tuple(errors), estimates, tuple(untested), own)


def _settled(name: str, accepted: list[str]) -> bool:
    """Whether a group is part of one that was accepted: two principal distances leave no common one."""
    distances = ("principal distance", CHANGE)
    return name in distances and any(other in accepted for other in distances)


def _adjusted(block: Block) -> Solution:
    return adjust(assemble(block).network)


def _compare(
    block: Block, before: Solution, name: str, freed: Block, after: Solution, tests: int
) -> Hypothesis:
    estimates = estimates_of(block, freed, after, name)
    gain = max(before.chi_squared - after.chi_squared, 0.0)
    unknowns = len(estimates)
    # As many weak observations as unknowns came in: the degrees of freedom are those of the data.
    freedom = max(before.degrees_of_freedom - unknowns, 1)
    factor = max(after.chi_squared / freedom, 1e-300)
    f = gain / unknowns / factor
    critical = float(stats.f(unknowns, freedom).ppf(1.0 - SIGNIFICANCE / tests))
    return Hypothesis(name, gain / factor, unknowns, f, critical, f > critical, estimates)


def _best(tries: tuple[Hypothesis, ...], observations: int) -> Hypothesis | None:
    """Most probable significant hypothesis (Schwarz 1978): gain less ln(n) for each unknown."""
    significant = [one for one in tries if one.significant]
    if not significant:
        return None
    others = [one for one in significant if one.name != CHANGE]
    change = [one for one in significant if one.name == CHANGE and _relative_change(one) > _NOTEWORTHY]
    best = max(others, key=lambda one: one.gain - one.unknowns * math.log(observations), default=None)
    # Two principal distances imitate a wrong height where there are two heights: they must explain more.
    if change and (best is None or best.gain < _as_good(change[0])):
        return change[0]
    return best


def _relative_change(one: Hypothesis) -> float:
    """Difference of two principal distances over one of them."""
    before, after = one.estimates[0].value, one.estimates[1].value
    return abs(after - before) / before


def _as_good(one: Hypothesis) -> float:
    """Gain from which another hypothesis explains as much."""
    return min(one.gain - _AS_GOOD, _SAME_GAIN * one.gain)


def _same(best: Hypothesis, tries: tuple[Hypothesis, ...]) -> tuple[str, ...]:
    """Other hypotheses that explain nearly all of what the best one explains."""
    limit = _as_good(best)
    silent = ("strip shifts", CHANGE)
    # A shift of its own for each strip can imitate every other error, two principal distances those of
    # c and of the height: that says nothing.
    return tuple(
        one.name
        for one in tries
        if one is not best and one.name not in silent and one.significant and one.gain >= limit
    )

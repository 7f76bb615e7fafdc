"""The search for systematic errors: as few groups of freed values as explain the contradictions of a block.

Stepwise: the most probable group is accepted, then the others are tested beside it; after each step a group
that the others make needless is given up again. So what imitates a cause gives way to the cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.solution import Solution
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.georeferencing.camera_change import best_change, unknowns_of_change
from photocal.georeferencing.freed_groups import (
    CHANGE,
    LOOSE_CAMERA,
    MOUNTED,
    PRINCIPAL_DISTANCE,
    Estimate,
    estimates_of,
    groups_of,
    left_free,
    with_freed,
)
from photocal.georeferencing.hypotheses import (
    Fit,
    Hypothesis,
    as_good,
    causes_first,
    compare,
    most_probable,
)

_ROUNDS = 4


@dataclass(frozen=True)
class SystematicError:
    """An error that was found, and what else might have caused it.

    Attributes
    ----------
    found : Hypothesis
        Tested beside those before it.
    alternatives : tuple of Hypothesis
        Groups that explain it as well.
    """

    found: Hypothesis
    alternatives: tuple[Hypothesis, ...]

    @property
    def same(self) -> tuple[str, ...]:
        """Names of the alternatives."""
        return tuple(one.name for one in self.alternatives)


@dataclass(frozen=True)
class SystematicErrors:
    """The outcome of all tests.

    Attributes
    ----------
    tested : tuple of Hypothesis
        Each group alone, in the first round.
    errors : tuple of SystematicError
        Those that are needed, the gravest first; what imitates others comes after them.
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
    """Look for systematic errors of the georeference."""
    first = adjust(assemble(block).network)
    done()
    search = _Search(block, first, done)
    accepted: tuple[str, ...] = ()
    tested: tuple[Hypothesis, ...] = ()
    for turn in range(_ROUNDS):
        tries = search.beside(accepted)
        if turn == 0:
            tested = tries
        best = most_probable(tries, first.observations)
        if best is None:
            break
        kept = search.needed((*accepted, best.name))
        if set(kept) == set(accepted):
            break
        accepted = kept
    errors = search.errors(accepted)
    own = tuple(
        e for name in MOUNTED if left_free(block, name) for e in estimates_of(block, block, first, name)
    )
    return SystematicErrors(
        tested,
        errors,
        search.together(accepted),
        tuple(f"{name}: {reason}" for name, reason in search.refused.items()),
        own,
    )


class _Search:
    """Adjustments of one block with groups freed, each set of groups once."""

    def __init__(self, block: Block, first: Solution, done: Callable[[], None]) -> None:
        self._block, self._done = block, done
        self._fits = {frozenset[str](): Fit(first.chi_squared, first.degrees_of_freedom, {})}
        self._change = best_change(block, first.cameras[0], LOOSE_CAMERA)
        # A second camera is made of the first one, so it comes before what is freed in both.
        self._names = (() if self._change is None else (CHANGE,)) + groups_of(block)
        self.refused: dict[str, str] = {}

    def beside(self, accepted: tuple[str, ...]) -> tuple[Hypothesis, ...]:
        """Test all other groups beside those that were accepted."""
        tries = []
        for name in self._names:
            # Two principal distances leave nothing of a common one.
            if name in accepted or (name == PRINCIPAL_DISTANCE and CHANGE in accepted):
                continue
            one = self._tested(name, accepted)
            if one is not None:
                tries.append(one)
        return tuple(tries)

    def needed(self, accepted: tuple[str, ...]) -> tuple[str, ...]:
        """Give up groups, the least significant one first, until each is needed beside the others."""
        while len(accepted) > 1:
            tries = (self._tested(name, _less(accepted, name)) for name in accepted)
            weakest = min((one for one in tries if one), key=lambda one: one.f / one.critical, default=None)
            if weakest is None or weakest.significant:
                break
            accepted = _less(accepted, weakest.name)
        return accepted

    def errors(self, accepted: tuple[str, ...]) -> tuple[SystematicError, ...]:
        """Give the accepted groups, each beside those before it, and what could stand in their places."""
        found: list[SystematicError] = []
        left = accepted
        while left:
            tries = self.beside(tuple(one.found.name for one in found))
            mine = tuple(one for one in tries if one.name in left)
            if not mine:
                break
            gravest = max(causes_first(mine), key=lambda one: one.gain)
            found.append(SystematicError(gravest, as_good(gravest, tries)))
            left = _less(left, gravest.name)
        return tuple(found)

    def together(self, accepted: tuple[str, ...]) -> tuple[Estimate, ...]:
        """Give the values of all accepted groups from one adjustment."""
        fit = self._fit(frozenset(accepted))
        return tuple(e for name in accepted for e in fit.estimates[name])

    def _tested(self, name: str, others: tuple[str, ...]) -> Hypothesis | None:
        """Test a group beside others; None when it cannot be freed."""
        try:
            before, after = self._fit(frozenset(others)), self._fit(frozenset((*others, name)))
        except (IllPosedError, NotConvergedError) as refusal:
            if not others:
                self.refused[name] = refusal.what
            return None
        unknowns = unknowns_of_change(self._block) if name == CHANGE else len(after.estimates[name])
        return compare(name, before, after, unknowns, len(self._names))

    def _fit(self, groups: frozenset[str]) -> Fit:
        if groups not in self._fits:
            freed = self._block
            for name in self._names:
                if name in groups:
                    freed = with_freed(freed, name, self._change)
            solution = adjust(assemble(freed).network)
            estimates = {name: estimates_of(self._block, freed, solution, name) for name in groups}
            self._fits[groups] = Fit(solution.chi_squared, solution.degrees_of_freedom, estimates)
            self._done()
        return self._fits[groups]


def _less(names: tuple[str, ...], one: str) -> tuple[str, ...]:
    return tuple(name for name in names if name != one)

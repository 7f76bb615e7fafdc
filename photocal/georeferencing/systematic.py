"""The search for systematic errors: as few faults of the table as explain the contradictions of a block.

A fault is a hypothesis: its values are freed in the integrated adjustment, and an F test of the fall of v'Pv
says whether it is needed beside the others that are freed. The condensed normal equations screen all of them
at once, an adjustment confirms those that may be. Stepwise: the most probable one is accepted, then
the others are tested beside it; after each step what the others make needless is given up again. So what
imitates a cause gives way to the cause; what explains the same is said with it: the flight cannot tell.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from photocal.adjustment.adjust import minimum_of
from photocal.adjustment.covariance import Shared, shared
from photocal.adjustment.factored import factorised
from photocal.adjustment.groups import GroupTest
from photocal.adjustment.ledger import because
from photocal.adjustment.solution import Solution
from photocal.base import policy
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.findings.hypotheses import FAULTS, Fault, fault
from photocal.georeferencing.freed_groups import (
    Change,
    Estimate,
    Opened,
    beside,
    best_change,
    estimates_of,
    faults_of,
    left_free,
    of_camera,
    opened,
    positions_moved,
    unknowns_of,
    with_agreeing,
    with_freed,
    wrong_sigma,
)

_ROUNDS = 4


@dataclass(frozen=True)
class Hypothesis:
    """One fault of the table, its values freed.

    factor: variance factor that is left, by which gains are judged where it is above 1.
    f, critical: gain / unknowns over that, and its limit.
    moved, on_c: what it moves positions and principal distances by, in their standard deviations.
    """

    name: str
    gain: float
    factor: float
    unknowns: int
    f: float
    critical: float
    significant: bool
    estimates: tuple[Estimate, ...]
    moved: float
    on_c: float


@dataclass(frozen=True)
class FaultFit:
    """What the tests need of an adjustment; its covariances would fill the memory.

    c, sigma_c (cameras,): principal distances, with a sigma of 0 where they are held.
    estimates: of each fault that was freed.
    moved: how far each moves the positions, in their stated standard deviations.
    """

    chi_squared: float
    degrees_of_freedom: int
    c: Floats
    sigma_c: Floats
    estimates: dict[str, tuple[Estimate, ...]]
    moved: dict[str, float]


def _shared(first: Solution) -> Shared:
    freedom, common = first.degrees_of_freedom, first.state.common
    cameras = first.cameras, first.camera_covariance
    return Shared(first.chi_squared, freedom, *cameras, common, first.common_covariance)


def _fit(solution: Shared, estimates: dict[str, tuple[Estimate, ...]], moved: dict[str, float]) -> FaultFit:
    c, sigma = solution.cameras[:, 0], np.sqrt(solution.camera_covariance[:, 0, 0])
    return FaultFit(solution.chi_squared, solution.degrees_of_freedom, c, sigma, estimates, moved)


def compare(
    name: str, before: FaultFit, after: FaultFit, unknowns: int, tests: int, stated: FaultFit | None = None
) -> Hypothesis:
    """Test a fault.

    stated: the block as it was stated, where other standard deviations agree with the residuals.
    """
    gain = max(before.chi_squared - after.chi_squared, 0.0)
    # As many weak observations as unknowns came in: the degrees of freedom are those of the data.
    freedom = max(before.degrees_of_freedom - unknowns, 1)
    factor = after.chi_squared / freedom
    # Rays that are better than stated make positions and what was measured of the mounting no better.
    f = gain / unknowns / max(factor, 1.0)
    critical = float(stats.f(unknowns, freedom).ppf(1.0 - policy.SIGNIFICANCE / tests))
    on_c = _moved_surely(before, after, stated or before)
    estimates, moved = after.estimates[name], after.moved[name]
    return Hypothesis(name, gain, factor, unknowns, f, critical, f > critical, estimates, moved, on_c)


def _moved_surely(before: FaultFit, after: FaultFit, stated: FaultFit) -> float:
    """The largest change of a principal distance that is sure, in its standard deviations before.

    What was freed costs precision, and may move c by as much (Hausman 1978). Where smaller sigmas of
    positions agree with the residuals, c is judged as it was stated: errors of GNSS that stay alike for
    minutes scatter less than they are large, and drag c along.
    """
    # A second camera has a second c: what it does is judged by itself.
    count = len(before.c)
    change = np.abs(after.c[:count] - before.c)
    spread = np.sqrt(np.maximum(after.sigma_c[:count] ** 2 - before.sigma_c**2, 0.0))
    sure = (before.sigma_c > 0.0) & (change > stats.norm.isf(policy.SIGNIFICANCE / 2.0) * spread)
    wider = stated.sigma_c > before.sigma_c
    moved = np.where(wider, np.abs(after.c[:count] - stated.c), change)
    sigma = np.maximum(stated.sigma_c, before.sigma_c)
    return float(np.max(np.divide(moved, sigma, out=0.0 * change, where=sure)))


def most_probable(
    tries: tuple[Hypothesis, ...], observations: int, table: tuple[Fault, ...] = FAULTS
) -> Hypothesis | None:
    """Choose the most probable significant hypothesis (Schwarz 1978): gain less ln(n) for each unknown."""
    penalty = _scale(tries) * math.log(observations)
    significant = tuple(
        hypothesis for hypothesis in tries if hypothesis.significant and _noteworthy(hypothesis)
    )
    tried = causes_first(significant, table)
    return max(tried, key=lambda hypothesis: hypothesis.gain - hypothesis.unknowns * penalty, default=None)


def causes_first(tries: tuple[Hypothesis, ...], table: tuple[Fault, ...] = FAULTS) -> tuple[Hypothesis, ...]:
    """Leave out what can look like everything, where there are others.

    A shift of its own for each strip can imitate every other error, a second camera those of c and of the
    height where there are two heights: what they make needless is given up when nothing else is left.
    """
    like_all = {entry.code for entry in table if "*" in entry.imitates}
    return tuple(hypothesis for hypothesis in tries if hypothesis.name not in like_all) or tries


def _noteworthy(hypothesis: Hypothesis) -> bool:
    """Whether an error is larger than what was stated of positions, or of one camera, allows."""
    known = fault(hypothesis.name)
    if known is None or known.each != "part":
        return max(hypothesis.moved, hypothesis.on_c) > policy.STATED
    before, after = hypothesis.estimates[0].value, hypothesis.estimates[1].value
    return abs(after - before) / before > policy.OTHER_C


def _scale(tries: tuple[Hypothesis, ...]) -> float:
    """Variance factor of the observations: what the hypothesis that explains most leaves of it."""
    return max(1.0, min((trial.factor for trial in tries), default=1.0))


def as_good(best: Hypothesis, tries: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
    """Give the other hypotheses that explain nearly all of what the best explains."""
    limit = min(best.gain - policy.AS_GOOD * _scale(tries), policy.SAME_GAIN * best.gain)
    silent = {entry.code for entry in FAULTS if entry.each == "strip" or best.name in entry.contains}
    heard = (trial for trial in tries if trial.name not in {best.name, *silent})
    return tuple(trial for trial in heard if trial.significant and trial.gain >= limit)


@dataclass(frozen=True)
class SystematicError:
    """An error that was found, and what else might have caused it.

    hypothesis: tested beside those before it.
    alternatives: groups that explain it as well.
    """

    hypothesis: Hypothesis
    alternatives: tuple[Hypothesis, ...]

    @property
    def same(self) -> tuple[str, ...]:
        """Names of the alternatives."""
        return tuple(alternative.name for alternative in self.alternatives)


@dataclass(frozen=True)
class SystematicErrors:
    """The outcome of all tests.

    tested: each group alone, in the first round.
    errors: those that are needed, the gravest first; what imitates others comes after them.
    estimates: of everything found, estimated together.
    untested: groups that could not be freed, with the reason.
    free_in_block: values that the block itself leaves free, from its integrated adjustment.
    sigmas: groups whose stated standard deviations are wrong by a factor, which explains the block better
        than any error does; the errors were looked for with the standard deviations that agree.
    """

    tested: tuple[Hypothesis, ...]
    errors: tuple[SystematicError, ...]
    estimates: tuple[Estimate, ...]
    untested: tuple[str, ...]
    free_in_block: tuple[Estimate, ...]
    sigmas: tuple[GroupTest, ...] = ()


def systematic_errors(given: Opened, done: Callable[[], None] = lambda: None) -> SystematicErrors:
    """Look for systematic errors of the georeference, the faults of a table."""
    table = given.table
    sigmas, stated, of_c = list[GroupTest](), given.block.positions.stated(), list[FaultFit]()
    while True:
        first = given.first
        larger = np.maximum(stated, given.block.positions.stated())
        search = _Search(given, larger, done, *of_c[:1])
        of_c.append(search.first)
        alone = search.beside(())
        # An error competes by what it gains, less the logarithm of the observations for each unknown.
        unknown = math.log(first.observations)
        gains = (trial.gain - (trial.unknowns - 1) * unknown for trial in alone if trial.significant)
        wrong = wrong_sigma(first, max(gains, default=0.0))
        if wrong is None or wrong.name in (group.name for group in sigmas):
            break
        block, settled = with_agreeing(given.block, wrong)
        sigmas.append(settled)
        given = opened(block, table=table)
    accepted: tuple[str, ...] = ()
    for turn in range(_ROUNDS):
        tries = search.beside(accepted) if turn else alone
        best = most_probable(tries, first.observations, table)
        if best is None:
            break
        kept = search.needed((*accepted, best.name))
        if set(kept) == set(accepted):
            break
        accepted = kept
    errors = search.errors(accepted)
    free_in_block = tuple(
        e
        for entry in table
        if entry.frees and not of_camera(entry) and left_free(given.block, entry)
        for e in estimates_of(given.block, given.block, _shared(first), entry)
    )
    untested = tuple(f"{name}: {reason}" for name, reason in search.refused.items())
    return SystematicErrors(alone, errors, search.together(accepted), untested, free_in_block, tuple(sigmas))


class _Search:
    """Tests of one block's faults: the condensed equations screen them, adjustments confirm what may be."""

    def __init__(
        self,
        given: Opened,
        stated: Floats,
        done: Callable[[], None],
        as_stated: FaultFit | None = None,
    ) -> None:
        self._given, self._stated, self._done = given, stated, done
        self.first = _fit(_shared(given.first), {}, {})
        self._fits, self._as_stated = {frozenset[str](): self.first}, as_stated
        part = next((entry for entry in given.table if entry.each == "part"), None)
        found = best_change(given, part) if part else None
        self._change: Change | None = found[0] if found else None
        self._split = found[1] if found else given.whole
        # A second camera is made of the first one, so it stands before what is freed in both.
        self._faults = {cause.code: cause for cause in faults_of(given.block, self._change, given.table)}
        self.refused: dict[str, str] = {}

    def beside(self, accepted: tuple[str, ...]) -> tuple[Hypothesis, ...]:
        """Test all other groups beside those that were accepted."""
        # Two principal distances leave nothing of a common one.
        taken = {code for name in accepted for code in (name, *self._faults[name].contains)}
        screened = [
            self._tested(name, accepted, self._predicted) for name in self._faults if name not in taken
        ]
        likely = [
            trial for trial in screened if trial is not None and trial.f > policy.SCREENED * trial.critical
        ]
        least = policy.SCREENED * max((trial.gain for trial in likely), default=0.0)
        tries = (
            self._tested(trial.name, accepted) if trial in likely and trial.gain >= least else trial
            for trial in screened
            if trial is not None
        )
        return tuple(filter(None, tries))

    def needed(self, accepted: tuple[str, ...]) -> tuple[str, ...]:
        """Give up groups, the least significant one first, until each is needed beside the others."""
        while len(accepted) > 1:
            tries = (self._tested(name, _less(accepted, name)) for name in accepted)
            weakest = min(filter(None, tries), key=lambda tried: tried.f / tried.critical, default=None)
            if weakest is None or weakest.significant:
                break
            accepted = _less(accepted, weakest.name)
        return accepted

    def errors(self, accepted: tuple[str, ...]) -> tuple[SystematicError, ...]:
        """Give the accepted groups, each beside those before it, and what could stand in their places."""
        errors: list[SystematicError] = []
        left = accepted
        while left:
            before = tuple(error.hypothesis.name for error in errors)
            tries = self.beside(before)
            remaining = tuple(trial for trial in tries if trial.name in left)
            if not remaining:
                break
            gravest = max(causes_first(remaining, tuple(self._faults.values())), key=lambda trial: trial.gain)
            gravest = self._tested(gravest.name, before) or gravest
            errors.append(SystematicError(gravest, as_good(gravest, tries)))
            left = _less(left, gravest.name)
        return tuple(errors)

    def together(self, accepted: tuple[str, ...]) -> tuple[Estimate, ...]:
        """Give the values of all accepted groups from one adjustment."""
        fit = self._adjusted(frozenset(accepted))
        return tuple(e for name in accepted for e in fit.estimates[name])

    def _tested(
        self, name: str, others: tuple[str, ...], fit: Callable[[frozenset[str]], FaultFit] | None = None
    ) -> Hypothesis | None:
        """Test a group beside others; None when it cannot be freed."""
        fit = fit or self._adjusted
        try:
            before, after = fit(frozenset(others)), fit(frozenset((*others, name)))
        except (IllPosedError, NotConvergedError) as refusal:
            if not others:
                self.refused[name] = refusal.what
            return None
        unknowns = unknowns_of(self._given.block, self._faults[name], after.estimates[name])
        return compare(name, before, after, unknowns, len(self._faults), self._as_stated)

    def _adjusted(self, groups: frozenset[str]) -> FaultFit:
        if groups not in self._fits:
            chosen, freed = self._freed(groups)
            network = assemble(freed).network
            start = beside(network, self._given.first)
            with because(f"fault tested: {' and '.join(cause.code for cause in chosen)}"):
                minimum = minimum_of(network, state=start)
            self._fits[groups] = self._of(chosen, freed, shared(factorised(*minimum)))
            self._done()
        return self._fits[groups]

    def _predicted(self, groups: frozenset[str]) -> FaultFit:
        """What an adjustment would give, to first order at the minimum without any group."""
        chosen, freed = self._freed(groups)
        whole = self._split if len(freed.cameras) > len(self._given.block.cameras) else self._given.whole
        return self._of(chosen, freed, whole.with_sigmas(freed.cameras, freed.mounting))

    def _freed(self, groups: frozenset[str]) -> tuple[list[Fault], Block]:
        chosen, freed = [cause for name, cause in self._faults.items() if name in groups], self._given.block
        for cause in chosen:
            freed = with_freed(freed, cause, self._change)
        return chosen, freed

    def _of(self, chosen: list[Fault], freed: Block, solution: Shared) -> FaultFit:
        block = self._given.block
        estimates = {cause.code: estimates_of(block, freed, solution, cause) for cause in chosen}
        moved = {cause.code: positions_moved(block, solution, cause, self._stated) for cause in chosen}
        return _fit(solution, estimates, moved)


def _less(names: tuple[str, ...], removed: str) -> tuple[str, ...]:
    return tuple(name for name in names if name != removed)

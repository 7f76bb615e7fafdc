"""Selection: the most probable causes of one network, each judged beside others in one system."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from photocal.adjustment.removed import MOST_REMOVALS
from photocal.base.errors import IllPosedError
from photocal.base.policy import policy
from photocal.hypotheses.agreement import agreed
from photocal.hypotheses.causes import Candidates, Cause
from photocal.hypotheses.judged import Hypothesis, Stated, judge
from photocal.hypotheses.system import Beyond
from photocal.hypotheses.table import Fault

# Causes that are accepted beside each other in one system.
_CAUSES = 4
# Causes about which images are asked at once. Few images are left out one by one, which costs as much as
# some twenty fields beside another; the sandwich of many costs as much for each field.
_ASKED, _ASKED_OF_FEW = 4, 16


@dataclass(frozen=True)
class SystematicError:
    """An error that was found, and what else might have caused it.

    hypothesis: tested beside those before it.
    alternatives: groups that explain it as well.
    share: of what v'Pv is too large by, in the block as it was given.
    """

    hypothesis: Hypothesis
    alternatives: tuple[Hypothesis, ...]
    cause: Cause | None = None
    share: float = math.nan

    @property
    def same(self) -> tuple[str, ...]:
        """Names of the alternatives."""
        return tuple(dict.fromkeys(alternative.name for alternative in self.alternatives))


class Selection:
    """Tests of one network's causes, each beside others, in one system."""

    def __init__(self, these: Candidates, stated: Stated) -> None:
        self.these, self.stated = these, stated
        self._families = max(
            len(
                {
                    (c.fault.code, c.field and c.field.name)
                    if c.fault.each == "field"
                    else (c.fault.code, "")
                    for c in these.causes
                }
            ),
            1,
        )
        self._agreed = dict[tuple[str, str], bool]()
        self._known = dict[tuple[object, ...], Hypothesis | None]()
        self._before = dict[tuple[object, ...], Beyond]()
        self.refused = dict[str, str]()

    def beside(self, accepted: tuple[Cause, ...]) -> dict[Cause, Hypothesis]:
        """Test all other causes beside those that were accepted."""
        # Two principal distances leave nothing of a common one.
        taken = {code for cause in accepted for code in (*cause.fault.contains, *_once(cause))}
        keys = {cause.key for cause in accepted}
        members = {(cause.fault.where, m) for cause in accepted for m in _own(cause)}
        tried = dict[Cause, Hypothesis]()
        for cause in self.these.causes:
            if cause.key in keys or cause.fault.code in taken:
                continue
            if any((cause.fault.where, m) in members for m in _own(cause)):
                continue
            tested = self._tested(cause, accepted)
            if tested is not None and _possible(cause, tested):
                tried[cause] = tested
        return tried

    def chosen(self, alone: dict[Cause, Hypothesis]) -> tuple[Cause, ...]:
        """Accept the most probable cause, then the next beside it, and give up what becomes needless."""
        accepted, tries = tuple[Cause, ...](), alone
        for _ in range(_CAUSES):
            best = self._most_probable(tries)
            if best is None:
                break
            kept = self.needed((*accepted, best))
            if {cause.key for cause in kept} == {cause.key for cause in accepted}:
                break
            accepted = kept
            tries = self.beside(accepted)
        return accepted

    def _most_probable(self, tries: dict[Cause, Hypothesis]) -> Cause | None:
        """Choose the most probable significant cause (Schwarz 1978), about which the images agree."""
        significant = [
            cause for cause, tested in tries.items() if tested.significant and _noteworthy(cause, tested)
        ]
        ranked = sorted(significant, key=lambda one: -_probable(one, tries[one]))
        images = len(self.these.adjusted.network.image_names)
        at_once = _ASKED_OF_FEW if images <= MOST_REMOVALS else _ASKED
        for first in range(0, len(ranked), at_once):
            some = ranked[first : first + at_once]
            self._ask_images({cause: tries[cause] for cause in some})
            for cause in some:
                if self._agreed.get(cause.key, True):
                    return cause
        return None

    def _ask_images(self, tries: dict[Cause, Hypothesis]) -> None:
        """Ask the images of a camera about fields of its rays; of all else they are not asked."""
        asked = {c: tries[c] for c in tries if c.field is not None and c.key not in self._agreed}
        if not asked:
            return
        fields = [cause.field for cause in asked if cause.field is not None]
        found = agreed(self.these.adjusted, fields, list(map(_amount, asked.values())))
        for cause, p in zip(asked, found, strict=True):
            self._agreed[cause.key] = p < policy.family_significance / self._families / cause.choices

    def needed(self, accepted: tuple[Cause, ...]) -> tuple[Cause, ...]:
        """Give up causes, the least significant one first, until each is needed beside the others."""
        while len(accepted) > 1:
            tries = {cause: self._tested(cause, _others(accepted, cause)) for cause in accepted}
            known = {cause: tested for cause, tested in tries.items() if tested is not None}
            weakest = min(known, key=lambda cause: known[cause].f / known[cause].critical, default=None)
            if weakest is None or known[weakest].significant:
                break
            accepted = _others(accepted, weakest)
        return accepted

    def errors(self, accepted: tuple[Cause, ...]) -> list[SystematicError]:
        """Give the accepted causes, each beside those before it, and what could stand in their places."""
        errors, left, before = list[SystematicError](), accepted, tuple[Cause, ...]()
        while left:
            tries = self.beside(before)
            remaining = [cause for cause in left if cause in tries]
            if not remaining:
                break
            gravest = max(remaining, key=lambda cause: tries[cause].gain)
            best = tries[gravest]
            errors.append(SystematicError(best, as_good(gravest, best, tries), gravest))
            before, left = (*before, gravest), _others(left, gravest)
        return errors

    def _tested(self, cause: Cause, others: tuple[Cause, ...]) -> Hypothesis | None:
        """Test a cause beside others; None when it cannot be freed."""
        beside = tuple(sorted(other.key for other in others))
        key = (cause.key, *beside)
        if key in self._known:
            return self._known[key]
        tested: Hypothesis | None
        try:
            before = self._before[beside] if beside in self._before else self.these.beyond(others)
            self._before[beside] = before
            tested = judge(self.these, cause, others, before, self._families, self.stated)
        except IllPosedError as refusal:
            tested = None
            if not others:
                self.refused[cause.fault.code] = refusal.what
        self._known[key] = tested
        return tested


def _amount(tested: Hypothesis) -> float:
    """Amount of a field: of a change, the difference of both values."""
    first, *rest = tested.estimates
    return rest[0].value - first.value if rest else first.correction


def as_good(cause: Cause, best: Hypothesis, tries: dict[Cause, Hypothesis]) -> tuple[Hypothesis, ...]:
    """Give the other hypotheses that explain nearly all of what the best explains."""
    scale = max(1.0, min((trial.factor for trial in tries.values()), default=1.0))
    limit = min(best.gain - policy.as_good * scale, policy.same_gain * best.gain)
    alike = []
    for other, trial in tries.items():
        # A shift of its own for each strip can imitate every other error; parts and wholes are one matter.
        if other is cause or other.fault.each == "strip" or _one_matter(cause, other):
            continue
        if trial.significant and trial.gain >= limit:
            alike.append(trial)
    return tuple(sorted(alike, key=lambda trial: -trial.value))


def _one_matter(cause: Cause, other: Cause) -> bool:
    """Whether two causes are no rivals: the same code elsewhere, or one contains the other."""
    a, b = cause.fault, other.fault
    family = {a.code, a.kind_of} & {b.code, b.kind_of} - {""}
    of_datum = a.code != b.code and {a.kind_of, b.kind_of} == {"datum-shift"}
    return (bool(family) and not of_datum) or b.code in a.contains or a.code in b.contains


def _once(cause: Cause) -> tuple[str, ...]:
    """A fault of the whole block, or of one place in it, is accepted once."""
    return (cause.fault.code,) if cause.fault.each in ("block", "strip", "part", "pair", "trend") else ()


def _own(cause: Cause) -> tuple[int, ...]:
    """Control points or positions that are concerned: what two causes do not share."""
    return cause.members if cause.fault.each in ("image", "point", "pair") else ()


def _others(causes: tuple[Cause, ...], one: Cause) -> tuple[Cause, ...]:
    return tuple(cause for cause in causes if cause.key != one.key)


def left_to_seek(table: tuple[Fault, ...], accepted: Sequence[Cause]) -> tuple[Fault, ...]:
    """What is left to be looked for: what is free is free."""
    gone = {code for cause in accepted for code in (*_once(cause), *cause.fault.contains)}
    return tuple(entry for entry in table if entry.code not in gone)


def _possible(cause: Cause, tested: Hypothesis) -> bool:
    """Whether nature makes such an amount: else it would be something else."""
    if (cause.field is None and cause.trend is None) or not tested.estimates:
        return True
    # Without its own amount a trend is the shift that goes with it, which has a name of its own.
    amount, unsure = tested.estimates[0].correction, policy.times_999 * tested.estimates[0].sigma
    if cause.fault.code == "rolling-shutter":
        # Rows are read one after the other, never backwards.
        return amount > 0.0
    if cause.fault.code == "earth-curvature":
        # The earth has one: it was neglected, or applied to coordinates that know of it.
        return abs(abs(amount) - 1.0) <= unsure
    return abs(amount) > unsure if cause.field is None else abs(amount) - unsure <= cause.field.most


def _probable(cause: Cause, tested: Hypothesis) -> float:
    """Give Schwarz's value, less what speaks against a read-out that no shutter makes."""
    if cause.field is None or cause.field.code != "rolling-shutter" or cause.field.unit != "s":
        return tested.value
    readout = tested.estimates[0]
    fast = readout.correction + policy.times_999 * readout.sigma < policy.least_readout_s
    return tested.value - (policy.as_good if fast else 0.0)


def _noteworthy(cause: Cause, tested: Hypothesis) -> bool:
    """Whether an error is larger than what was stated of positions, or of one camera, allows."""
    if cause.fault.each == "part" and tested.estimates:
        before, after = tested.estimates[0].value, tested.estimates[1].value
        return abs(after - before) / before > policy.other_c
    return max(tested.moved, tested.on_c) > policy.stated

"""Which doubts say what is wrong, and which only that something is: the former stand first.

A surveyor who reads two causes does not know which to believe. The search for systematic errors names no
more than the observations need; here the other stages come in: what positions without fixed ambiguities
contradict, or images whose rows are not of one moment, is no proof against base, antenna, lever arm or zoom.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from photocal.findings.hypotheses import FAULTS, fault
from photocal.run.doubt import Doubt

# With two thirds of the positions fixed, it is they that carry what is found.
_JUDGED_FROM_PERCENT = 200.0 / 3.0
# What else looks like what the search blames: told instead of it.
_EXCUSES = {
    "rolling-shutter": "A rolling shutter can do that: judge it again when the flight is free of it.",
    "ppk-not-fixed": "Positions without fixed ambiguities can do that: judge it again when they are fixed.",
}


def causes_first(doubts: Iterable[Doubt], fixed_percent: float) -> tuple[Doubt, ...]:
    """Mark what follows from other doubts, and put it behind them.

    Parameters
    ----------
    fixed_percent : float
        Share of the positions that have fixed ambiguities.

    Returns
    -------
    tuple of Doubt
        Causes, consequences, notes; each kind in the order given.
    """
    given = tuple(doubts)
    blamed, why = _excused(given, fixed_percent)
    judged = [_not_judged(one, why) if _blames(one, blamed) else one for one in given]
    codes = {one.code for one in judged}
    symptoms = {code for one in FAULTS if one.code in codes for code in one.symptoms}
    judged = [replace(one, consequence=True) if one.code in symptoms else one for one in judged]
    order = ("warning", "consequence", "note")
    return tuple(sorted(judged, key=lambda one: order.index(one.kind)))


def _excused(given: tuple[Doubt, ...], fixed_percent: float) -> tuple[frozenset[str], str]:
    """Give the codes that something else looks like, and what that is; nothing where all is judged."""
    told = {one.code for one in given}
    if fixed_percent >= _JUDGED_FROM_PERCENT:
        told.discard("ppk-not-fixed")
    for code, why in _EXCUSES.items():
        entry = fault(code)
        if entry is not None and code in told:
            return frozenset(entry.imitates), why
    return frozenset(), ""


def _blames(one: Doubt, codes: frozenset[str]) -> bool:
    """Whether the search for systematic errors blames something of these."""
    return one.stage == "georeferencing" and one.code in codes


def _not_judged(one: Doubt, why: str) -> Doubt:
    """The same, where something else is known to be wrong that looks like it."""
    return replace(one, code="not-judged", text=f"as if {one.code}: {one.text} {why}", consequence=True)

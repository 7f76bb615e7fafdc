"""Which doubts say what is wrong, and which only that something is: the former stand first.

A surveyor who reads two causes does not know which to believe. The search for systematic errors names no more
than the observations need; here the other stages come in: what positions without fixed ambiguities contradict
is no proof against base, antenna or lever arm.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from photocal.run.doubt import Doubt

# Whatever is wrong shows at ground points and in tests; a method may be refused for it.
_SYMPTOMS = frozenset(
    {
        "check-outside-prediction",
        "control-outside-prediction",
        "prediction-too-good",
        "global-test",
        "method-refused",
    }
)
# Errors of positions against control, however they are called.
_OF_POSITIONS = frozenset(
    {
        "antenna-height",
        "base-position",
        "datum-shift",
        "lever-arm",
        "lever-arm-axes",
        "strip-shifts",
        "time-offset",
    }
)
# What makes points or positions wrong; images or attitudes that are missing make nothing wrong.
_CAUSES = _OF_POSITIONS | {
    "autopilot-clock",
    "boresight",
    "camera-change",
    "control-mistyped",
    "event-time-base",
    "height-kind",
    "ppk-not-fixed",
    "principal-distance",
    "principal-point",
}

# With two thirds of the positions fixed, it is they that carry what is found.
_JUDGED_FROM_PERCENT = 200.0 / 3.0


def causes_first(doubts: Iterable[Doubt], fixed_percent: float) -> tuple[Doubt, ...]:
    """Mark what follows from other doubts, and put it behind them.

    Parameters
    ----------
    doubts : iterable of Doubt
    fixed_percent : float
        Share of the positions that have fixed ambiguities.

    Returns
    -------
    tuple of Doubt
        Causes, consequences, notes; each kind in the order given.
    """
    given = tuple(doubts)
    unfixed = fixed_percent < _JUDGED_FROM_PERCENT
    judged = [_not_judged(one) if unfixed and _contradicts(one) else one for one in given]
    if any(one.code in _CAUSES for one in judged):
        judged = [replace(one, consequence=True) if one.code in _SYMPTOMS else one for one in judged]
    order = ("warning", "consequence", "note")
    return tuple(sorted(judged, key=lambda one: order.index(one.kind)))


def _contradicts(one: Doubt) -> bool:
    """Whether positions are told to contradict the control."""
    return one.stage == "georeferencing" and one.code in _OF_POSITIONS


def _not_judged(one: Doubt) -> Doubt:
    """The same, when PPK has said that the positions are not what they should be."""
    text = (
        f"as if {one.code}: {one.text} Positions without fixed ambiguities can do that: judge it again when "
        "they are fixed."
    )
    return replace(one, code="positions-not-judged", text=text, consequence=True)

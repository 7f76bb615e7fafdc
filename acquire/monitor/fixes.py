"""The quality of fixes: what a fix is worth, and when one is lost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from acquire.channels.decoded import SECOND_NS
from acquire.monitor.state import Link, Receiver

# Worth of a fix, and how it is called.
WORTH = {
    "none": 0,
    "time_only": 0,
    "dead_reckoning": 1,
    "2d": 1,
    "3d": 2,
    "differential": 3,
    "rtk_float": 4,
    "rtk_fixed": 5,
}
NAMES = {
    "none": "no fix",
    "time_only": "time only",
    "dead_reckoning": "dead reckoning",
    "2d": "2D",
    "3d": "3D",
    "differential": "3D differential",
    "rtk_float": "RTK float",
    "rtk_fixed": "RTK fixed",
}
# A fix in space: with less nothing can be measured.
LEAST_WORTH = WORTH["3d"]
# A better fix is expected to stay only after it has stayed so long: one that flickers is told once.
STEADY_NS = 5 * SECOND_NS
# u-blox receivers give corrections up after 60 s (CFG-NAVSPG-CONSTR_DGNSSTO): half of it is time to act.
OLD_CORRECTION_S, DEAD_CORRECTION_S = 5.0, 30.0


def number(row: Mapping[str, Any], name: str) -> float | None:
    """Return a number of a message; None when it is not told or infinite.

    raises ValueError, TypeError: when it is none.
    """
    value = row.get(name)
    return None if value is None or not math.isfinite(value) else float(value)


def receiver_after(
    before: Receiver | None, row: Mapping[str, Any], time_ns: int
) -> tuple[Receiver, list[tuple[str, str]]]:
    """Return a receiver after a message, and level and words of what is to be told."""
    fix = row["fix"]
    same = before is not None and before.fix == fix
    now = Receiver(
        link=row["link"],
        fix=fix,
        satellites=round(number(row, "satellites") or 0) if row.get("satellites") is not None else -1,
        horizontal_m=number(row, "horizontal_m"),
        correction_age_s=number(row, "correction_age_s"),
        time_ns=time_ns,
        expected=fix if before is None else before.expected,
        since_ns=before.since_ns if before is not None and same else time_ns,
        starved=before is not None and before.starved,
    )
    worth, expected = WORTH.get(fix, 0), WORTH.get(now.expected, 0)
    if worth < expected and expected >= LEAST_WORTH:
        level = "bad" if worth < LEAST_WORTH else "warn"
        text = f"fix fell from {NAMES[now.expected]} to {NAMES.get(fix, fix)}"
        return replace(now, expected=fix), [(level, text)]
    if worth < expected:
        return replace(now, expected=fix), []
    if worth > expected and time_ns - now.since_ns >= STEADY_NS:
        return replace(now, expected=fix), [("note", f"has {NAMES[fix]}")]
    return now, []


def correction_age_s(receiver: Receiver, link: Link, now_ns: int) -> float | None:
    """Return the age of the corrections of a receiver; None when nobody knows of any."""
    if receiver.correction_age_s is not None:
        return receiver.correction_age_s
    return (now_ns - link.corrected_ns) / SECOND_NS if link.corrected_ns else None


def fed(receiver: Receiver, age_s: float | None) -> tuple[Receiver, list[tuple[str, str]]]:
    """Return a receiver whose corrections have an age, and level and words of what is to be told."""
    if age_s is None:
        return receiver, []
    if not receiver.starved and age_s > DEAD_CORRECTION_S:
        return replace(receiver, starved=True), [
            ("bad", f"has corrections older than {DEAD_CORRECTION_S:g} s")
        ]
    if receiver.starved and age_s <= OLD_CORRECTION_S:
        return replace(receiver, starved=False), [("note", "has fresh corrections again")]
    return receiver, []

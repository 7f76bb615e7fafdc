"""What passes over a link: frames, damage, pauses, corrections; and what fixes of a receiver are worth."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from acquire.channels.summary import GAP_S
from acquire.log.chunk import DAMAGE_ENCODING
from acquire.log.reader import LoggedMessages
from acquire.monitor.state import ComputerState, LinkState, ReceiverState, RecordingState, ended, raised
from drivers.frames import Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.dialect import ardupilotmega
from photocal.base.time_scales import SECOND_NS

# The last part of the topics of a link's own octets.
OCTETS = ("raw", "damage", "sent")
# Rates are those of the last whole seconds.
RATE_OVER_S = 5


def link_after(link: LinkState, what: str, part: LoggedMessages) -> LinkState:
    """Return a link after octets."""
    if what == "sent":
        return replace(link, corrected_ns=max([link.corrected_ns, *_correction_times(part)]))
    size = sum(map(len, part.payloads))
    if part.channel.encoding == DAMAGE_ENCODING:
        return replace(link, damage_bytes=link.damage_bytes + size)
    return _after_frames(link, part, size)


def _after_frames(link: LinkState, part: LoggedMessages, size: int) -> LinkState:
    times = np.sort(part.log_ns)
    steps = np.diff(times, prepend=link.last_ns or times[0])
    sizes = np.fromiter(map(len, part.payloads), np.int64, len(part.payloads))
    per_second = {second: (frames, octets) for second, frames, octets in link.recent}
    seconds = part.log_ns // SECOND_NS
    for second in np.unique(seconds).tolist():
        in_second = seconds == second
        frames, octets = per_second.get(second, (0, 0))
        per_second[second] = frames + int(in_second.sum()), octets + int(sizes[in_second].sum())
    newest = max(per_second)
    return replace(
        link,
        frames=link.frames + len(times),
        frame_bytes=link.frame_bytes + size,
        first_ns=link.first_ns or int(times[0]),
        last_ns=max(link.last_ns, int(times[-1])),
        recent=tuple((s, *v) for s, v in sorted(per_second.items()) if s >= newest - RATE_OVER_S - 1),
        gaps=link.gaps + int((steps > GAP_S * SECOND_NS).sum()),
        longest_gap_ns=max(link.longest_gap_ns, int(steps.max())),
    )


def _correction_times(part: LoggedMessages) -> list[int]:
    times: list[int] = part.log_ns.tolist()
    if part.channel.encoding != Wire.MAVLINK.encoding:
        return times if part.channel.encoding == Wire.RTCM3.encoding else []
    dialect = ardupilotmega()
    kinds = batch_of_payloads(Wire.MAVLINK, part.payloads, dialect).kind
    return [t for t, k in zip(times, kinds.tolist(), strict=True) if k == dialect.number("GPS_RTCM_DATA")]


# The recorder writes at least once a second; a busy disk may take a little longer.
STALL_NS = 4 * SECOND_NS
# Over how long the growth of the log is taken.
_GROWTH_OVER_NS = 60 * SECOND_NS
_GROWTH_EVERY_NS = 5 * SECOND_NS


def looked(state: RecordingState, look: ComputerState) -> RecordingState:
    """Return the state after a look."""
    before = state.look
    grown = before is None or (look.file, look.size) != (before.file, before.size)
    state = replace(state, look=look, grown_ns=look.time_ns if grown else state.grown_ns)
    state = replace(state, growth=_growth(state, look, before))
    if look.trouble and (before is None or before.trouble != look.trouble):
        state = raised(state, "bad", "", look.trouble, look.time_ns)
    if look.ended:
        # Of a log that has long ended there is nothing to tell.
        live = before is not None and not before.ended and look.time_ns - state.last_ns < _GROWTH_OVER_NS
        if live:
            state = raised(state, "note", "", f"{look.file} is complete", look.time_ns)
        return replace(state, stalled=False)
    if grown and state.stalled:
        state = ended(state, "cured", look.time_ns, lambda alarm: alarm.about == "log")
        state = raised(state, "note", "", "the log grows again", look.time_ns)
        return replace(state, stalled=False)
    # A clock of this computer that was set back shows as a negative pause.
    pause_ns = abs(look.time_ns - state.grown_ns)
    if pause_ns > STALL_NS and not state.stalled and look.file:
        text = (
            f"nothing was written for {STALL_NS // SECOND_NS} s: the recorder stopped or no link sends data"
        )
        return replace(raised(state, "bad", "", text, look.time_ns, "log"), stalled=True)
    return state


def bytes_per_s(state: RecordingState) -> float | None:
    """Return how fast the log grows; None when that is not known yet."""
    if state.look is None or not state.growth or state.look.ended:
        return None
    time_ns, size = state.growth[0]
    elapsed_ns = state.look.time_ns - time_ns
    grown = state.look.size - size
    return grown * SECOND_NS / elapsed_ns if elapsed_ns >= _GROWTH_EVERY_NS and grown > 0 else None


def _growth(
    state: RecordingState, look: ComputerState, before: ComputerState | None
) -> tuple[tuple[int, int], ...]:
    if before is None or before.file != look.file or look.time_ns < before.time_ns:
        return ((look.time_ns, look.size),)
    points = state.growth
    if look.time_ns - points[-1][0] >= _GROWTH_EVERY_NS:
        points = (*points, (look.time_ns, look.size))
    return tuple(p for p in points if look.time_ns - p[0] <= _GROWTH_OVER_NS) or points[-1:]


# Worth of a fix, and how it is called.
_FIXES = {
    "none": (0, "no fix"),
    "time_only": (0, "time only"),
    "dead_reckoning": (1, "dead reckoning"),
    "2d": (1, "2D"),
    "3d": (2, "3D"),
    "differential": (3, "3D differential"),
    "rtk_float": (4, "RTK float"),
    "rtk_fixed": (5, "RTK fixed"),
}
WORTH = {fix: worth for fix, (worth, _) in _FIXES.items()}
NAMES = {fix: name for fix, (_, name) in _FIXES.items()}
# A fix in space: with less nothing can be measured.
LEAST_WORTH = WORTH["3d"]
# A better fix is expected to stay only after this time, so one that flickers is reported once.
STEADY_NS = 5 * SECOND_NS
# u-blox receivers give corrections up after 60 s (CFG-NAVSPG-CONSTR_DGNSSTO): half of it is time to act.
OLD_CORRECTION_S, DEAD_CORRECTION_S = 5.0, 30.0


def number(row: Mapping[str, Any], name: str) -> float | None:
    """Return a number of a message; None when it is missing or infinite.

    raises ValueError, TypeError: when it is none.
    """
    value = row.get(name)
    return None if value is None or not math.isfinite(value) else float(value)


def receiver_after(
    before: ReceiverState | None, row: Mapping[str, Any], time_ns: int
) -> tuple[ReceiverState, list[tuple[str, str]]]:
    """Return a receiver after a message, and level and words of what is to be reported."""
    fix = row["fix"]
    same = before is not None and before.fix == fix
    now = ReceiverState(
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
        text = f"fix dropped from {NAMES[now.expected]} to {NAMES.get(fix, fix)}"
        return replace(now, expected=fix), [(level, text)]
    if worth < expected:
        return replace(now, expected=fix), []
    if worth > expected and time_ns - now.since_ns >= STEADY_NS:
        return replace(now, expected=fix), [("note", f"has {NAMES[fix]}")]
    return now, []


def correction_age_s(receiver: ReceiverState, link: LinkState, now_ns: int) -> float | None:
    """Return the age of the corrections of a receiver; None when nobody knows of any."""
    if receiver.correction_age_s is not None:
        return receiver.correction_age_s
    return (now_ns - link.corrected_ns) / SECOND_NS if link.corrected_ns else None


def fed(receiver: ReceiverState, age_s: float | None) -> tuple[ReceiverState, list[tuple[str, str]]]:
    """Return a receiver whose corrections have an age, and level and words of what is to be reported."""
    if age_s is None:
        return receiver, []
    if not receiver.starved and age_s > DEAD_CORRECTION_S:
        return replace(receiver, starved=True), [
            ("bad", f"has corrections older than {DEAD_CORRECTION_S:g} s")
        ]
    if receiver.starved and age_s <= OLD_CORRECTION_S:
        return replace(receiver, starved=False), [("note", "has recent corrections again")]
    return receiver, []

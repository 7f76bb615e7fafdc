"""The state after a look at the computer: does the log grow, is there room on the disk."""

from __future__ import annotations

from dataclasses import replace

from acquire.channels.decoded import SECOND_NS
from acquire.monitor.state import Look, State, raised

# The recorder writes at least once a second; a busy disk may take a little longer.
STALL_NS = 4 * SECOND_NS
# Over how long the growth of the log is taken.
_GROWTH_OVER_NS = 60 * SECOND_NS
_GROWTH_EVERY_NS = 5 * SECOND_NS


def looked(state: State, look: Look) -> State:
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
            state = raised(state, "note", "", f"{look.file} has its end", look.time_ns)
        return replace(state, stalled=False)
    if grown and state.stalled:
        state = raised(state, "note", "", "the log grows again", look.time_ns)
        return replace(state, stalled=False)
    # A clock of this computer that was set back shows as a negative pause.
    pause_ns = abs(look.time_ns - state.grown_ns)
    if pause_ns > STALL_NS and not state.stalled and look.file:
        text = (
            f"nothing was written for {STALL_NS // SECOND_NS} s: the recorder has stopped or no link speaks"
        )
        return replace(raised(state, "bad", "", text, look.time_ns), stalled=True)
    return state


def bytes_per_s(state: State) -> float | None:
    """Return how fast the log grows; None when that is not known yet."""
    if state.look is None or not state.growth or state.look.ended:
        return None
    time_ns, size = state.growth[0]
    elapsed_ns = state.look.time_ns - time_ns
    grown = state.look.size - size
    return grown * SECOND_NS / elapsed_ns if elapsed_ns >= _GROWTH_EVERY_NS and grown > 0 else None


def _growth(state: State, look: Look, before: Look | None) -> tuple[tuple[int, int], ...]:
    if before is None or before.file != look.file or look.time_ns < before.time_ns:
        return ((look.time_ns, look.size),)
    points = state.growth
    if look.time_ns - points[-1][0] >= _GROWTH_EVERY_NS:
        points = (*points, (look.time_ns, look.size))
    return tuple(p for p in points if look.time_ns - p[0] <= _GROWTH_OVER_NS) or points[-1:]

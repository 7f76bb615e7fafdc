"""The state, kept up to date in a thread of its own."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

from acquire.log.reader import Messages
from acquire.monitor.disk_status import looked
from acquire.monitor.reducer import state_after
from acquire.monitor.state import Look, State
from acquire.monitor.tail import Tail

POLL_S = 0.1
_LOOK_EVERY_S = 0.5


def follow(
    tail: Tail,
    publish: Callable[[State], None],
    stop: threading.Event,
    listen: Callable[[list[Messages]], None] = lambda _: None,
) -> None:
    """Keep a state up to date until told to stop."""
    state = State()
    look_at = 0.0
    while not stop.is_set():
        chunks, more = tail.step()
        if tail.flight != state.flight:
            state = State(flight=tail.flight)
        for chunk in chunks:
            state = state_after(state, chunk)
            listen(chunk)
        if chunks or time.monotonic() >= look_at:
            look_at = time.monotonic() + _LOOK_EVERY_S
            state = looked(state, look(tail))
            publish(state)
        if not more:
            stop.wait(POLL_S)


def read_all(tail: Tail) -> State:
    """Return the state after everything that is there now."""
    state = State()
    more = True
    while more:
        chunks, more = tail.step()
        if tail.flight != state.flight:
            state = State(flight=tail.flight)
        for chunk in chunks:
            state = state_after(state, chunk)
    return looked(state, look(tail))


def look(tail: Tail) -> Look:
    """Look at the computer."""
    path = tail.path
    size, free = 0, None
    if path is not None:
        size = path.stat().st_size if path.exists() else 0
        free = _free(path.parent)
    return Look(time.time_ns(), path.name if path else "", size, tail.ended, free, tail.trouble)


def _free(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None

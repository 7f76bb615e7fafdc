"""The reading of one link: bytes with their times of receipt, again and again after the port was lost."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from queue import SimpleQueue

from acquire.transports.sources import LinkLostError, Source

_POLL_S = 0.05
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 5.0
# What a port holds when the recording is stopped belongs to the flight. No port holds more than this.
_LAST_POLL_S, _LAST_BYTES = 0.001, 4 << 20


@dataclass(frozen=True)
class Arrival:
    """Bytes of a link and when they were received (UTC ns), or kind and words of what happened to it."""

    link: str
    time_ns: int
    data: bytes
    event: str = ""
    kind: str = ""


def read_link(
    link: str,
    source: Source,
    arrivals: SimpleQueue[Arrival],
    stop: threading.Event,
    clock_ns: Callable[[], int],
) -> None:
    """Read a link until told to stop, and then what has arrived by then; to be run in a thread of its own."""
    pause = _FIRST_PAUSE_S
    told = peer = ""
    while not stop.is_set():
        try:
            source.open()
            if told:
                arrivals.put(Arrival(link, clock_ns(), b"", "is back", "back"))
            told = ""
            while not stop.is_set():
                data = source.read(_POLL_S)
                if source.peer != peer:
                    if peer:
                        text = f"comes from another place: {source.peer}, before {peer}"
                        arrivals.put(Arrival(link, clock_ns(), b"", text, "source_changed"))
                    peer = source.peer
                if data:
                    arrivals.put(Arrival(link, clock_ns(), data))
                    pause = _FIRST_PAUSE_S
            left = _LAST_BYTES
            while left > 0 and (data := source.read(_LAST_POLL_S)):
                arrivals.put(Arrival(link, clock_ns(), data))
                left -= len(data)
        except LinkLostError as loss:
            source.close()
            # Told once, not with every attempt.
            if not told:
                told = f"is lost: {loss}"
                arrivals.put(Arrival(link, clock_ns(), b"", told, "lost"))
            stop.wait(pause)
            pause = min(2 * pause, _LONGEST_PAUSE_S)
    source.close()

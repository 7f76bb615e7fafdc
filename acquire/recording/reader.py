"""The reading of one link: bytes with their times of receipt, again and again after the port was lost."""

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from acquire.transports.sources import LinkLostError, Source
from photocal.base.console import printable

# Rate limit of a link, bytes a second, and its burst: some forty times what a receiver or an autopilot sends.
MOST_BYTES_S, MOST_AT_ONCE = 4_000_000, 4 << 20
# What may wait for being framed, and what each arrival takes of it besides its bytes. More comes only where
# the computer is too slow for what arrives.
MOST_WAITING, PER_ARRIVAL = 16 << 20, 256
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 5.0
# What a port holds when the recording is stopped belongs to the flight; to read it takes no longer.
_LAST_POLL_S, _LAST_S = 0.001, 0.3


@dataclass(frozen=True)
class Arrival:
    """Bytes of a link, when they were received (UTC ns) and from whom, or kind and words of what happened."""

    link: str
    time_ns: int
    data: bytes
    event: str = ""
    kind: str = ""
    peer: str = ""


class Inbox:
    """What has arrived over a link and waits for being framed; it is limited in rate and size.

    `slowed` tells whether more came than is taken: the sender of a stream had to wait, of datagrams `missed`
    counts those that the system could not hold. Where it does not count them they are read all the same and
    `dropped` counts their bytes.
    """

    def __init__(self, link: str, clock_ns: Callable[[], int]) -> None:
        self.link = link
        self.dropped = self.missed = 0
        self.slowed = False
        self._clock_ns = clock_ns
        self._lock = threading.Lock()
        self._waiting: deque[Arrival] = deque()
        self._unsaved: deque[Arrival] = deque()
        self._size = 0
        self._room, self._filled_s = float(MOST_AT_ONCE), time.monotonic()

    def has_room(self) -> bool:
        """Tell whether more may be put in now."""
        now = time.monotonic()
        self._room = min(MOST_AT_ONCE, self._room + (now - self._filled_s) * MOST_BYTES_S)
        self._filled_s = now
        return self._room > 0 and self._size < MOST_WAITING

    def put(self, data: bytes, peer: str = "") -> None:
        """Take bytes that have arrived now."""
        self._room -= len(data)
        self._append(Arrival(self.link, self._clock_ns(), data, peer=peer))

    def tell(self, kind: str, text: str) -> None:
        """Take note of something that happened to the link now; no more than may wait."""
        if self._size < MOST_WAITING:
            self._append(Arrival(self.link, self._clock_ns(), b"", printable(text), kind))

    def take(self, most: int) -> list[Arrival]:
        """Return what has arrived first, at least one arrival and not much more than so many bytes.

        Each arrival counts for `PER_ARRIVAL` more: many small ones are as much work as few large ones.
        """
        arrivals: list[Arrival] = []
        with self._lock:
            while self._waiting and most > 0:
                arrival = self._waiting.popleft()
                arrivals.append(arrival)
                most -= len(arrival.data) + PER_ARRIVAL
                self._size -= len(arrival.data) + PER_ARRIVAL
                if self._unsaved and self._unsaved[0] is arrival:
                    self._unsaved.popleft()
        return arrivals

    def unsaved(self) -> list[Arrival]:
        """Return what waits and has not been returned by this before."""
        with self._lock:
            arrivals = [arrival for arrival in self._unsaved if arrival.data]
            self._unsaved.clear()
        return arrivals

    def __len__(self) -> int:
        return len(self._waiting)

    def _append(self, arrival: Arrival) -> None:
        with self._lock:
            self._waiting.append(arrival)
            self._unsaved.append(arrival)
            self._size += len(arrival.data) + PER_ARRIVAL


class Moves:
    """Tells when datagrams come from another place: at once, then every so often with how often they did."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self._peer, self._text, self._count = "", "", 0
        self._due_s = -math.inf

    def look(self, peer: str, steady_s: float) -> None:
        """Take note of who has sent last; at an infinite time the rest is reported."""
        if peer != self._peer:
            if self._peer:
                self._count += 1
                self._text = f"data come from another address: {peer}, before {self._peer}"
            self._peer = peer
        if self._count and steady_s >= self._due_s:
            times = f" ({self._count} times: do several senders share the port?)" if self._count > 1 else ""
            self._inbox.tell("source_changed", self._text + times)
            # Senders that take turns at a port are reported at this interval, with the number of changes.
            moves_told_s = 10.0
            self._count, self._due_s = 0, steady_s + moves_told_s


def start_readers(
    sources: dict[str, Source], stop: threading.Event, clock_ns: Callable[[], int]
) -> tuple[dict[str, Inbox], list[threading.Thread]]:
    """Begin to read all links, each in a thread of its own."""
    inboxes = {name: Inbox(name, clock_ns) for name in sources}
    readers = [
        threading.Thread(target=read_link, args=(source, inboxes[name], stop), name=name, daemon=True)
        for name, source in sources.items()
    ]
    for reader in readers:
        reader.start()
    return inboxes, readers


def left_behind(readers: list[threading.Thread], patience_s: float) -> list[str]:
    """Wait for the readers to end; return the names of those whose port hangs. They end with the process."""
    until = time.monotonic() + patience_s
    for reader in readers:
        reader.join(max(0.0, until - time.monotonic()))
    return [reader.name for reader in readers if reader.is_alive()]


def read_link(source: Source, inbox: Inbox, stop: threading.Event) -> None:
    """Read a link until told to stop, and then what has arrived by then; to be run in a thread of its own."""
    # How often a port is asked for bytes, and whether to stop.
    poll_s = 0.05
    pause = _FIRST_PAUSE_S
    lost = False
    moves = Moves(inbox)
    while not stop.is_set():
        try:
            source.open(stop)
            if lost:
                inbox.tell("back", "is back")
            lost = False
            while not stop.is_set():
                if _read(source, inbox, poll_s, stop):
                    pause = _FIRST_PAUSE_S
                moves.look(source.peer, time.monotonic())
            until = time.monotonic() + _LAST_S
            while time.monotonic() < until and inbox.has_room() and _read(source, inbox, _LAST_POLL_S, stop):
                pass
        except Exception as loss:
            # Told once, not with every attempt.
            if not lost and not stop.is_set():
                kind = "" if isinstance(loss, LinkLostError) else f"{type(loss).__name__}: "
                inbox.tell("lost", f"is lost: {kind}{loss}")
                lost = True
            _close(source)
            stop.wait(pause)
            pause = min(2 * pause, _LONGEST_PAUSE_S)
    moves.look(source.peer, math.inf)
    _close(source)


def _read(source: Source, inbox: Inbox, timeout_s: float, stop: threading.Event) -> bool:
    """Take what has arrived; above the rate its sender waits, or the system counts what it cannot hold."""
    inbox.missed = source.missed
    if not inbox.has_room() and not source.lossy:
        inbox.slowed = True
        # Pause of a link above its rate limit: short compared with what a socket holds.
        above_s = 0.002
        stop.wait(above_s)
        return False
    data = source.read(timeout_s)
    if not data:
        return False
    if inbox.has_room():
        inbox.put(data, source.peer)
    else:
        inbox.dropped += len(data)
    return True


def _close(source: Source) -> None:
    # A port that is gone may refuse even that.
    with contextlib.suppress(Exception):
        source.close()

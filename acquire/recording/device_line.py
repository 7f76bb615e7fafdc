"""What is said to the device of a link, beside the log: answers, settings, positions and corrections.

What goes out beside the log: a short queue and a thread, whose slowness and failure nobody else feels.
"""

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from acquire.channels.mounting import NAMES
from acquire.recording.alarms import Alarm
from acquire.recording.caster_position import CasterPosition
from acquire.recording.configuration import LinkConfiguration
from acquire.recording.dialogues import ReceiverDialogue, VehicleDialogue
from acquire.transports.sources import NobodyThereError, Source
from drivers.frames import Batch
from drivers.mavlink.dialect import Dialect
from photocal.base.console import printable
from photocal.base.errors import ConfigurationError

Item = TypeVar("Item")


class Outlet(Generic[Item]):
    """Takes items without ever waiting and hands them on, one after the other, in a thread of its own.

    The log is written by a thread that must wait for nothing but the disk: a terminal, a device or a caster
    that takes nothing, or fails, costs items of its own outlet alone. They are counted: `dropped` those that
    made room for later ones or became too old, `failed` those over which `act` has failed; `failure` is its
    last failure in words.

    name: of the thread, which begins with the first item.
    act: what is done with an item.
    most: number of items that may wait; then the oldest goes.
    longest_s: after this time an item is of no use any more, seconds.
    """

    def __init__(
        self, name: str, act: Callable[[Item], None], most: int = 200, longest_s: float = math.inf
    ) -> None:
        self.dropped = self.failed = 0
        self.failure = ""
        self._act, self._most, self._longest_s = act, most, longest_s
        self._waiting: deque[tuple[float, Item]] = deque()
        self._changed = threading.Condition()
        # Since when the thread has been at an item; None while it is at none.
        self._at_it_s: float | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def put(self, item: Item) -> None:
        """Take an item; never waits."""
        with self._changed:
            if len(self._waiting) >= self._most:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append((time.monotonic(), item))
            self._changed.notify_all()
            if self._thread.ident is None:
                # A computer that has no more threads to give takes the outlet away, not the log.
                with contextlib.suppress(RuntimeError):
                    self._thread.start()

    def close(self, patience_s: float) -> bool:
        """Take leave when all has gone out, or one item takes longer than so; tell whether all went out."""
        began_s = time.monotonic()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            # How long the thread itself may take to come to what waits, however busy the computer is.
            awake_s = 5.0
            while self._waiting or self._at_it_s is not None:
                now = time.monotonic()
                if now > (began_s + awake_s if self._at_it_s is None else self._at_it_s + patience_s):
                    return False
                self._changed.wait(0.01)
        return not (self.dropped or self.failed)

    def _run(self) -> None:
        while (item := self._next()) is not None:
            try:
                self._act(item[1])
            except BaseException as failure:
                self.failed += 1
                self.failure = printable(str(failure) or type(failure).__name__)

    def _next(self) -> tuple[float, Item] | None:
        with self._changed:
            self._at_it_s = None
            self._changed.notify_all()
            while True:
                while self._waiting:
                    put_s, item = self._waiting.popleft()
                    now = time.monotonic()
                    if now - put_s <= self._longest_s:
                        self._at_it_s = now
                        return put_s, item
                    self.dropped += 1
                if self._closed:
                    return None
                self._changed.wait()


# What may wait for a device; what has waited for longer (an old correction, a late answer) does harm.
MOST_FRAMES, LONGEST_S = 64, 2.0


# A frame that the device, or the system for it, has taken: when (UTC ns), its encoding, its bytes.
Sent = tuple[int, str, bytes]
# The kind of an RTCM message, and its frame.
Correction = tuple[int, bytes]


class DeviceLine:
    """The way to a device: one outlet considers what is to be said, another one says it.

    Nothing here waits, so the thread that writes the log may call it. What comes of it is fetched: frames
    that were sent, and alarms, also of frames that were not.

    source: takes the frames.
    clock_ns, steady_s: clocks of the host, see `Host`.
    """

    def __init__(
        self,
        link: LinkConfiguration,
        source: Source,
        dialect: Dialect,
        clock_ns: Callable[[], int],
        steady_s: Callable[[], float],
    ) -> None:
        # Messages that wait for the thread of this link.
        most_turns = 64
        # The position sent to this link's device, and those that need the position of this link's device.
        self.position: CasterPosition | None = None
        self.asked_for_position: list[CasterPosition] = []
        # Frames that were not even put in.
        self.skipped = 0
        self._name = link.name
        self._source = source
        self._encoding = link.protocol
        self._clock_ns, self._steady_s = clock_ns, steady_s
        self._vehicle = _vehicle(link, dialect) if link.protocol == "mavlink" else None
        self._dialogue: VehicleDialogue | ReceiverDialogue | None = self._vehicle if link.vehicle else None
        if link.ublox is not None:
            self._dialogue = ReceiverDialogue(link.ublox.port, link.ublox.messages, link.ublox.rate_ms)
        self._port: Outlet[tuple[str, bytes]] = Outlet(
            f"{link.name} port", self._write, MOST_FRAMES, LONGEST_S
        )
        self._talk: Outlet[Batch | Correction | None] = Outlet(
            f"{link.name} talk", self._consider, most_turns, LONGEST_S
        )
        self._turn_due_s = self._tell_due_s = -math.inf
        self._sent: deque[Sent] = deque()
        self._said: deque[Alarm] = deque(maxlen=200)
        self._told = (0, 0, 0)

    def hear(self, batch: Batch | None, steady_s: float) -> None:
        """Go on with the conversation: the device has said this, or nothing by now."""
        # A dialogue waits for seconds: ten turns a second are enough.
        turn_every_s = 0.1
        concerned = self._dialogue is not None or self.position is not None
        heard = batch is not None and len(batch) > 0 and (concerned or bool(self.asked_for_position))
        if heard or (concerned and steady_s >= self._turn_due_s):
            self._turn_due_s = steady_s + turn_every_s
            self._talk.put(batch if heard else None)

    def correct(self, kind: int, frame: bytes) -> None:
        """Pass a correction on to the device."""
        if self._vehicle is None:
            self._port.put(("rtcm3", frame))
        else:
            self._talk.put((kind, frame))

    def sent(self) -> list[Sent]:
        """Return what was sent since the last call."""
        return [self._sent.popleft() for _ in range(len(self._sent))]

    def alarms(self, steady_s: float) -> list[Alarm]:
        """Return the alarms since the last call; at an infinite time the last figures, too."""
        # What was dropped is said this often at the most.
        told_every_s = 10.0
        said = [self._said.popleft() for _ in range(len(self._said))]
        unsent = self._port.dropped + self._port.failed + self.skipped
        state = unsent, self._talk.dropped, self._talk.failed
        if state == self._told or steady_s < self._tell_due_s:
            return said
        before, self._told = self._told, state
        self._tell_due_s = steady_s + told_every_s
        texts = [
            f"does not accept the data sent to it: {unsent} frames (corrections, answers) "
            "refused or too old so far" + (f" ({self._port.failure})" if self._port.failure else ""),
            f"receives its answers too late: {self._talk.dropped} fragments or corrections too old so far",
            f"does not answer commands, its data are recorded: {self._talk.failure}",
        ]
        changed = [text for text, now, then in zip(texts, state, before, strict=True) if now != then]
        return said + [Alarm("device", self._name, text, self._clock_ns()) for text in changed]

    def _consider(self, heard: Batch | Correction | None) -> None:
        """Find out what is to be said; runs in the thread of its outlet."""
        clock_ns, steady_s = self._clock_ns(), self._steady_s()
        if isinstance(heard, tuple):
            if self._vehicle is not None:
                frames, words = self._vehicle.carry(*heard)
                self._say(frames, self._encoding)
                self._tell("device", [words] if words else [], clock_ns)
            return
        if heard is not None:
            for position in self.asked_for_position:
                position.hear(heard)
        if self.position is not None:
            self._say(self.position.due(steady_s, clock_ns), "nmea")
        if self._dialogue is not None:
            frames, notes, alarms = self._dialogue.step(heard, steady_s, clock_ns)
            self._say(frames, self._encoding)
            self._tell("note", notes, clock_ns)
            self._tell("device", alarms, clock_ns)

    def _say(self, frames: list[bytes] | tuple[bytes, ...], encoding: str) -> None:
        for frame in frames:
            self._port.put((encoding, frame))

    def _tell(self, kind: str, texts: list[str] | tuple[str, ...], clock_ns: int) -> None:
        self._said.extend(Alarm(kind, self._name, text, clock_ns) for text in texts)

    def _write(self, item: tuple[str, bytes]) -> None:
        """Send a frame; runs in the thread of its outlet."""
        encoding, frame = item
        try:
            self._source.write(frame)
        except NobodyThereError:
            # The reader of the port reports that it is gone.
            return
        self._sent.append((self._clock_ns(), encoding, frame))


def _vehicle(link: LinkConfiguration, dialect: Dialect) -> VehicleDialogue:
    rates = link.vehicle.rates_hz if link.vehicle else {}
    for name in rates:
        try:
            dialect.number(name)
        except KeyError as unknown:
            raise ConfigurationError(
                f"{name} is not a MAVLink message",
                where=f"link {link.name}, vehicle.rates_hz",
                remedy="check it",
            ) from unknown
    asked = NAMES if link.vehicle and link.vehicle.parameters else ()
    return VehicleDialogue(dialect, rates, link.vehicle.timesync_s if link.vehicle else 0.0, asked)

"""What a person must hear of while a flight is recorded."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from acquire.channels.decoded import LAYOUTS, times
from acquire.channels.link import WriteMessages
from acquire.log.chunk import Channel
from acquire.recording.reader import MOST_BYTES_S, Inbox

LEAST_JUMP_S = 0.5
# Of one kind and link so many alarms pass in so many seconds; the others are counted.
MOST_ALIKE, ALIKE_S = 20, 10.0

ALARM = LAYOUTS["Alarm"]


@dataclass(frozen=True)
class Alarm:
    """Something that happened: its kind (see `ALARM`), link, words, and when (UTC ns)."""

    kind: str
    link: str
    text: str
    time_ns: int

    def __str__(self) -> str:
        return f"{self.link} {self.text}" if self.link else self.text


def write_alarms(write: WriteMessages, alarms: Sequence[Alarm], first: int) -> None:
    """Write alarms to the log; `first` is the number of the first of them."""
    if not alarms:
        return
    raised_ns = np.array([alarm.time_ns for alarm in alarms], np.int64)
    columns: dict[str, Any] = {
        "kind": [alarm.kind for alarm in alarms],
        "link": [alarm.link for alarm in alarms],
        "text": [alarm.text for alarm in alarms],
        "time": times(raised_ns),
    }
    payloads = ALARM.rows(columns, len(alarms))
    numbers = first + np.arange(len(alarms))
    write(Channel("/alarm", "json", ALARM.schema()), payloads, raised_ns, raised_ns, numbers)


@dataclass
class _Alike:
    begun_s: float
    passed: int = 0
    held: int = 0
    last: Alarm | None = None


@dataclass
class AlarmLimit:
    """Limits the rate of alarms of one kind and link: of those above it, reports the last and a count."""

    _alike: dict[tuple[str, str], _Alike] = field(default_factory=dict)

    def take(self, alarms: Sequence[Alarm], steady_s: float) -> list[Alarm]:
        """Return those of some alarms that are reported now."""
        told = self.look(steady_s)
        for alarm in alarms:
            alike = self._alike.setdefault((alarm.kind, alarm.link), _Alike(steady_s))
            if alike.passed < MOST_ALIKE:
                alike.passed += 1
                told.append(alarm)
            else:
                alike.held += 1
                alike.last = alarm
        return told

    def look(self, steady_s: float) -> list[Alarm]:
        """Return what was held back for long enough; at an infinite time all of it."""
        told = []
        for key, alike in list(self._alike.items()):
            if steady_s - alike.begun_s >= ALIKE_S:
                del self._alike[key]
                if alike.last is not None:
                    more = (
                        f" ({alike.held} alarms of this kind within {ALIKE_S:g} s)" if alike.held > 1 else ""
                    )
                    told.append(replace(alike.last, text=alike.last.text + more))
        return told


@dataclass
class RecordingWatch:
    """Watches links and the clock of the host; each fault is reported once, as long as it lasts.

    limits_s: the longest silence of each link, seconds.
    start_s: when the watch begins, seconds of a steady clock.
    """

    limits_s: dict[str, float]
    start_s: float
    _heard_s: dict[str, float] = field(default_factory=dict)
    _silent: set[str] = field(default_factory=set)
    _flooded: dict[str, tuple[float, tuple[int, int, bool]]] = field(default_factory=dict)
    _offset_s: float | None = None

    def hear(self, link: str, steady_s: float, time_ns: int) -> list[Alarm]:
        """Take note of intact frames of a link: one that was silent is heard again."""
        self._heard_s[link] = steady_s
        if link not in self._silent:
            return []
        self._silent.discard(link)
        return [Alarm("heard_again", link, "data again", time_ns)]

    def silences(self, steady_s: float, time_ns: int) -> list[Alarm]:
        """Return the alarms of links that have become too silent."""
        alarms = []
        for link, limit in self.limits_s.items():
            silence = steady_s - self._heard_s.get(link, self.start_s)
            if silence > limit and link not in self._silent:
                self._silent.add(link)
                alarms.append(Alarm("silent", link, f"no data for more than {limit:g} s", time_ns))
        return alarms

    def floods(self, inboxes: dict[str, Inbox], steady_s: float, time_ns: int) -> list[Alarm]:
        """Return the alarms of links whose data arrive faster than they can be recorded.

        They come at once, then repeatedly; at an infinite time the last figures.
        """
        alarms = []
        flood_told_s = 10.0
        for link, inbox in inboxes.items():
            state = (inbox.dropped, inbox.missed, inbox.slowed)
            last_s, last = self._flooded.get(link, (-np.inf, (0, 0, False)))
            if state != last and steady_s - last_s >= flood_told_s:
                self._flooded[link] = (steady_s, state)
                alarms.append(Alarm("flood", link, flood_text(inbox), time_ns))
        return alarms

    def jump(self, clock_ns: int, steady_s: float) -> list[Alarm]:
        """Return the alarm of a jump of the host's clock since the last look; drift is none."""
        offset = clock_ns / 1e9 - steady_s
        last, self._offset_s = self._offset_s, offset
        if last is None or abs(offset - last) < LEAST_JUMP_S:
            return []
        text = f"the clock of this computer jumped by {offset - last:+.1f} s: times of receipt jump, too"
        return [Alarm("clock_jump", "", text, clock_ns)]


def flood_text(inbox: Inbox) -> str:
    """Return in words what became of a flood."""
    limit = "data arrive faster than they can be recorded"
    if inbox.slowed or inbox.dropped:
        limit = f"more data arrive than the {MOST_BYTES_S / 1e6:g} MB/s that can be recorded"
    if inbox.dropped or inbox.missed:
        lost = f"{inbox.missed} datagrams" if inbox.missed else f"{inbox.dropped} bytes"
        return f"{limit}: {lost} could not be recorded so far"
    return f"{limit}: the sender must wait"

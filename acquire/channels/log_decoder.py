"""What the decoders of autopilots' own logs share: times of the records, and records by their names."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from acquire.channels.decoded import Decoded, in_order
from acquire.channels.logged import Logged
from drivers.arrays import Integers
from drivers.frames import Batch
from drivers.logged import Definitions

# A receiver's time further than this from the middle of all is a lag or a leap, not what ties the clocks.
_LIKELY_NS = 500_000_000


@dataclass(frozen=True)
class BootTime:
    """When an autopilot started.

    utc_ns: UTC of the start, nanoseconds since 1970.
    pairs: number of times of a receiver that it was found from.
    """

    utc_ns: int
    pairs: int

    def of(self, boot_ns: Integers) -> Integers:
        """Return UTC of times since the start; -1 stays -1."""
        return np.where(boot_ns >= 0, self.utc_ns + boot_ns, -1)


def boot_time(batches: Iterable[Batch], definitions: Definitions) -> BootTime | None:
    """Find when the autopilot started; None when no receiver told UTC.

    A record of a receiver is written some time after the epoch that it tells, never before: so the largest
    difference of UTC and running time is the nearest to the truth. It is early by the shortest delay of the
    receiver, some hundredths to a tenth of a second.
    """
    offsets = [np.empty(0, np.int64)]
    for batch in batches:
        definitions.learn(batch)
        boot, utc = definitions.told_utc(batch)
        offsets.append(utc - boot)
    every = np.concatenate(offsets)
    if not len(every):
        return None
    middle = np.sort(every)[len(every) // 2]
    return BootTime(int(every[np.abs(every - middle) <= _LIKELY_NS].max()), len(every))


Formats = TypeVar("Formats", bound=Definitions)


@dataclass(frozen=True)
class Part(Generic[Formats]):
    """A batch of a log.

    link: name of the link.
    formats: what the log has said of its records so far.
    batch: the records.
    utc_ns, boot_ns (n,): UTC of each, nanoseconds since 1970, and time since the start of the autopilot; -1
        where it has none.
    """

    link: str
    formats: Formats
    batch: Batch
    utc_ns: Integers
    boot_ns: Integers

    def logged(self, name: str) -> Logged:
        """Return the records of a kind."""
        records = self.formats.decode(self.batch, name)
        return Logged(self.link, name, records, self.utc_ns[records.index])


class LogDecoder(ABC, Generic[Formats]):
    """Decodes the records of a log; a `Decoder`.

    link: name of the link.
    boot: when the autopilot started.
    formats: reads the definitions of the log, from its beginning.
    """

    def __init__(self, link: str, boot: BootTime, formats: Formats) -> None:
        self._link = link
        self._boot = boot
        self._formats = formats

    def feed(self, batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Return the device's time of each frame and the decoded messages."""
        self._formats.learn(batch)
        boot = self._formats.boot_ns(batch)
        utc = np.where(boot >= 0, self._boot.of(boot), log_ns)
        return utc, in_order(self._decoded(Part(self._link, self._formats, batch, utc, boot)))

    @abstractmethod
    def _decoded(self, part: Part[Formats]) -> Iterator[Decoded]:
        """Decode a batch."""

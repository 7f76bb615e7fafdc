"""UTC of the records of an autopilot's own log, whose times count from the start of the autopilot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

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

"""TIM-TM2: edges at the receiver's pin.

Source: u-blox F9 HPG 1.32 interface description, TIM-TM2.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from acquire.simulate.gnss.observations import Clock
from photocal.base.arrays import Integers
from photocal.base.time_scales import SECOND_NS, WEEK_S

KIND = 0x0D03
TimeBase = Literal["receiver", "gnss", "utc"]
_RUNNING, _FALLING, _UTC_KNOWN, _VALID, _RISING = 0x01, 0x04, 0x20, 0x40, 0x80
_BASE = {"receiver": 0, "gnss": 1, "utc": 2}


@dataclass(frozen=True)
class Pulses:
    """Pulses at the receiver's pin.

    rising_gps_ns (n,): true GPS times of the rising edges, rising.
    falling_gps_ns (n,) or (0,): of the falling edge of each pulse; empty: falling edges are not marked.
    time_base: what the messages say that their times are.
    stamped_in: what they are: another one than `time_base` is a fault.
    accuracy_s: standard deviation of the marks, which the messages tell.
    first_count: counter of rising edges before the first one.
    """

    rising_gps_ns: Integers
    falling_gps_ns: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    time_base: TimeBase = "gnss"
    stamped_in: TimeBase = "gnss"
    accuracy_s: float = 20e-9
    first_count: int = 0


def messages(
    events: Pulses, clock: Clock, leap_s: int, rng: np.random.Generator
) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload.

    Edges are reported with the next epoch of navigation, one of each kind in a message; several pulses
    between two epochs give several messages.

    leap_s: GPS time minus UTC.
    """
    # From an edge to its message on the wire.
    latency_ns = 90_000_000
    true_ns = clock.true_gps_ns
    latest = [0, 0]
    for epoch, count, edges in _marks(events, true_ns):
        flags = _RUNNING | _BASE[events.time_base] << 3 | _UTC_KNOWN | _VALID
        for kind, (edge_ns, bit) in enumerate(zip(edges, (_RISING, _FALLING), strict=True)):
            noise = round(float(rng.normal(0, events.accuracy_s)) * SECOND_NS)
            if edge_ns is not None:
                flags |= bit
                latest[kind] = _stamp(edge_ns + noise, events, clock, leap_s)
        (rising_week, *rising), (falling_week, *falling) = (
            (*divmod(stamp // 1_000_000, WEEK_S * 1000), stamp % 1_000_000) for stamp in latest
        )
        accuracy_ns = max(round(events.accuracy_s * SECOND_NS), 1)
        head = struct.pack("<BBHHH", 0, flags, count % 65_536, rising_week, falling_week)
        body = struct.pack("<5I", *rising, *falling, accuracy_ns)
        yield int(true_ns[epoch]) + latency_ns, head + body


def _marks(events: Pulses, true_ns: Integers) -> Iterator[tuple[int, int, tuple[int | None, int | None]]]:
    """Yield the epoch that tells of a mark, the number of its rising edge, and its edges."""
    rising = np.searchsorted(true_ns, events.rising_gps_ns).tolist()
    falling = np.searchsorted(true_ns, events.falling_gps_ns).tolist()
    for place, epoch in enumerate(rising):
        count = events.first_count + place + 1
        edge = int(events.rising_gps_ns[place])
        if place < len(falling) and falling[place] == epoch:
            end = int(events.falling_gps_ns[place])
            if epoch < len(true_ns):
                yield epoch, count, (edge, end)
            continue
        if epoch < len(true_ns):
            yield epoch, count, (edge, None)
        if place < len(falling) and falling[place] < len(true_ns):
            yield falling[place], count, (None, int(events.falling_gps_ns[place]))


def _stamp(gps_ns: int, events: Pulses, clock: Clock, leap_s: int) -> int:
    if events.stamped_in == "utc":
        return gps_ns - leap_s * SECOND_NS
    if events.stamped_in == "receiver":
        at = int(np.searchsorted(clock.tag_gps_ns, gps_ns)) - 1
        return gps_ns + round(float(clock.bias_s[max(at, 0)]) * SECOND_NS)
    return gps_ns

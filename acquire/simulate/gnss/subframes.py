"""RXM-SFRBX: the navigation messages as u-blox hands them over.

Source: u-blox F9 HPG 1.32 interface description, RXM-SFRBX version 2 and section 1.7 (GPS, Galileo).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from acquire.simulate.gnss import inav, lnav
from acquire.simulate.gnss.observations import Observations
from acquire.simulate.gnss.settings import SkySettings
from acquire.simulate.gnss.signals import GALILEO, GPS, UBX_SYSTEM
from drivers.arrays import Floats, Integers
from drivers.gnsstime import SECOND_NS

KIND = 0x0213
# Travel time of the signal and the work of the receiver.
_LATENCY_NS = 120_000_000


@dataclass(frozen=True)
class _Source:
    """A signal with data: place among those tracked, `sigId`, length of its parts, their shift in time."""

    band: str
    number: int
    ubx: int
    length_s: int
    shift_s: int


_SOURCES = {
    GPS: (_Source("L1CA", 0, 0, lnav.SUBFRAME_S, 0),),
    # Pages of E1B begin a second after those of E5b.
    GALILEO: (_Source("E1B", 0, 1, inav.PAGE_S, 1), _Source("E5b", 1, 5, inav.PAGE_S, 0)),
}


def messages(
    observations: Observations, span_gps_ns: tuple[int, int], sky: SkySettings
) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload of all that was received whole."""
    seconds = (observations.clock.tag_gps_ns - span_gps_ns[0]) / SECOND_NS
    almanacs = {
        system: tuple(s.truth for s in observations.satellites if s.system == system) for system in _SOURCES
    }
    broadcast = lnav.Broadcast(sky.klobuchar, sky.leap_s, almanacs[GPS])
    for index, satellite in enumerate(observations.satellites):
        for source in _SOURCES[satellite.system]:
            count = _tracked(observations, index, source.number)
            for gps_s in _beginnings(source, span_gps_ns):
                if not _whole(count, seconds, gps_s - span_gps_ns[0] / SECOND_NS, source.length_s):
                    continue
                sent = satellite.transmitted(gps_s * SECOND_NS)
                if sent.system == GPS:
                    words = lnav.subframe(sent, gps_s, broadcast)
                else:
                    words = inav.page(sent, gps_s, source.band, sky.leap_s, almanacs[GALILEO])
                head = struct.pack(
                    "8B", UBX_SYSTEM[sent.system], sent.number, source.ubx, 0, len(words), index % 60, 2, 0
                )
                received = (gps_s + source.length_s) * SECOND_NS + _LATENCY_NS
                yield received, head + struct.pack(f"<{len(words)}I", *words)


def _tracked(observations: Observations, satellite: int, signal: int) -> Integers:
    """Return at how many epochs before each one a signal was there; int64 (n + 1,)."""
    rows = observations.rows
    there = np.zeros(len(observations.clock) + 1, np.int64)
    there[rows["epoch"][(rows["satellite"] == satellite) & (rows["signal"] == signal)] + 1] = 1
    return np.cumsum(there)


def _beginnings(source: _Source, span_gps_ns: tuple[int, int]) -> range:
    """Return when parts begin that lie within the session, GPS seconds."""
    start, stop = -(-span_gps_ns[0] // SECOND_NS), span_gps_ns[1] // SECOND_NS
    first = start + (source.shift_s - start) % source.length_s
    return range(first, stop - source.length_s + 1, source.length_s)


def _whole(count: Integers, seconds: Floats, begin: float, length: float) -> bool:
    """Tell whether the signal was tracked at all epochs of a stretch, of which there must be one."""
    first, after = np.searchsorted(seconds, [begin, begin + length])
    return bool(after > first and count[after] - count[first] == after - first)

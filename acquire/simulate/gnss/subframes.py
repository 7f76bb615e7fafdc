"""RXM-SFRBX: the navigation messages as u-blox hands them over.

Source: u-blox F9 HPG 1.32 interface description, RXM-SFRBX version 2 and section 1.7 (GPS, Galileo).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.gnss import inav, lnav
from acquire.simulate.gnss.observations import Observations
from acquire.simulate.gnss.settings import SkySettings
from acquire.simulate.gnss.signals import GPS, UBX_SYSTEM
from drivers.gnsstime import SECOND_NS

KIND = 0x0213
# Travel time of the signal and the work of the receiver.
_LATENCY_NS = 120_000_000
_L1CA, _E1B, _E5BI = 0, 1, 5


def messages(
    observations: Observations, span_gps_ns: tuple[int, int], sky: SkySettings
) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload of all that was received whole.

    Parameters
    ----------
    observations : Observations
        They tell which satellites were tracked.
    span_gps_ns : (int, int)
        Session.
    sky : SkySettings
        What subframe 4 tells to all.
    """
    start, stop = (-(-t // SECOND_NS) for t in span_gps_ns)
    seconds = (observations.clock.tag_gps_ns - start * SECOND_NS) / SECOND_NS
    sources = (
        (0, lnav.SUBFRAME_S, 0, _L1CA),
        (1, inav.PAGE_S, 1, _E1B),
        (1, inav.PAGE_S, 0, _E5BI),
    )
    for index, satellite in enumerate(observations.satellites):
        for galileo, length, shift, signal in sources:
            if (satellite.system == GPS) == bool(galileo):
                continue
            number = int(signal == _E5BI)
            rows = observations.rows
            mine = (rows["satellite"] == index) & (rows["signal"] == number)
            held = np.zeros(len(seconds) + 1, np.int64)
            held[rows["epoch"][mine] + 1] = 1
            if not held.any():
                continue
            begin = -(-(start - shift) // length) * length + shift
            for gps_s in range(begin, stop - length + 1, length):
                if not _whole(np.cumsum(held), seconds, gps_s - start, length):
                    continue
                sent = satellite.transmitted(gps_s * SECOND_NS)
                if signal == _L1CA:
                    words = lnav.subframe(sent, gps_s, _broadcast(observations, sky, gps_s))
                else:
                    words = inav.page(sent, gps_s, "E1B" if signal == _E1B else "E5b", sky.leap_s)
                head = struct.pack(
                    "8B", UBX_SYSTEM[sent.system], sent.number, signal, 0, len(words), index % 60, 2, 0
                )
                yield (
                    (gps_s + length) * SECOND_NS + _LATENCY_NS,
                    head + struct.pack(f"<{len(words)}I", *words),
                )


def _whole(count: NDArray[np.int64], seconds: NDArray[np.float64], begin: float, length: float) -> bool:
    """Tell whether the signal was tracked at all epochs of a stretch, of which there must be one."""
    first, after = np.searchsorted(seconds, [begin, begin + length])
    return bool(after > first and count[after] - count[first] == after - first)


def _broadcast(observations: Observations, sky: SkySettings, gps_s: int) -> lnav.Broadcast:
    almanacs = tuple(s.transmitted(gps_s * SECOND_NS) for s in observations.satellites if s.system == GPS)
    return lnav.Broadcast(sky.klobuchar, sky.leap_s, almanacs)

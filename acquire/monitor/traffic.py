"""What passes over a link: frames, damage, pauses, corrections that are sent to its device."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from acquire.channels.decoded import SECOND_NS
from acquire.log.reader import Messages
from acquire.log.records import DAMAGE_ENCODING
from acquire.log.summary import GAP_S
from acquire.monitor.state import Link
from drivers.frames import Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.dialect import Dialect, ardupilotmega

# The last part of the topics of a link's own octets.
OCTETS = ("raw", "damage", "sent")
# Rates are those of the last whole seconds.
RATE_OVER_S = 5


def link_after(link: Link, what: str, part: Messages) -> Link:
    """Return a link after octets."""
    if what == "sent":
        return replace(link, corrected_ns=max([link.corrected_ns, *_correction_times(part)]))
    size = sum(map(len, part.payloads))
    if part.channel.encoding == DAMAGE_ENCODING:
        return replace(link, damage_bytes=link.damage_bytes + size)
    return _after_frames(link, part, size)


def _after_frames(link: Link, part: Messages, size: int) -> Link:
    times = np.sort(part.log_ns)
    steps = np.diff(times, prepend=link.last_ns or times[0])
    sizes = np.fromiter(map(len, part.payloads), np.int64, len(part.payloads))
    per_second = {second: (frames, octets) for second, frames, octets in link.recent}
    seconds = part.log_ns // SECOND_NS
    for second in np.unique(seconds).tolist():
        own = seconds == second
        frames, octets = per_second.get(second, (0, 0))
        per_second[second] = frames + int(own.sum()), octets + int(sizes[own].sum())
    newest = max(per_second)
    return replace(
        link,
        frames=link.frames + len(times),
        frame_bytes=link.frame_bytes + size,
        first_ns=link.first_ns or int(times[0]),
        last_ns=max(link.last_ns, int(times[-1])),
        recent=tuple((s, *v) for s, v in sorted(per_second.items()) if s >= newest - RATE_OVER_S - 1),
        gaps=link.gaps + int((steps > GAP_S * SECOND_NS).sum()),
        longest_gap_ns=max(link.longest_gap_ns, int(steps.max())),
    )


def _correction_times(part: Messages) -> list[int]:
    times: list[int] = part.log_ns.tolist()
    if part.channel.encoding != Wire.MAVLINK.encoding:
        return times if part.channel.encoding == Wire.RTCM3.encoding else []
    dialect = _dialect()
    kinds = batch_of_payloads(Wire.MAVLINK, part.payloads, dialect).kind
    return [t for t, k in zip(times, kinds.tolist(), strict=True) if k == dialect.number("GPS_RTCM_DATA")]


@cache
def _dialect() -> Dialect:
    return ardupilotmega()

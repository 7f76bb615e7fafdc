"""The time of a GNSS receiver, read from its own messages."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers import nmea, rtcm3
from drivers.frames import Batch
from drivers.protocols import receiver_protocols
from drivers.ubx import decode as ubx
from photocal.base.arrays import Integers
from photocal.base.time_scales import DAY_NS, GPS_EPOCH_NS, SECOND_NS, WEEK_S, gps_to_utc_ns, week_to_ns

# Messages whose only time is the time of week: they need the week of one that has it.
_WEEKLESS = (ubx.NAV_HPPOSLLH, ubx.NAV_POSLLH, ubx.NAV_SVIN)
_WEEK_NS = WEEK_S * SECOND_NS
_LEAP_NS = 600 * SECOND_NS


class ReceiverClock:
    """Gives each frame the receiver's time: that of the last message that told it.

    The whole time comes from RXM-RAWX, NAV-TIMEGPS, NAV-PVT, NAV-TIMEUTC, RMC, ZDA and RTCM 1013. Messages
    that tell only the time of week or of day are completed with the week or day of the last whole one.

    near_ns: UTC within half a day of the first message, nanoseconds since 1970, where it is known beforehand.
    """

    def __init__(self, near_ns: int = -1) -> None:
        self._last_ns = -1
        self._near_ns = near_ns
        self._suspect_ns = -1
        self._leap_s = -1
        self.sources: set[str] = set()

    def restart(self, near_ns: int) -> None:
        """Begin anew with a stream whose time is known nearly, see the class."""
        self._last_ns = self._suspect_ns = self._leap_s = -1
        self._near_ns = near_ns

    def feed(self, batch: Batch) -> Integers:
        """Return the receiver's UTC for each frame, nanoseconds since 1970; -1 before it was told."""
        index, time_ns = self._whole(batch)
        order = np.argsort(index, kind="stable")
        index, time_ns = self._credible(index[order], time_ns[order])
        index, time_ns = self._completed(batch, index, time_ns)
        times = np.concatenate([[self._last_ns], time_ns])
        device = times[np.searchsorted(index, np.arange(len(batch)), side="right")]
        self._last_ns = int(times[-1])
        return np.asarray(device, np.int64)

    def _whole(self, batch: Batch) -> tuple[Integers, Integers]:
        epochs = ubx.decode_rawx(batch).epochs
        f = epochs.fields
        leap = self._leaps(epochs.index, f)
        usable = f["week"] > 0
        gps = week_to_ns(f["week"], f["rcvTow"])[usable]
        parts = {"RXM-RAWX": (epochs.index[usable], gps_to_utc_ns(gps, leap(epochs.index[usable])))}
        timegps = ubx.decode(batch, ubx.NAV_TIMEGPS)
        f = timegps.fields
        sure = (f["valid"] & 3) == 3
        gps = week_to_ns(f["week"], f["iTOW"] * 1e-3 + f["fTOW"] * 1e-9)[sure]
        parts["NAV-TIMEGPS"] = (timegps.index[sure], gps_to_utc_ns(gps, leap(timegps.index[sure])))
        kinds = (("NAV-PVT", ubx.NAV_PVT, "valid", 3), ("NAV-TIMEUTC", ubx.NAV_TIMEUTC, "validflags", 4))
        for name, kind, flags, mask in kinds:
            civil = ubx.decode(batch, kind)
            f = civil.fields
            sure = (f[flags] & mask) == mask
            parts[name] = (civil.index[sure], ubx.civil_utc_ns(f)[sure])
        for protocol in receiver_protocols():
            parts |= protocol.utc(batch)
        self.sources |= {name for name, (index, _) in parts.items() if len(index)}
        return (
            np.concatenate([index for index, _ in parts.values()]),
            np.concatenate([time for _, time in parts.values()]),
        )

    def _leaps(self, index: Integers, epochs: NDArray[Any]) -> Callable[[Integers], Integers]:
        """Return what gives the leap seconds last told before each frame, -1 where none were."""
        determined = (epochs["recStat"] & 1) != 0
        since = index[determined]
        leaps = np.concatenate([[self._leap_s], epochs["leapS"][determined].astype(np.int64)])
        self._leap_s = int(leaps[-1])
        return lambda frames: np.asarray(leaps[np.searchsorted(since, frames, side="right")])

    def _credible(self, index: Integers, time_ns: Integers) -> tuple[Integers, Integers]:
        """Leave out times that leap and are not confirmed by the next: short checksums let errors through."""
        if not len(index):
            return index, time_ns
        before = np.concatenate([[self._last_ns if self._last_ns >= 0 else time_ns[0]], time_ns[:-1]])
        if self._suspect_ns < 0 and (np.abs(time_ns - before) < _LEAP_NS).all():
            return index, time_ns
        kept = []
        last = self._last_ns
        for row, time in enumerate(time_ns.tolist()):
            near = last < 0 or abs(time - last) < _LEAP_NS
            confirmed = self._suspect_ns >= 0 and abs(time - self._suspect_ns) < _LEAP_NS
            if near or confirmed:
                kept.append(row)
                last = time
            self._suspect_ns = -1 if near or confirmed else time
        return index[kept], time_ns[kept]

    def _completed(self, batch: Batch, index: Integers, time_ns: Integers) -> tuple[Integers, Integers]:
        """Add the times of messages without week or day, completed with the whole time before them."""
        before = self._last_ns if self._last_ns >= 0 else self._near_ns
        whole = np.concatenate([[before], time_ns])
        more_index, more_time = [index], [time_ns]
        weekless = [rtcm3.decode_epochs(batch)]
        for kind in _WEEKLESS:
            messages = ubx.decode(batch, kind)
            weekless.append((messages.index, messages.fields["iTOW"].astype(np.int64) * 1_000_000))
        for message_index, of_week in weekless:
            near = whole[np.searchsorted(index, message_index, side="right")]
            usable = near >= 0
            # The epoch of the GPS weeks in UTC, by the leap seconds at that time.
            offset = self._week_offset(near[usable])
            more_index.append(message_index[usable])
            more_time.append(_nearest(near[usable], of_week[usable] + offset, _WEEK_NS))
        gga = nmea.decode_gga(batch)
        near = whole[np.searchsorted(index, gga.index, side="right")]
        usable = (near >= 0) & (gga.time_of_day_ns >= 0)
        more_index.append(gga.index[usable])
        more_time.append(_nearest(near[usable], gga.time_of_day_ns[usable], DAY_NS))
        all_index = np.concatenate(more_index)
        order = np.argsort(all_index, kind="stable")
        return all_index[order], np.concatenate(more_time)[order]

    @staticmethod
    def _week_offset(utc_ns: Integers) -> Integers:
        leap = utc_ns - gps_to_utc_ns(utc_ns - GPS_EPOCH_NS)
        return np.asarray(GPS_EPOCH_NS - leap, np.int64)


def _nearest(near: Integers, phase: Integers, period: int) -> Integers:
    """Return the time with the given phase of a period that is nearest to another time."""
    return np.asarray(near + (phase - near + period // 2) % period - period // 2, np.int64)

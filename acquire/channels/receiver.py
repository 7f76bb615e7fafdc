"""Channels decoded from a GNSS receiver: position, quality, time marks, clock and base station.

The time of a GNSS receiver, read from its own messages.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.decoded import Decoded, in_order, times
from acquire.channels.layouts import ELLIPSOIDAL, STATION, SourceMessages
from drivers import nmea, rtcm3
from drivers.frames import Batch
from drivers.protocols import receiver_protocols
from drivers.receiver import BASE_RECEIVER, TIME_BASES, Fixes
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
        """Return the receiver's UTC for each frame, nanoseconds since 1970; -1 until it is known."""
        index, time_ns = self._whole(batch)
        order = np.argsort(index, kind="stable")
        index, time_ns = self._credible(index[order], time_ns[order])
        index, time_ns = self._completed(batch, index, time_ns)
        times = np.concatenate([[self._last_ns], time_ns])
        device = times[np.searchsorted(index, np.arange(len(batch)), side="right")]
        self._last_ns = int(times[-1])
        return np.asarray(device, np.int64)

    def _whole(self, batch: Batch) -> tuple[Integers, Integers]:
        epochs = ubx.decode_rawx(batch)
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
        parts = [(*rtcm3.decode_epochs(batch), _WEEK_NS), (*nmea.decode_gga_times(batch), DAY_NS)]
        for kind in _WEEKLESS:
            messages = ubx.decode(batch, kind)
            parts.append((messages.index, messages.fields["iTOW"].astype(np.int64) * 1_000_000, _WEEK_NS))
        for message_index, told_ns, period in parts:
            near = whole[np.searchsorted(index, message_index, side="right")]
            usable = (near >= 0) & (told_ns >= 0)
            # The epoch of the GPS weeks in UTC, by the leap seconds at that time.
            begin = self._week_offset(near[usable]) if period == _WEEK_NS else 0
            more_index.append(message_index[usable])
            more_time.append(_nearest(near[usable], told_ns[usable] + begin, period))
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


class ReceiverDecoder:
    """Decodes the frames of a receiver's link, of every protocol of the table; `feed` is a `Decoder`."""

    def __init__(self, link: str) -> None:
        self._link = link
        self._clock = ReceiverClock()
        self._fix_rank = _Rank()
        self._status_rank = _Rank()

    def feed(self, batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Return the device's time of each frame and the decoded messages."""
        device = self._clock.feed(batch)
        publish = np.where(device >= 0, device, log_ns)
        decoded = [
            *self._positions(batch, publish),
            *self._time_marks(batch, publish),
            *self._clocks(batch, log_ns, publish),
            *self._stations(batch, publish),
        ]
        return publish, in_order(decoded)

    def _positions(self, batch: Batch, publish: Integers) -> Iterator[Decoded]:
        by_source = {name: told for p in receiver_protocols() for name, told in p.fixes(batch).items()}
        for source, fixes in self._fix_rank.used(by_source, len(batch)):
            f = fixes.rows(fixes.valid)
            yield self._messages(source, f.index, publish).location(
                f"/gnss/{self._link}/fix",
                (f.latitude_deg, f.longitude_deg, f.height_m),
                (f.horizontal_m, f.vertical_m),
                ELLIPSOIDAL,
                "antenna",
            )
        telling = {name: by_source[name] for p in receiver_protocols() for name in p.told_status()}
        for source, fixes in self._status_rank.used(telling, len(batch)):
            columns = {
                "fix": fixes.fix,
                "satellites": fixes.satellites,
                "hdop": fixes.hdop,
                "horizontal_m": fixes.horizontal_m,
                "vertical_m": fixes.vertical_m,
                "correction_age_s": fixes.age_s,
            }
            yield self._messages(source, fixes.index, publish).status("", columns)

    def _time_marks(self, batch: Batch, publish: Integers) -> Iterator[Decoded]:
        for source, marks in (item for p in receiver_protocols() for item in p.time_marks(batch).items()):
            for edge, of_edge in (("rising", marks.rising), ("falling", ~marks.rising)):
                new = marks.rows(of_edge)
                told = new.valid & (new.base != BASE_RECEIVER)
                names = [TIME_BASES[base] for base in new.base.tolist()]
                columns = {
                    "sequence": new.count,
                    "time": times(np.where(told, gps_to_utc_ns(new.gps_ns), -1)),
                    "gps_time": times(np.where(told, new.gps_ns, -1)),
                    "time_base": [n if v else None for n, v in zip(names, new.valid.tolist(), strict=True)],
                    "accuracy_ns": new.accuracy_ns,
                }
                yield self._messages(source, new.index, publish).exposure(edge, columns)

    def _clocks(self, batch: Batch, log_ns: Integers, publish: Integers) -> Iterator[Decoded]:
        epochs = ubx.decode_rawx(batch)
        f = epochs.fields
        device = publish[epochs.index]
        columns = {
            "device": times(device),
            "host_minus_device_s": (log_ns[epochs.index] - device) / SECOND_NS,
            "gps_week": f["week"],
            "gps_seconds_of_week_s": f["rcvTow"],
            "leap_s": np.where(f["recStat"] & 1, f["leapS"].astype(int), -1),
        }
        yield self._messages("RXM-RAWX", epochs.index, publish).clock(columns)

    def _stations(self, batch: Batch, publish: Integers) -> Iterator[Decoded]:
        topic = f"/gnss/{self._link}/station"
        announced = rtcm3.decode_stations(batch)
        columns: dict[str, Any] = {
            "station": announced["station"],
            **dict(zip(("x_m", "y_m", "z_m"), announced["ecef_m"].T, strict=True)),
            "antenna_height_m": announced["antenna_height_m"],
        }
        yield self._messages("1005/1006", announced.index, publish).json(topic, STATION, columns)
        survey = ubx.decode(batch, ubx.NAV_SVIN)
        # A receiver that surveys nothing sends zeros.
        surveyed = survey.fields["obs"] > 0
        f, index = survey.fields[surveyed], survey.index[surveyed]
        columns = {
            axis: f[f"mean{letter}"] * 1e-2 + f[f"mean{letter}HP"] * 1e-4
            for axis, letter in (("x_m", "X"), ("y_m", "Y"), ("z_m", "Z"))
        }
        columns |= {"accuracy_m": f["meanAcc"] * 1e-4, "survey_valid": f["valid"] != 0}
        yield self._messages("NAV-SVIN", index, publish).json(topic, STATION, columns)

    def _messages(self, source: str, index: Integers, publish: Integers) -> SourceMessages:
        return SourceMessages(self._link, source, index, publish[index])


class _Rank:
    """Remembers the best source so far: a lesser one counts as long as no better one has come."""

    def __init__(self) -> None:
        self._best: int | None = None

    def used(self, by_source: Mapping[str, Fixes], frames: int) -> Iterator[tuple[str, Fixes]]:
        """Yield what counts of each source; the sources are given best first."""
        ranks = list(by_source.items())
        for rank, (source, fixes) in enumerate(ranks):
            if self._best is not None and self._best < rank:
                continue
            better = [int(f.index[0]) for _, f in ranks[:rank] if len(f.index)]
            counting = fixes.index < min(better, default=frames)
            if counting.any():
                yield source, fixes.rows(counting)
        seen = [rank for rank, (_, fixes) in enumerate(ranks) if len(fixes.index)]
        self._best = min([*seen, *([] if self._best is None else [self._best])], default=None)

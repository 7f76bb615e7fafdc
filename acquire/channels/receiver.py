"""Channels decoded from a GNSS receiver: position, quality, time marks, clock and base station."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from acquire.channels.decoded import Decoded, Times, in_order
from acquire.channels.layouts import ELLIPSOIDAL, STATION, SourceMessages
from acquire.channels.receiver_time import ReceiverClock
from drivers import rtcm3
from drivers.frames import Batch
from drivers.protocols import receiver_protocols
from drivers.receiver import BASE_RECEIVER, TIME_BASES, Fixes
from drivers.ubx import decode as ubx
from photocal.base.arrays import Integers
from photocal.base.time_scales import SECOND_NS, gps_to_utc_ns


class ReceiverDecoder:
    """Decodes the frames of a receiver's link, of every protocol of the table; a `Decoder`."""

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
                    "time": Times(np.where(told, gps_to_utc_ns(new.gps_ns), -1)),
                    "gps_time": Times(np.where(told, new.gps_ns, -1)),
                    "time_base": [n if v else None for n, v in zip(names, new.valid.tolist(), strict=True)],
                    "accuracy_ns": new.accuracy_ns,
                }
                yield self._messages(source, new.index, publish).exposure(edge, columns)

    def _clocks(self, batch: Batch, log_ns: Integers, publish: Integers) -> Iterator[Decoded]:
        epochs = ubx.decode_rawx(batch).epochs
        f = epochs.fields
        device = publish[epochs.index]
        columns = {
            "device": Times(device),
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
            "station": announced.station,
            "x_m": announced.ecef_m[:, 0],
            "y_m": announced.ecef_m[:, 1],
            "z_m": announced.ecef_m[:, 2],
            "antenna_height_m": announced.antenna_height_m,
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

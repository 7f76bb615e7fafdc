"""Channels decoded from a GNSS receiver: position, quality, time marks, clock and base station."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.decoded import Decoded, Times, in_order
from acquire.channels.layouts import ELLIPSOIDAL, STATION, SourceMessages
from acquire.channels.receiver_time import ReceiverClock
from drivers import nmea, rtcm3
from drivers.frames import Batch
from drivers.ubx import decode as ubx
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.time_scales import GPS_EPOCH_NS, SECOND_NS, gps_to_utc_ns

_PVT_FIXES = ("none", "dead_reckoning", "2d", "3d", "3d", "time_only")
_GGA_FIXES = {1: "3d", 2: "differential", 3: "3d", 4: "rtk_fixed", 5: "rtk_float", 6: "dead_reckoning"}


class ReceiverDecoder:
    """Decodes the UBX, RTCM 3 and NMEA frames of one link; a `Decoder`."""

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
        by_source = {name: read(batch) for name, read in _READERS.items()}
        for source, fixes in self._fix_rank.used(by_source, len(batch)):
            f = fixes.rows(fixes.valid)
            yield self._messages(source, f.index, publish).location(
                f"/gnss/{self._link}/fix",
                (f.latitude_deg, f.longitude_deg, f.height_m),
                (f.horizontal_m, f.vertical_m),
                ELLIPSOIDAL,
                "antenna",
            )
        telling = {name: by_source[name] for name in _STATUS_SOURCES}
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
        marks = ubx.decode(batch, ubx.TIM_TM2)
        for edge in ("rising", "falling"):
            new = ubx.time_marks(marks.fields, rising=edge == "rising")
            utc = np.where(new.base == ubx.BASE_UTC, new.time_ns + GPS_EPOCH_NS, gps_to_utc_ns(new.time_ns))
            columns = {
                "sequence": new.count,
                "time": Times(np.where(new.valid & (new.base != ubx.BASE_RECEIVER), utc, -1)),
                "accuracy_ns": new.accuracy_ns,
            }
            yield self._messages("TIM-TM2", marks.index[new.index], publish).exposure(edge, columns)

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

    def used(self, by_source: "Mapping[str, _Fixes]", frames: int) -> "Iterator[tuple[str, _Fixes]]":
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


class _Fixes:
    """Positions of one message type, whatever it is called there."""

    def __init__(self, index: Integers, **columns: Any) -> None:
        count = len(index)
        self.index = index
        self.latitude_deg: Floats = columns["latitude_deg"]
        self.longitude_deg: Floats = columns["longitude_deg"]
        self.height_m: Floats = columns["height_m"]
        unknown = np.full(count, np.nan)
        self.horizontal_m: Floats = columns.get("horizontal_m", unknown)
        self.vertical_m: Floats = columns.get("vertical_m", unknown)
        self.hdop: Floats = columns.get("hdop", unknown)
        self.age_s: Floats = columns.get("age_s", unknown)
        self.satellites: Integers = columns.get("satellites", np.full(count, -1))
        self.valid: Flags = columns.get("valid", np.ones(count, bool))
        self.fix: NDArray[np.str_] = np.asarray(columns.get("fix", ["3d"] * count), "U16")

    def rows(self, used: Flags) -> "_Fixes":
        """Return some of the positions."""
        columns = {name: values[used] for name, values in vars(self).items() if name != "index"}
        return _Fixes(self.index[used], **columns)


def _pvt(batch: Batch) -> _Fixes:
    messages = ubx.decode(batch, ubx.NAV_PVT)
    f = messages.fields
    carrier = f["flags"] >> 6
    fix = np.array([_PVT_FIXES[min(v, 5)] for v in f["fixType"].tolist()], "U16")
    fix[(f["flags"] & 2) != 0] = "differential"
    fix[carrier == 1] = "rtk_float"
    fix[carrier == 2] = "rtk_fixed"
    return _Fixes(
        messages.index,
        latitude_deg=f["lat"] * 1e-7,
        longitude_deg=f["lon"] * 1e-7,
        height_m=f["height"] * 1e-3,
        horizontal_m=f["hAcc"] * 1e-3,
        vertical_m=f["vAcc"] * 1e-3,
        satellites=f["numSV"].astype(np.int64),
        # JSON knows no infinity: what is 120 s old or older is told as 120 s.
        age_s=np.minimum(ubx.correction_age_s(f), 120.0),
        valid=(f["flags"] & 1) != 0,
        fix=fix,
    )


def _hpposllh(batch: Batch) -> _Fixes:
    messages = ubx.decode(batch, ubx.NAV_HPPOSLLH)
    f = messages.fields
    return _Fixes(
        messages.index,
        latitude_deg=f["lat"] * 1e-7 + f["_HPlat"] * 1e-9,
        longitude_deg=f["lon"] * 1e-7 + f["_HPlon"] * 1e-9,
        height_m=f["height"] * 1e-3 + f["_HPheight"] * 1e-4,
        horizontal_m=f["hAcc"] * 1e-4,
        vertical_m=f["vAcc"] * 1e-4,
        valid=(f["flags"] & 1) == 0,
    )


def _posllh(batch: Batch) -> _Fixes:
    messages = ubx.decode(batch, ubx.NAV_POSLLH)
    f = messages.fields
    return _Fixes(
        messages.index,
        latitude_deg=f["lat"] * 1e-7,
        longitude_deg=f["lon"] * 1e-7,
        height_m=f["height"] * 1e-3,
        horizontal_m=f["hAcc"] * 1e-3,
        vertical_m=f["vAcc"] * 1e-3,
    )


def _gga(batch: Batch) -> _Fixes:
    f = nmea.decode_gga(batch)
    return _Fixes(
        f.index,
        latitude_deg=f.latitude_deg,
        longitude_deg=f.longitude_deg,
        height_m=f.height_m,
        hdop=f.hdop,
        age_s=f.age_s,
        satellites=f.satellites,
        valid=f.quality > 0,
        fix=[_GGA_FIXES.get(v, "none") for v in f.quality.tolist()],
    )


_READERS: dict[str, Callable[[Batch], _Fixes]] = {
    "NAV-PVT": _pvt,
    "NAV-HPPOSLLH": _hpposllh,
    "NAV-POSLLH": _posllh,
    "GGA": _gga,
}
_STATUS_SOURCES = ("NAV-PVT", "GGA")

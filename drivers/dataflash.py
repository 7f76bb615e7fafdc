"""DataFlash logs of ArduPilot (`.bin`): self-describing records without a checksum.

Source: ArduPilot, libraries/AP_Logger/LogStructure.h and README.md (format characters).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Batch, Wire, gather
from drivers.logged import NOTHING, WAIT, RecordFramer, Records, placed, since_boot_ns
from photocal.base.arrays import Integers
from photocal.base.time_scales import gps_to_utc_ns, week_to_ns

HEAD = b"\xa3\x95"
HEAD_BYTES = 3
FMT, FMT_BYTES = 128, 89
_MILLISECOND_NS, _MICROSECOND_NS = 1_000_000, 1000

_TYPES = {
    "a": ("<i2", (32,)), "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4",
    "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
    "M": "u1", "q": "<i8", "Q": "<u8", "g": "<f2",
}  # fmt: skip
# Hundredths, and degrees in 1e-7.
_SCALES = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
_GPS = ("GPS", "GPS2")


class DataflashFramer(RecordFramer):
    """Records of a DataFlash log; the kind of a frame is its type number."""

    wire = Wire.DATAFLASH

    def __init__(self) -> None:
        super().__init__()
        self._sizes = [0] * 256
        self._sizes[FMT] = FMT_BYTES

    def _examine(self, data: bytes, at: int) -> int:
        left = len(data) - at
        if left < HEAD_BYTES:
            return WAIT if HEAD.startswith(data[at : at + 2]) else NOTHING
        if data[at] != HEAD[0] or data[at + 1] != HEAD[1]:
            return NOTHING
        size = self._sizes[data[at + 2]]
        return WAIT if size > left else size

    def _head(self, data: bytes, at: int) -> int:
        # A record of a type that is not defined yet may follow; so may one that the end cuts off.
        if len(data) - at < len(HEAD):
            return WAIT if HEAD.startswith(data[at : at + 2]) else NOTHING
        return int(data.startswith(HEAD, at))

    def _next(self, data: bytes, at: int) -> int:
        start = data.find(HEAD, at)
        if start >= 0:
            return start
        return len(data) - 1 if len(data) > at and data[-1] == HEAD[0] else len(data)

    def _learn(self, data: bytes, at: int) -> int:
        kind = data[at + 2]
        if kind == FMT and data[at + 4] >= HEAD_BYTES and not self._sizes[data[at + 3]]:
            self._sizes[data[at + 3]] = data[at + 4]
        return kind


class DataflashFormats:
    """The formats that a log defines in its FMT records.

    The first definition of a type stands; one whose format does not give its length is not decoded.
    """

    def __init__(self) -> None:
        self._types: dict[str, int] = {}
        self._rows: dict[int, np.dtype[Any]] = {}
        self._scales: dict[int, dict[str, float]] = {}
        self._defined: set[int] = set()

    def learn(self, batch: Batch) -> None:
        """Take over the FMT records of a batch."""
        for index in batch.where(Wire.DATAFLASH, FMT).tolist():
            record = batch.frame(index).data
            kind, length = record[3], record[4]
            if len(record) != FMT_BYTES or kind in self._defined:
                continue
            self._defined.add(kind)
            name, form, columns = (
                record[a:b].split(b"\0")[0].decode("latin-1") for a, b in ((5, 9), (9, 25), (25, 89))
            )
            self._define(kind, length, name, form, columns.split(",") if columns else [])

    def _define(self, kind: int, length: int, name: str, form: str, columns: list[str]) -> None:
        if len(form) != len(columns) or len(set(columns)) != len(columns) or "" in columns:
            return
        if not all(letter in _TYPES for letter in form) or name in self._types:
            return
        row = np.dtype([(c, _TYPES[letter]) for c, letter in zip(columns, form, strict=True)])
        if row.itemsize + HEAD_BYTES != length:
            return
        self._types[name] = kind
        self._rows[kind] = row
        self._scales[kind] = {c: _SCALES[f] for c, f in zip(columns, form, strict=True) if f in _SCALES}

    def decode(self, batch: Batch, name: str) -> Records:
        """Return the records of a name; angles in degrees, what the log keeps in hundredths in units."""
        kind = self._types.get(name)
        if kind is None:
            return Records(np.empty(0, np.int64), {})
        index = batch.where(Wire.DATAFLASH, kind)
        fields = self._fields(batch, index, kind)
        scales = self._scales[kind]
        names = fields.dtype.names or ()
        return Records(index, {c: fields[c] * scales[c] if c in scales else fields[c] for c in names})

    def boot_ns(self, batch: Batch) -> Integers:
        """Return the time of each record since the autopilot started, nanoseconds; -1 where it has none."""
        boot = np.full(len(batch), -1, np.int64)
        names = {kind: name for name, kind in self._types.items()}
        for kind in np.unique(batch.kind).tolist():
            if kind not in self._rows:
                continue
            columns = self._rows[kind].names or ()
            unit = _time_column(names[kind], columns)
            if unit is None or self._rows[kind][unit[0]].kind not in "iu":
                continue
            index = batch.where(Wire.DATAFLASH, kind)
            boot[index] = since_boot_ns(self._fields(batch, index, kind)[unit[0]], unit[1])
        return boot

    def told_utc(self, batch: Batch) -> tuple[Integers, Integers]:
        """Return times since the start and UTC (nanoseconds) of the records of receivers with a 3D fix."""
        return placed(self.boot_ns(batch), [_utc(self.decode(batch, name)) for name in _GPS])

    def _fields(self, batch: Batch, index: Integers, kind: int) -> NDArray[Any]:
        start, length = batch.start[index] + HEAD_BYTES, batch.length[index] - HEAD_BYTES
        return gather(batch.data, start, length, self._rows[kind])


def _time_column(name: str, columns: tuple[str, ...]) -> tuple[str, int] | None:
    if "TimeUS" in columns and columns[0] == "TimeUS":
        return "TimeUS", _MICROSECOND_NS
    # Until 2015 the TimeMS of a receiver's record was that of the GPS week.
    if name in _GPS:
        return ("T", _MILLISECOND_NS) if "T" in columns else None
    return ("TimeMS", _MILLISECOND_NS) if "TimeMS" in columns else None


def receiver_utc_ns(
    records: Records, weeks: tuple[str, ...] = ("GWk", "Week"), times: tuple[str, ...] = ("GMS", "TimeMS")
) -> Integers:
    """Return UTC of the GPS times that records tell, nanoseconds since 1970; -1 where they tell none."""
    week, of_week = records.number(*weeks), records.number(*times)
    known = (week > 0) & (week < 1 << 16) & (of_week >= 0)
    gps = week_to_ns(np.where(known, week, 0), np.where(known, of_week, 0) * 1e-3)
    return np.where(known, gps_to_utc_ns(gps), -1)


def _utc(records: Records) -> tuple[Integers, Integers]:
    utc = receiver_utc_ns(records)
    good = (utc >= 0) & (records.number("Status") >= 3)
    return records.index[good], utc[good]

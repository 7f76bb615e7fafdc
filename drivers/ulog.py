"""Logs of PX4 (`.ulg`): self-describing records without a checksum.

Source: PX4 User Guide, "ULog File Format".
"""

import math
import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Batch, Wire, gather
from drivers.logged import NOTHING, WAIT, RecordFramer, Records, placed, since_boot_ns
from photocal.base.arrays import Floats, Integers

MAGIC = b"ULog\x01\x12\x35"
FILE_HEAD_BYTES, HEAD_BYTES = 16, 3
DATA, SUBSCRIBED, FORMAT, TEXT, PARAMETER = ord("D"), ord("A"), ord("F"), ord("L"), ord("P")
FILE_HEAD_KIND = 0
_SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "?", "char": "S1",
}  # fmt: skip
# Lengths of what follows the head, for the kinds of a fixed length.
_FIXED = {ord("B"): 40, ord("R"): 2, ord("S"): 8, ord("O"): 2}
_KEYED = {ord("I"): 0, ord("M"): 1, ord("P"): 0, ord("Q"): 1}
_PLACES = re.compile(rb"[\s\S]{2}[BFIMPQARDLCSO]")
_MEMBER = re.compile(r"([A-Za-z_]\w*)(?:\[(\d+)\])? ([A-Za-z_]\w*)")
# Where the text begins in logged strings, without and with a tag.
_TEXTS = {TEXT: 9, ord("C"): 11}
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_LONGEST_FORMAT, _LONGEST_ARRAY, _DEEPEST = 4096, 4096, 8
YEAR_2000_US, _YEAR_2100_US = 946_684_800e6, 4_102_444_800e6
_PUBLISHED = ("vehicle_gps_position", "sensor_gps")


class UlogFormats:
    """The formats and subscriptions that a log defines.

    The first definition of a name and the first subscription of a number stand. Further instances of a topic
    are named with their number: `sensor_gps[1]`.
    """

    def __init__(self) -> None:
        self._formats: dict[str, str] = {}
        self._topics: dict[str, int] = {}
        self.rows: dict[int, np.dtype[Any]] = {}

    def learn(self, batch: Batch) -> None:
        """Take over the formats and subscriptions of a batch."""
        for kind in (FORMAT, SUBSCRIBED):
            for index in batch.where(Wire.ULOG, kind << 16).tolist():
                self.take(batch.frame(index).data)

    def take(self, record: bytes) -> None:
        """Take over one record, when it is a format or a subscription."""
        if record[2] == FORMAT:
            name, _, members = record[HEAD_BYTES:].decode("latin-1").partition(":")
            self._formats.setdefault(name, members)
        elif record[2] == SUBSCRIBED and len(record) > HEAD_BYTES + 3:
            number = int.from_bytes(record[4:6], "little")
            name = record[6:].decode("latin-1")
            row = self._row(name, 0)
            topic = f"{name}[{record[3]}]" if record[3] else name
            if row is not None and number not in self.rows and topic not in self._topics:
                self.rows[number] = row
                self._topics[topic] = number

    def _row(self, name: str, depth: int) -> np.dtype[Any] | None:
        members: list[tuple[Any, ...]] = []
        size = 0
        for text in filter(None, self._formats.get(name, "").split(";")):
            match = _MEMBER.fullmatch(text)
            if match is None or depth > _DEEPEST or any(match[3] == member[0] for member in members):
                return None
            kind: Any = _TYPES.get(match[1]) or self._row(match[1], depth + 1)
            count = int(match[2] or 1)
            if kind is None or not 0 < count <= _LONGEST_ARRAY:
                return None
            size += np.dtype(kind).itemsize * count
            if size > 1 << 16:
                return None
            if kind == "S1":
                members.append((match[3], f"S{count}"))
            else:
                members.append((match[3], kind, (count,)) if match[2] else (match[3], kind))
        # Padding at the end is part of the format but not of the records.
        while members and depth == 0 and str(members[-1][0]).startswith("_padding"):
            members.pop()
        return np.dtype(members) if members else None

    def decode(self, batch: Batch, name: str) -> Records:
        """Return the data of a topic; members that are formats themselves are structured."""
        number = self._topics.get(name)
        if number is None:
            return Records(np.empty(0, np.int64), {})
        index = batch.where(Wire.ULOG, DATA << 16 | number)
        fields = self._fields(batch, index, number)
        return Records(index, {member: fields[member] for member in fields.dtype.names or ()})

    def texts(self, batch: Batch) -> Records:
        """Return the messages to the pilot: `severity`, `text`."""
        index = batch.where(Wire.ULOG, TEXT << 16)
        records = [batch.frame(i).data for i in index.tolist()]
        severity = np.array([record[3] - ord("0") for record in records], np.int64)
        text = np.array([record[12:].decode("utf-8", "replace") for record in records], str)
        return Records(index, {"severity": severity, "text": text})

    def parameters(self, batch: Batch) -> Records:
        """Return the parameters at the start and their changes: `name`, `value`."""
        index = batch.where(Wire.ULOG, PARAMETER << 16)
        parameters = [_parameter(batch.frame(i).data) for i in index.tolist()]
        valid = np.array([value == value for _, value in parameters], bool)
        names, values = zip(*parameters, strict=True) if parameters else ((), ())
        return Records(index, {"name": np.array(names, str), "value": np.array(values, float)}).rows(valid)

    def boot_ns(self, batch: Batch) -> Integers:
        """Return the time of each record since the autopilot started, nanoseconds; -1 where it has none."""
        boot = np.full(len(batch), -1, np.int64)
        for kind in np.unique(batch.kind[batch.kind >> 16 == DATA]).tolist():
            row = self.rows.get(kind & 0xFFFF)
            if row is None or "timestamp" not in (row.names or ()) or row["timestamp"] != np.dtype("<u8"):
                continue
            index = batch.where(Wire.ULOG, kind)
            boot[index] = since_boot_ns(self._fields(batch, index, kind & 0xFFFF)["timestamp"], 1000)
        index = batch.where(Wire.ULOG, TEXT << 16)
        stamp = gather(batch.data, batch.start[index] + 4, batch.length[index] - 4, np.dtype([("t", "<u8")]))
        boot[index] = since_boot_ns(stamp["t"], 1000)
        return boot

    def told_utc(self, batch: Batch) -> tuple[Integers, Integers]:
        """Return times since the start and UTC (nanoseconds) of the records of receivers with a 3D fix."""
        return placed(self.boot_ns(batch), [_utc(self.decode(batch, topic)) for topic in _PUBLISHED])

    def _fields(self, batch: Batch, index: Integers, number: int) -> NDArray[Any]:
        head = HEAD_BYTES + 2
        return gather(batch.data, batch.start[index] + head, batch.length[index] - head, self.rows[number])


def kind_of(record: bytes) -> int:
    """Return the kind of a record by its first bytes, see `UlogFramer`; 0 of what is too short for one."""
    if record.startswith(MAGIC) or len(record) < HEAD_BYTES:
        return FILE_HEAD_KIND
    numbered = record[2] == DATA and len(record) >= HEAD_BYTES + 2
    return record[2] << 16 | (record[3] | record[4] << 8 if numbered else 0)


class UlogFramer(RecordFramer):
    """Records of a ULog; the kind of a frame is its letter * 65536 + number of the topic."""

    wire = Wire.ULOG

    def __init__(self) -> None:
        super().__init__()
        self._formats = UlogFormats()

    def _examine(self, data: bytes, at: int) -> int:
        size = self._meant(data, at)
        return WAIT if size > len(data) - at else size

    def _head(self, data: bytes, at: int) -> int:
        return min(self._meant(data, at), 1)

    def _meant(self, data: bytes, at: int) -> int:
        """Return the length that a record at a place would have, `NOTHING` or `WAIT`."""
        if self._offset + at == 0 and data[: len(MAGIC)] == MAGIC[: len(data)]:
            return FILE_HEAD_BYTES
        if len(data) - at < HEAD_BYTES:
            return WAIT
        kind = data[at + 2]
        size = data[at] | data[at + 1] << 8
        body = at + HEAD_BYTES
        if kind == DATA:
            if len(data) < body + 2:
                return WAIT
            row = self._formats.rows.get(data[body] | data[body + 1] << 8)
            fits = row is not None and size == row.itemsize + 2
        elif kind in _FIXED:
            if kind == ord("S") and len(data) < body + len(_SYNC):
                return WAIT
            fits = size == _FIXED[kind] and (kind != ord("S") or data.startswith(_SYNC, body))
        else:
            length = self._worded(data, body, kind, size)
            if length == WAIT:
                return WAIT
            fits = length > 0
        return HEAD_BYTES + size if fits else NOTHING

    @staticmethod
    def _worded(data: bytes, body: int, kind: int, size: int) -> int:
        """Tell whether the words with which a record of variable length begins can be meant."""
        # Within so many bytes the name of a format ends.
        name_bytes = 80
        if kind == SUBSCRIBED:
            at, length = body + 3, size - 3
        elif kind == FORMAT:
            at, length = body, min(size, name_bytes) if size <= _LONGEST_FORMAT else 0
        elif kind in _KEYED:
            at = body + _KEYED[kind] + 1
            if len(data) < at:
                return WAIT
            length = data[at - 1]
            if length + (at - body) > size:
                return NOTHING
        elif kind in _TEXTS:
            return _text(data, body + _TEXTS[kind], body + size)
        else:
            return NOTHING
        if not 0 < length <= 0xFF:
            return NOTHING
        words = data[at : at + length]
        if len(words) < length:
            return WAIT
        needed = b":" if kind == FORMAT else b" " if kind in _KEYED else b""
        return int(needed in words and all(0x20 <= c < 0x7F for c in words))

    def _next(self, data: bytes, at: int) -> int:
        match = _PLACES.search(data, at)
        return match.start() if match else max(at, len(data) - HEAD_BYTES + 1)

    def _learn(self, data: bytes, at: int) -> int:
        kind = kind_of(data[at : at + FILE_HEAD_BYTES])
        if kind >> 16 in (FORMAT, SUBSCRIBED):
            self._formats.take(data[at : at + HEAD_BYTES + (data[at] | data[at + 1] << 8)])
        return kind


def _text(data: bytes, at: int, end: int) -> int:
    """Tell whether a text can be meant: it has no control characters, so other records are none."""
    # No text of PX4 is longer.
    longest_text = 512
    if not 0 <= end - at <= longest_text:
        return NOTHING
    if len(data) < end:
        return WAIT
    return int(not _CONTROL.search(data, at, end))


def _parameter(record: bytes) -> tuple[str, float]:
    """Return name and value of a parameter; not a number where it is of another type or cut."""
    at = HEAD_BYTES + 1 + record[HEAD_BYTES]
    kind, _, name = record[HEAD_BYTES + 1 : at].decode("latin-1").partition(" ")
    form = {"float": "<f", "int32_t": "<i"}.get(kind)
    return name, float(struct.unpack(form, record[at:])[0]) if form and len(record) - at == 4 else math.nan


def told_utc_ns(microseconds: Floats, earliest_us: float = YEAR_2000_US) -> Integers:
    """Return UTC that records tell, nanoseconds since 1970; -1 where they tell none."""
    plausible = (microseconds > earliest_us) & (microseconds < _YEAR_2100_US)
    return np.where(plausible, np.where(plausible, microseconds, 0).astype(np.int64) * 1000, -1)


def _utc(records: Records) -> tuple[Integers, Integers]:
    utc = told_utc_ns(records.number("time_utc_usec"))
    good = (utc >= 0) & (records.number("fix_type") >= 3)
    return records.index[good], utc[good]

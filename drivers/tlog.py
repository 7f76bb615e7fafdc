"""Telemetry logs (`.tlog`): MAVLink frames, each after the time at which the ground station received it."""

from __future__ import annotations

from binascii import crc_hqx

import numpy as np
from numpy.typing import NDArray

from drivers.checksums import REVERSED
from drivers.frames import Batch, Wire
from drivers.mavlink import wire
from drivers.mavlink.dialect import Dialect, ardupilotmega
from drivers.window import Window

STAMP_BYTES = 8
# A stamp is believed from 2000 to 2100: microseconds since 1970, UTC, big-endian.
EARLIEST_US = 946_684_800_000_000
LATEST_US = 4_102_444_800_000_000

_REVERSED = np.frombuffer(REVERSED, np.uint8)
_STEP = np.array([crc_hqx(bytes((value,)), 0) for value in range(256)], np.int64)
# Records that are walked before their checksums are tested: few after damage, where the row may break again.
_LEAST_STRIDE, _LONGEST_STRIDE = 64, 16384

# Start of the frame, length, kind, known, stamp in microseconds.
_Record = tuple[int, int, int, int, int]


class TlogFramer:
    """Frames of a telemetry log, with their host stamps; a `Framer`.

    Intact records follow each other, so their places are found by walking along the lengths and all checksums
    are tested at once. Where a record fails, the next intact frame is searched for byte by byte; a frame
    whose stamp was damaged is kept with the stamp before it.

    Parameters
    ----------
    dialect : Dialect, optional
        The known messages.
    """

    stamped = True

    def __init__(self, dialect: Dialect | None = None) -> None:
        self._dialect = dialect or ardupilotmega()
        self._grammar = wire.MavlinkGrammar(self._dialect)
        self._pending = b""
        self._offset = 0
        self._stamp_us = 0
        self._needed = 1
        self._cut = 0

    @property
    def cut(self) -> int:
        """Number of bytes of a record that the end of the log cut off; 0 until `close`."""
        return self._cut

    def feed(self, data: bytes) -> Batch:
        """Take the next bytes of the log and return the frames that are complete."""
        self._pending += data
        return self._take(closed=False)

    def close(self) -> Batch:
        """Return what is left when the log has ended."""
        rest = len(self._pending)
        whole = self._begins_record(self._pending, 0) is not False
        batch = self._take(closed=True)
        self._cut = rest if whole and rest and not len(batch) else 0
        return batch

    def _take(self, closed: bool) -> Batch:
        window = Window(self._pending, closed)
        parts: list[NDArray[np.int64]] = [np.empty((0, 5), np.int64)]
        damage: list[tuple[int, int]] = []
        at, stride = 0, _LEAST_STRIDE
        while at < len(window.data):
            rows, intact = self._walk(window, at, stride)
            at, aligned = self._accept(window, at, rows, intact, parts)
            if aligned and len(rows):
                stride = min(2 * stride, _LONGEST_STRIDE)
                continue
            found = self._search(window, at)
            if found is None:
                break
            begin, record = found
            if begin > at:
                damage.append((self._offset + at, begin - at))
            at = begin
            if record is not None:
                at = self._append(record, parts)
            stride = _LEAST_STRIDE
        return self._batch(np.concatenate(parts), damage, at)

    def _accept(
        self,
        window: Window,
        at: int,
        rows: NDArray[np.int64],
        intact: NDArray[np.bool_],
        parts: list[NDArray[np.int64]],
    ) -> tuple[int, bool]:
        """Take over walked records up to the first that breaks the row.

        Records that are not plainly intact are examined singly: unknown messages keep the row.
        """
        upto = len(rows)
        for index in np.flatnonzero(~intact).tolist():
            frame = int(rows[index, 0])
            stamp = self._stamp(window.data, frame - STAMP_BYTES)
            if not stamp:
                upto = index
                break
            length, kind, known = self._grammar.examine(window, frame, lambda end: self._may_end(window, end))
            if length != rows[index, 1]:
                upto = index
                break
            rows[index] = frame, length, kind, known, stamp
        if upto:
            parts.append(rows[:upto])
            at = int(rows[upto - 1, 0] + rows[upto - 1, 1])
            self._stamp_us = int(rows[upto - 1, 4])
        return at, upto == len(rows)

    def _append(self, record: _Record, parts: list[NDArray[np.int64]]) -> int:
        self._stamp_us = record[4]
        parts.append(np.array([record], np.int64))
        return record[0] + record[1]

    def _walk(self, window: Window, at: int, stride: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Walk along the lengths of records; return them and which of them are plainly intact."""
        data, end = window.data, len(window.data)
        starts = []
        for _ in range(stride):
            frame = at + STAMP_BYTES
            if frame + 10 > end:
                break
            magic = data[frame]
            if magic == wire.V1:
                after = frame + data[frame + 1] + 8
            elif magic == wire.V2:
                after = frame + data[frame + 1] + 12 + (data[frame + 2] & wire.SIGNED) * wire.SIGNATURE_BYTES
            else:
                break
            if after > end:
                break
            starts.append(frame)
            at = after
        start = np.array(starts, np.int64)
        return self._examine(window, start, np.append(start[1:] - STAMP_BYTES, at)[: len(start)])

    def _examine(
        self, window: Window, start: NDArray[np.int64], after: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        if not len(start):
            return np.empty((0, 5), np.int64), np.empty(0, bool)
        octets = np.frombuffer(window.data, np.uint8)
        turned = np.frombuffer(window.turned, np.uint8)
        second = octets[start] == wire.V2
        flags = np.where(second, octets[start + 2], 0).astype(np.int64)
        checked = after - 2 - np.where(flags & wire.SIGNED, wire.SIGNATURE_BYTES, 0)
        kind = np.where(second, _little24(octets, np.where(second, start + 7, 0)), octets[start + 5])
        seed = np.where(kind < 65536, self._dialect.seed_table[np.minimum(kind, 65535)], -1)
        stamp = _stamps(octets, start - STAMP_BYTES)
        view = window.turned
        pairs = zip((start + 1).tolist(), checked.tolist(), strict=True)
        remainder = np.array([crc_hqx(view[a:b], 0xFFFF) for a, b in pairs], np.int64)
        continued = ((remainder << 8) & 0xFFFF) ^ _STEP[(remainder >> 8) ^ _REVERSED[np.maximum(seed, 0)]]
        check = turned[checked].astype(np.int64) << 8 | turned[checked + 1]
        intact = (continued == check) & (seed >= 0) & (flags & ~wire.SIGNED == 0) & _plausible(stamp)
        rows = (start, after - start, kind, intact, stamp)
        return np.stack(rows, axis=1).astype(np.int64), intact

    def _search(self, window: Window, at: int) -> tuple[int, _Record | None] | None:
        """Find the next intact frame from a record on that is not plainly intact.

        Returns where the record begins and the record; or the place up to which there is nothing and None; or
        None when more bytes are needed before anything can be said.
        """
        data = window.data
        place = at
        while (match := wire.STARTS.search(data, place)) is not None:
            frame = match.start()
            place = frame + 1
            stamp = self._stamp(data, frame - STAMP_BYTES) if frame - STAMP_BYTES >= at else 0
            if stamp:
                length, kind, known = self._grammar.examine(
                    window, frame, lambda index: self._may_end(window, index)
                )
            else:
                length, kind, known = self._grammar.examine_known(window, frame)
            if length < 0:
                return self._waiting(at, max(at, frame - STAMP_BYTES))
            if length > 0:
                begin = frame - STAMP_BYTES if stamp else frame
                return begin, (frame, length, kind, int(known), stamp or self._stamp_us)
        if window.closed:
            return (len(data), None) if len(data) > at else None
        # The stamp of the next record may have begun already.
        return self._waiting(at, max(at, len(data) - STAMP_BYTES))

    @staticmethod
    def _waiting(at: int, upto: int) -> tuple[int, None] | None:
        return (upto, None) if upto > at else None

    def _may_end(self, window: Window, index: int) -> bool | None:
        """Tell whether a record may end before `index`: a stamp and a start byte follow, or the log ends."""
        if index == len(window.data) and window.closed:
            return True
        begins = self._begins_record(window.data, index)
        return False if begins is None and window.closed else begins

    @staticmethod
    def _begins_record(data: bytes, index: int) -> bool | None:
        if index + STAMP_BYTES >= len(data):
            return None
        return bool(TlogFramer._stamp(data, index)) and data[index + STAMP_BYTES] in (wire.V1, wire.V2)

    @staticmethod
    def _stamp(data: bytes, index: int) -> int:
        stamp = int.from_bytes(data[index : index + STAMP_BYTES], "big")
        return stamp if EARLIEST_US < stamp < LATEST_US else 0

    def _batch(self, rows: NDArray[np.int64], damage: list[tuple[int, int]], consumed: int) -> Batch:
        data, base = self._pending[:consumed], self._offset
        self._pending = self._pending[consumed:]
        self._offset += consumed
        return Batch(
            data=data,
            base=base,
            start=rows[:, 0],
            length=rows[:, 1],
            wire=np.full(len(rows), Wire.MAVLINK, np.uint8),
            kind=rows[:, 2],
            known=rows[:, 3].astype(bool),
            damage=np.array(damage, np.int64).reshape(-1, 2),
            host_ns=rows[:, 4] * 1000,
        )


def _little24(octets: NDArray[np.uint8], at: NDArray[np.int64]) -> NDArray[np.int64]:
    low = octets[at].astype(np.int64)
    return low | octets[at + 1].astype(np.int64) << 8 | octets[at + 2].astype(np.int64) << 16


def _stamps(octets: NDArray[np.uint8], at: NDArray[np.int64]) -> NDArray[np.int64]:
    value = np.zeros(len(at), np.uint64)
    for position in range(STAMP_BYTES):
        value = value << np.uint64(8) | octets[at + position]
    # A damaged stamp may exceed what a signed number holds; it is out of the believed range anyway.
    return np.minimum(value, np.uint64(LATEST_US)).astype(np.int64)


def _plausible(stamp: NDArray[np.int64]) -> NDArray[np.bool_]:
    return (stamp > EARLIEST_US) & (stamp < LATEST_US)

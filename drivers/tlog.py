"""Telemetry logs (`.tlog`): MAVLink frames, each after the time at which the ground station received it."""

from binascii import crc_hqx

import numpy as np

from drivers import scan
from drivers.checksums import REVERSED, x25
from drivers.frames import Batch, Framer, Wire, batch_of, numbers_at
from drivers.mavlink.dialect import SIGNATURE_BYTES, SIGNED, V1, V2, Dialect, ardupilotmega
from drivers.scan import EARLIEST_US, LATEST_US, STAMP_BYTES
from photocal.base.arrays import Integers

_REVERSED = np.frombuffer(REVERSED, np.uint8)
_STEP = np.array([crc_hqx(bytes((value,)), 0) for value in range(256)], np.int64)
# The value of which a step is made; -1: of none.
_STEPPED = np.full(1 << 16, -1, np.int64)
_STEPPED[_STEP] = np.arange(256)
# From here on it pays to load what was compiled: half a second, where a place is damaged here and there a
# search of a small window by the plain functions takes milliseconds.
_LARGE = 2048
_WINDOWS = (512, _LARGE - 1, _LARGE - 1, _LARGE - 1)


class TlogFramer(Framer):
    """Frames of a telemetry log, with their host stamps.

    Intact records follow each other, so their places are found by walking along the lengths and all checksums
    are tested at once. From the first that fails on, `drivers.scan` searches byte by byte; a frame whose
    stamp was damaged is kept with the stamp before it.
    """

    stamped = True

    def __init__(self, dialect: Dialect | None = None) -> None:
        super().__init__()
        self._dialect = dialect or ardupilotmega()
        self._memory = scan.new_memory()
        self._stamp_us = 0

    def _begun(self) -> bool:
        head = self._pending[: STAMP_BYTES + 1]
        stamp = int.from_bytes(head[:STAMP_BYTES], "big")
        return len(head) <= STAMP_BYTES or (EARLIEST_US < stamp < LATEST_US and head[-1] in (V1, V2))

    def _take(self, closed: bool) -> Batch:
        """Walk while records are intact, search where one is not, and walk on; at last search the rest."""
        records = [np.empty((0, 5), np.int64)]
        lost = [np.empty((0, 2), np.int64)]
        at, end = 0, len(self._pending)
        tables = scan.tables_of(self._dialect)
        for window in (*_WINDOWS, end):
            rows = self._walk(at)
            records.append(rows)
            if len(rows):
                at, self._stamp_us = int(rows[-1, 0] + rows[-1, 1]), int(rows[-1, 4])
            piece = self._pending[at : at + window]
            last = at + len(piece) == end
            if len(piece) >= _LARGE:
                scan.compile_search()
            octets = np.frombuffer(piece, np.uint8).astype(np.int32)
            more, damage, rest = scan.search_records(
                octets, closed and last, self._stamp_us, self._memory, tables
            )
            if len(more):
                self._stamp_us = int(more[-1, 4])
            more[:, 0] += at
            damage[:, 0] += self._offset + at
            records.append(more)
            lost.append(damage)
            at += rest
            if last:
                break
        start, length, kind, known, stamp_us = np.concatenate(records).T
        columns, damage = (start, length, kind), np.concatenate(lost)
        return batch_of(Wire.MAVLINK, *self._consumed(at), columns, damage, known, stamp_us * 1000)

    def _walk(self, at: int) -> Integers:
        """Walk along the lengths of records; return them up to the first that is not plainly intact."""
        data, end = self._pending, len(self._pending)
        starts = []
        while (frame := at + STAMP_BYTES) + 10 <= end:
            if data[frame] == V1:
                after = frame + data[frame + 1] + 8
            elif data[frame] == V2:
                after = frame + data[frame + 1] + 12 + (data[frame + 2] & SIGNED) * SIGNATURE_BYTES
            else:
                break
            if after > end:
                break
            starts.append(frame)
            at = after
        if not starts:
            return np.empty((0, 5), np.int64)
        start = np.array(starts, np.int64)
        rows, seeds = self._examine(start, np.append(start[1:] - STAMP_BYTES, at))
        known = rows[:, 3] != 0
        for row in np.flatnonzero(~known).tolist():
            # As in `drivers.scan`: a record follows, a seed explains the checksum, nothing known is inside.
            followed = row + 1 < len(rows) and (known[row + 1] or seeds[row + 1] >= 0)
            if seeds[row] < 0 or not followed or self._holds_known(*rows[row, :2].tolist()):
                return rows[:row]
            if not scan.recall_unknown(self._memory, int(rows[row, 2]), int(seeds[row])):
                return rows[:row]
        return rows

    def _holds_known(self, start: int, length: int) -> bool:
        """Tell whether a frame of a known message may begin inside another frame."""
        data, seeds = self._pending, self._dialect.seeds
        for place in range(start + 1, start + length):
            if data[place] not in (V1, V2):
                continue
            if place + 10 > len(data):
                return True
            second = data[place] == V2
            kind = int.from_bytes(data[place + 7 : place + 10], "little") if second else data[place + 5]
            if kind not in seeds or (second and data[place + 2] & ~SIGNED):
                continue
            end = place + data[place + 1] + (10 if second else 6)
            if end + 2 + SIGNATURE_BYTES > len(data) or x25(
                data[place + 1 : end], seeds[kind]
            ) == int.from_bytes(data[end : end + 2], "little"):
                return True
        return False

    def _examine(self, start: Integers, after: Integers) -> tuple[Integers, Integers]:
        """Return the rows of frames, and the seed with which one may be an unknown message; -1: none."""
        octets = np.frombuffer(self._pending, np.uint8)
        view = self._pending.translate(REVERSED)
        turned = np.frombuffer(view, np.uint8)
        second = octets[start] == V2
        flags = np.where(second, octets[start + 2], 0).astype(np.int64)
        checked = after - 2 - np.where(flags & SIGNED, SIGNATURE_BYTES, 0)
        long = numbers_at(self._pending, np.where(second, start + 7, 0), "<u4") & 0xFFFFFF
        kind = np.where(second, long, octets[start + 5]).astype(np.int64)
        tables, payload = scan.tables_of(self._dialect), octets[start + 1]
        seed = np.where(kind < 65536, tables.seeds[np.minimum(kind, 65535)], -1)
        # A damaged stamp may exceed what a signed number holds; it is out of the believed range anyway.
        stamp = np.minimum(numbers_at(self._pending, start - STAMP_BYTES, ">u8"), LATEST_US).astype(np.int64)
        pairs = zip((start + 1).tolist(), checked.tolist(), strict=True)
        remainder = np.array([crc_hqx(view[a:b], 0xFFFF) for a, b in pairs], np.int64)
        continued = ((remainder << 8) & 0xFFFF) ^ _STEP[(remainder >> 8) ^ _REVERSED[np.maximum(seed, 0)]]
        check = turned[checked].astype(np.int64) << 8 | turned[checked + 1]
        believed = (stamp > EARLIEST_US) & (stamp < LATEST_US)
        sound = (flags & ~SIGNED == 0) & believed
        rows = (start, after - start, kind, (continued == check) & (seed >= 0) & sound, stamp)
        # A message of the tables with a length that it cannot have is another definition of its number.
        fits = np.where(
            second, payload <= tables.sizes[np.minimum(kind, 65535)], tables.boundaries[kind & 0xFF, payload]
        )
        stepped = _STEPPED[check ^ ((remainder << 8) & 0xFFFF)]
        explained = _REVERSED[np.maximum(stepped, 0) ^ (remainder >> 8)].astype(np.int64)
        seeds = np.where(sound & ((seed < 0) | ~fits) & (stepped >= 0), explained, -1)
        return np.stack(rows, axis=1).astype(np.int64), seeds

"""Framing of a stream on which several protocols may be mixed, with resynchronisation after damage."""

from __future__ import annotations

from collections.abc import Iterable
from re import compile as pattern

import numpy as np

from drivers import nmea, rtcm3
from drivers.frames import Batch, Wire
from drivers.mavlink import wire as mavlink
from drivers.mavlink.dialect import Dialect, ardupilotmega
from drivers.ubx import wire as ubx
from drivers.window import NOTHING, Examination, Window

GNSS = (Wire.UBX, Wire.RTCM3, Wire.NMEA)


class StreamFramer:
    """Frames of any mixture of protocols on one stream of bytes; a `Framer`.

    At each place where one of the protocols could begin the frame is tested with its checksum; where there is
    none, the search goes on with the next byte. So damage costs the frame that it lies in and no other.

    Parameters
    ----------
    wires : iterable of Wire
        The protocols to look for.
    dialect : Dialect, optional
        The known MAVLink messages.
    """

    stamped = False

    def __init__(self, wires: Iterable[Wire], dialect: Dialect | None = None) -> None:
        wanted = tuple(wires)
        self._mavlink = mavlink.MavlinkGrammar(dialect or ardupilotmega()) if Wire.MAVLINK in wanted else None
        starts = {
            Wire.MAVLINK: mavlink.STARTS.pattern,
            Wire.UBX: ubx.STARTS.pattern,
            Wire.RTCM3: rtcm3.STARTS.pattern,
            Wire.NMEA: nmea.STARTS.pattern,
        }
        self._starts = pattern(b"|".join(starts[wire] for wire in wanted))
        firsts = {Wire.MAVLINK: b"\xfe\xfd", Wire.UBX: b"\xb5", Wire.RTCM3: b"\xd3", Wire.NMEA: b"$"}
        self._first = b"".join(firsts[wire] for wire in wanted)
        self._pending = b""
        self._offset = 0
        self._needed = 1
        self._cut = 0
        self._intact = False

    @property
    def cut(self) -> int:
        """Number of bytes of a frame that the end of the stream cut off; 0 until `close`."""
        return self._cut

    def feed(self, data: bytes) -> Batch:
        """Take the next bytes of the stream and return the frames that are complete."""
        self._pending += data
        # An incomplete frame is looked at again only when all that it asked for has come.
        return self._take(closed=False) if len(self._pending) >= self._needed else self._batch([], [], 0)

    def close(self) -> Batch:
        """Return what is left when the stream has ended."""
        if self._intact and self._pending and self._starts.match(self._pending):
            self._cut = len(self._pending)
        batch = self._take(closed=True)
        if len(batch) or self._pending:
            self._cut = 0
        return batch

    def _take(self, closed: bool) -> Batch:
        window = Window(self._pending, closed)
        data, end = window.data, len(window.data)
        frames: list[tuple[int, int, int, int, bool]] = []
        damage: list[tuple[int, int]] = []
        at = clean = 0  # everything before `clean` is in a frame or counted
        self._needed = 1
        while at < end:
            match = self._starts.search(data, at)
            if match is None:
                at = end
                break
            at = match.start()
            wire, (length, kind, known) = self._examine(window, at)
            if length > 0:
                if at > clean:
                    damage.append((self._offset + clean, at - clean))
                frames.append((at, length, wire, kind, known))
                at += length
                clean = at
            elif length < 0:
                self._needed = -length
                break
            else:
                at += 1
        if at > clean:
            damage.append((self._offset + clean, at - clean))
        self._intact = at == clean
        return self._batch(frames, damage, at)

    def _examine(self, window: Window, at: int) -> tuple[Wire, Examination]:
        first = window.data[at]
        if first == 0xB5:
            return Wire.UBX, ubx.examine(window, at)
        if first == 0xD3:
            return Wire.RTCM3, rtcm3.examine(window, at)
        if first == 0x24:
            return Wire.NMEA, nmea.examine(window, at)
        grammar = self._mavlink
        if grammar is None:
            return Wire.MAVLINK, NOTHING

        def ends(index: int) -> bool | None:
            if index < len(window.data):
                return window.data[index] in self._first
            return True if window.closed else None

        return Wire.MAVLINK, grammar.examine(window, at, ends)

    def _batch(
        self, frames: list[tuple[int, int, int, int, bool]], damage: list[tuple[int, int]], consumed: int
    ) -> Batch:
        columns = np.array(frames, np.int64).reshape(-1, 5)
        data, base = self._pending[:consumed], self._offset
        self._pending = self._pending[consumed:]
        self._offset += consumed
        return Batch(
            data=data,
            base=base,
            start=columns[:, 0],
            length=columns[:, 1],
            wire=columns[:, 2].astype(np.uint8),
            kind=columns[:, 3],
            known=columns[:, 4].astype(bool),
            damage=np.array(damage, np.int64).reshape(-1, 2),
        )

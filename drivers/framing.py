"""Framing of a stream on which several protocols may be mixed, with resynchronisation after damage."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from drivers import scan
from drivers.frames import Batch, Wire
from drivers.mavlink.dialect import V1, V2, Dialect, ardupilotmega

GNSS = (Wire.UBX, Wire.RTCM3, Wire.NMEA)

_FIRST = {Wire.MAVLINK: (V1, V2), Wire.UBX: (0xB5,), Wire.RTCM3: (0xD3,), Wire.NMEA: (0x24,)}
# From here on it pays to load what was compiled.
_LARGE = 2048


def wires_of(protocol: str) -> tuple[Wire, ...]:
    """Return the protocols that are looked for on a link of one: those of receivers may share a line."""
    return (Wire.MAVLINK,) if protocol == Wire.MAVLINK.encoding else GNSS


class StreamFramer:
    """Frames of any mixture of protocols on one stream of bytes; a `Framer`.

    At each place where one of the protocols could begin the frame is tested with its checksum; where there is
    none, the search goes on with the next byte. So damage costs the frame that it lies in and no other.
    """

    stamped = False

    def __init__(self, wires: Iterable[Wire], dialect: Dialect | None = None) -> None:
        self._tables = scan.tables_of(dialect or ardupilotmega())
        self._starts = np.full(256, scan.NO_WIRE, np.int32)
        for wire in wires:
            self._starts[list(_FIRST[wire])] = wire
        self._memory = scan.new_memory()
        self._pending = b""
        self._offset = 0
        self._needed = 1
        self._cut = 0
        self._intact = False

    @property
    def cut(self) -> int:
        """Number of bytes of a frame that the end of the stream cut off; 0 until `close`."""
        return self._cut

    @property
    def pending(self) -> bytes:
        """The last bytes of the stream, which may be the beginning of a frame."""
        return self._pending

    def feed(self, data: bytes) -> Batch:
        """Take the next bytes of the stream and return the frames that are complete."""
        self._pending += data
        # An incomplete frame is looked at again only when all that it asked for has come.
        return self._take(closed=False) if len(self._pending) >= self._needed else self._batch()

    def close(self) -> Batch:
        """Return what is left when the stream has ended."""
        rest = len(self._pending) if self._intact else 0
        batch = self._take(closed=True)
        self._cut = 0 if len(batch) else rest
        return batch

    def _take(self, closed: bool) -> Batch:
        if len(self._pending) >= _LARGE:
            scan.compile_search()
        octets = np.frombuffer(self._pending, np.uint8).astype(np.int32)
        frames, damage, rest, self._needed = scan.search_stream(
            octets, closed, self._starts, self._memory, self._tables
        )
        ended = int(frames[-1, :2].sum()) if len(frames) else 0
        self._intact = rest == ended
        damage[:, 0] += self._offset
        return self._batch(frames, damage, rest)

    def _batch(
        self,
        frames: scan.Rows = np.empty((0, 5), np.int64),  # noqa: B008
        damage: scan.Rows = np.empty((0, 2), np.int64),  # noqa: B008
        consumed: int = 0,
    ) -> Batch:
        data, base = self._pending[:consumed], self._offset
        self._pending = self._pending[consumed:]
        self._offset += consumed
        return Batch(
            data=data,
            base=base,
            start=frames[:, 0],
            length=frames[:, 1],
            wire=frames[:, 2].astype(np.uint8),
            kind=frames[:, 3],
            known=frames[:, 4].astype(bool),
            damage=damage,
        )

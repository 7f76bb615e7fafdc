"""Frames: the pieces that a device's byte stream consists of, one by one and many at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Bytes, Flags, Integers


class Wire(IntEnum):
    """The protocols of streams, and the formats of logs whose records are kept as they are."""

    MAVLINK = 0
    UBX = 1
    RTCM3 = 2
    NMEA = 3
    DATAFLASH = 4
    ULOG = 5
    MRK = 6

    @property
    def encoding(self) -> str:
        """The message encoding under which the flight log keeps frames of this protocol."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class Frame:
    """One intact frame.

    wire: its protocol.
    kind: what it carries: the MAVLink message id; UBX class * 256 + id; the RTCM3 message number; the letters
        of the NMEA sentence formatter as a big-endian number.
    data: the complete frame, from its first start byte to its checksum (or signature).
    offset: where it began in the stream, bytes.
    known: false when its checksum could only be tested for consistency, since the message is not in the
        tables.
    """

    wire: Wire
    kind: int
    data: bytes
    offset: int
    known: bool = True


@dataclass(frozen=True, slots=True)
class Batch:
    """Consecutive frames of a stream and the damage between them, as a structure of arrays.

    data: the bytes that the frames lie in.
    base: offset of ``data[0]`` in the stream, bytes.
    start, length (n,): where each frame lies in `data`, bytes.
    wire: protocol of each frame, see `Wire`.
    kind (n,): kind of each frame, see `Frame`.
    known: whether the message is in the tables.
    damage (m, 2): offset in the stream and length of each run of bytes that belongs to no frame. A run may be
        continued in the next batch.
    host_ns (n,): time of receipt that the stream itself carries (UTC, nanoseconds since 1970), where it does.
    """

    data: bytes
    base: int
    start: Integers
    length: Integers
    wire: Bytes
    kind: Integers
    known: Flags
    damage: Integers
    host_ns: Integers | None = None

    def __len__(self) -> int:
        return len(self.start)

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(i) for i in range(len(self)))

    def frame(self, index: int) -> Frame:
        """Return one frame of the batch."""
        start = int(self.start[index])
        return Frame(
            Wire(int(self.wire[index])),
            int(self.kind[index]),
            self.data[start : start + int(self.length[index])],
            self.base + start,
            bool(self.known[index]),
        )

    def damaged(self) -> Iterator[tuple[int, bytes]]:
        """Yield the offset in the stream and the bytes of each run of damage."""
        for offset, length in self.damage.tolist():
            yield offset, self.data[offset - self.base : offset - self.base + length]

    def where(self, wire: Wire, kind: int) -> Integers:
        """Return the indices of the known frames of one kind."""
        return np.flatnonzero((self.kind == kind) & (self.wire == wire) & self.known)


class Framer(Protocol):
    """Turns the bytes of a stream into frames; nothing is lost and nothing is invented.

    Every byte that was fed comes out exactly once: in a frame, as a time stamp of a recording format, or as
    damage. The frames do not depend on how the stream was cut into pieces.
    """

    @property
    def stamped(self) -> bool:
        """Whether the stream carries the time of receipt of each frame."""
        ...

    @property
    def cut(self) -> int:
        """Number of bytes of a frame that the end of the stream cut off; 0 until `close`."""
        ...

    def feed(self, data: bytes) -> Batch:
        """Take the next bytes of the stream and return the frames that are complete."""
        ...

    def close(self) -> Batch:
        """Return what is left when the stream has ended."""
        ...


def gather(data: bytes, start: Integers, length: Integers, row: np.dtype[Any]) -> NDArray[Any]:
    """Copy pieces of a buffer into the rows of a structured array; what a piece lacks is zero."""
    width = row.itemsize
    if not len(start):
        return np.empty(0, row)
    if int(start.max()) + width > len(data):
        data = data + bytes(width)
    # A view with one item beginning at every byte: taking items then copies whole rows at once.
    items = np.ndarray((len(data) - width + 1,), np.dtype((np.void, width)), data, strides=(1,))
    rows = items[start]
    if int(length.min()) < width:
        flat = rows.view(np.uint8).reshape(len(rows), width)
        flat[np.arange(width) >= length[:, None]] = 0
    return rows.view(row)

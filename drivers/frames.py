"""Frames: the pieces that a device's byte stream consists of, one by one and many at once."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers import scan
from drivers.mavlink.dialect import Dialect, ardupilotmega
from photocal.base.arrays import Bytes, Flags, Integers
from photocal.base.errors import ConfigurationError


@dataclass(frozen=True)
class Framing:
    """How the frames of a protocol are found where the compiled search does not know them.

    start: bytes that every frame begins with.
    longest: length of a frame, bytes; a damaged length must not hold back more of a stream.
    length: takes the bytes from a start on and returns the length of the frame that its head claims; 0 where
        no frame begins; negative: so many bytes are needed to tell.
    intact: whether the checksum of a whole frame agrees.
    kind: what a whole frame carries.
    """

    start: bytes
    longest: int
    length: Callable[[bytes], int]
    intact: Callable[[bytes], bool]
    kind: Callable[[bytes], int]

    def look(self, data: bytes, at: int) -> int:
        """Return the length of the intact frame at a place, 0 without one, or less: see `length`."""
        rest = data[at : at + self.longest]
        if not self.start.startswith(rest[: len(self.start)]):
            return 0
        length = self.length(rest) if rest.startswith(self.start) else -len(self.start)
        if length < 0:
            return length if -length > len(rest) and -length <= self.longest else 0
        if length > len(rest):
            return -length if length <= self.longest else 0
        return length if length and self.intact(rest[:length]) else 0


class Wire(int):
    """A protocol of streams, or the format of logs whose records are kept as they are.

    It is the number under which its frames stand in a batch; ``Wire(number)`` gives it back.

    encoding: the message encoding under which the flight log keeps its frames.
    starts: bytes that a frame on a stream may begin with.
    framing: how its frames are found; None: by the compiled search, or by the framer of the log.
    """

    MAVLINK: ClassVar["Wire"]
    UBX: ClassVar["Wire"]
    RTCM3: ClassVar["Wire"]
    NMEA: ClassVar["Wire"]
    DATAFLASH: ClassVar["Wire"]
    ULOG: ClassVar["Wire"]
    MRK: ClassVar["Wire"]
    encoding: str
    starts: bytes
    framing: Framing | None

    def __new__(cls, number: int) -> "Wire":  # noqa: PYI034
        """Return the protocol that has a number."""
        return _WIRES[number]

    @property
    def name(self) -> str:
        """What it is called in this class."""
        return self.encoding.upper()

    def __repr__(self) -> str:
        return f"Wire.{self.name}"

    @staticmethod
    def known(encoding: str) -> "Wire | None":
        """Return the protocol of a name that has a number already."""
        return next((wire for wire in _WIRES if wire.encoding == encoding), None)

    @classmethod
    def named(cls, encoding: str, starts: bytes = b"", framing: Framing | None = None) -> "Wire":
        """Return the protocol of a name; one that is new gets the next number."""
        known = cls.known(encoding)
        if known is not None:
            if framing is not None and known.framing is None:
                raise ConfigurationError(
                    f"the name {encoding} of a protocol is taken", "give the protocol a name of its own"
                )
            return known
        wire = super().__new__(cls, len(_WIRES))
        wire.encoding, wire.framing = encoding, framing
        wire.starts = starts if framing is None else framing.start[:1]
        _WIRES.append(wire)
        return wire


_WIRES: list[Wire] = []
# In the order of their numbers in the compiled search.
Wire.MAVLINK, Wire.UBX, Wire.RTCM3, Wire.NMEA = (
    Wire.named(name, starts) for name, starts in scan.STREAMS.items()
)
Wire.DATAFLASH, Wire.ULOG, Wire.MRK = map(Wire.named, ("dataflash", "ulog", "mrk"))
# Those of receivers that the compiled search knows; `drivers.protocols.receiver_wires` has all.
GNSS = (Wire.UBX, Wire.RTCM3, Wire.NMEA)


@dataclass(frozen=True, slots=True)
class Frame:
    """One intact frame.

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


def batch_of(
    wire: Integers | Wire,
    data: bytes,
    base: int,
    columns: tuple[Integers, Integers, Integers],
    damage: Integers,
    known: Any = True,
    host_ns: Integers | None = None,
) -> Batch:
    """Return frames as a batch; `columns`: start, length and kind of each."""
    start, length, kind = columns
    wires = np.broadcast_to(wire, len(start)).astype(np.uint8)
    knowns = np.broadcast_to(known, len(start)).astype(bool)
    return Batch(data, base, start, length, wires, kind, knowns, damage, host_ns)


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one kind.

    index (n,): position of each message in the batch.
    fields (n,): the fields by the names and in the units of the protocol's definition.
    """

    index: Integers
    fields: NDArray[Any]

    def __len__(self) -> int:
        return len(self.index)


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


def numbers_at(data: bytes, start: Integers, kind: str) -> NDArray[Any]:
    """Return the numbers of a kind that begin at places of a buffer."""
    row = np.dtype(kind)
    return gather(data, start, np.full(len(start), row.itemsize), row)


class Framer(ABC):
    """Turns the bytes of a stream into frames; nothing is lost and nothing is invented.

    Every byte that was fed comes out exactly once: in a frame, as a time stamp of a recording format, or as
    damage. The frames do not depend on how the stream was cut into pieces.

    stamped: whether the stream carries the time of receipt of each frame.
    cut: number of bytes of a frame that the end of the stream cut off; 0 until `close`.
    """

    stamped = False

    def __init__(self) -> None:
        self.cut = 0
        self._pending = b""
        self._offset = 0

    def feed(self, data: bytes) -> Batch:
        """Take the next bytes of the stream and return the frames that are complete."""
        self._pending += data
        return self._take(closed=False)

    def close(self) -> Batch:
        """Return what is left when the stream has ended."""
        rest = len(self._pending) if self._begun() else 0
        batch = self._take(closed=True)
        self.cut = 0 if len(batch) else rest
        return batch

    @abstractmethod
    def _begun(self) -> bool:
        """Tell whether what waits can be the beginning of a frame."""

    @abstractmethod
    def _take(self, closed: bool) -> Batch:
        """Return the frames that are complete."""

    def _consumed(self, count: int) -> tuple[bytes, int]:
        """Take so many bytes off what waits; also return where they stood in the stream."""
        data, base = self._pending[:count], self._offset
        self._pending = self._pending[count:]
        self._offset += count
        return data, base


class StreamFramer(Framer):
    """Frames of any mixture of protocols on one stream of bytes.

    At each place where one of the protocols could begin the frame is tested with its checksum; where there is
    none, the search goes on with the next byte. So damage costs the frame that it lies in and no other.
    """

    def __init__(self, wires: Iterable[Wire], dialect: Dialect | None = None) -> None:
        super().__init__()
        self._tables = scan.tables_of(dialect or ardupilotmega())
        self._starts = np.full(256, scan.NO_WIRE, np.int32)
        # Where two begin alike the compiled search looks first.
        ordered = sorted(wires)
        for wire in reversed(ordered):
            self._starts[list(wire.starts)] = wire
        self._framed = [(wire, wire.framing) for wire in ordered if wire.framing is not None]
        self._memory = scan.new_memory()
        self._needed = 1
        self._intact = False

    @property
    def pending(self) -> bytes:
        """The last bytes of the stream, which may be the beginning of a frame."""
        return self._pending

    def feed(self, data: bytes) -> Batch:
        """Take the next bytes of the stream and return the frames that are complete."""
        self._pending += data
        # An incomplete frame is examined again only when all that it needs has come.
        return self._take(closed=False) if len(self._pending) >= self._needed else self._batch()

    def _begun(self) -> bool:
        return self._intact

    def _take(self, closed: bool) -> Batch:
        # From here on it pays to load what was compiled.
        large = 2048
        if len(self._pending) >= large:
            scan.compile_search()
        octets = np.frombuffer(self._pending, np.uint8).astype(np.int32)
        frames, damage, rest, self._needed = scan.search_stream(
            octets, closed, self._starts, self._looked(closed), self._memory, self._tables
        )
        ended = int(frames[-1, :2].sum()) if len(frames) else 0
        self._intact = rest == ended
        damage[:, 0] += self._offset
        return self._batch(frames, damage, rest)

    def _looked(self, closed: bool) -> scan.Rows:
        """Return the frames of protocols that the compiled search does not know, rows as it takes them."""
        rows: dict[int, tuple[int, int, int, int]] = {}
        for wire, framing in self._framed:
            at = self._pending.find(framing.start[:1])
            while at >= 0:
                length = framing.look(self._pending, at)
                if length > 0 or (length < 0 and not closed):
                    kind = framing.kind(self._pending[at : at + length]) if length > 0 else 0
                    rows.setdefault(at, (at, length, wire, kind))
                at = self._pending.find(framing.start[:1], at + 1)
        return np.array(sorted(rows.values()), np.int64).reshape(-1, 4)

    def _batch(
        self,
        frames: scan.Rows = np.empty((0, 5), np.int64),  # noqa: B008
        damage: scan.Rows = np.empty((0, 2), np.int64),  # noqa: B008
        consumed: int = 0,
    ) -> Batch:
        start, length, wire, kind, known = frames.T
        return batch_of(wire, *self._consumed(consumed), (start, length, kind), damage, known)

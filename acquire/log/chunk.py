"""Messages in memory on their way into a flight log: an open chunk, and one that is sealed.

Records of MCAP files (specification: mcap.dev, version 0) by its published package; messages as arrays.

The package makes one message at a time. Ours are only the records of messages and their indexes, many at
once: a recording has tens of thousands of them a second.
"""

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import McapRecord
from numpy.typing import NDArray

from photocal.base.arrays import Bytes, Integers

MAGIC = b"\x89MCAP0\r\n"

# What stands before the payload of a message, as a packed row.
MESSAGE_ROW = np.dtype(
    [
        ("opcode", "u1"),
        ("size", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_ns", "<u8"),
        ("publish_ns", "<u8"),
    ]
)
INDEX_ROW = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])

# Encoding of the bytes of a link that belong to no frame.
DAMAGE_ENCODING = "octets"
# Encoding of bytes that were written before they were framed: `ARRIVED_HEAD`, then the bytes.
ARRIVED_ENCODING = "arrived"
# Where in the stream of the link they begin, and up to where it was framed when they were written.
ARRIVED_HEAD = struct.Struct("<QQ")
# Table that says of which recording a file is a part: the name of its first file (`first_file`), and the
# number of this one (`file`).
PART_OF = "part of"
# What a recorder keeps in memory of what the disk has not confirmed of a file: no more is written again.
MOST_UNSAFE = 64 << 20


@dataclass(frozen=True)
class Schema:
    """How the payload of a channel is to be read: name, encoding and definition."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Channel:
    """A channel of the log.

    topic: its topic; several channels may share one.
    schema: none for raw frames.
    metadata: what is true of every message of the channel, such as the kind of its heights.
    """

    topic: str
    encoding: str
    schema: Schema | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __hash__(self) -> int:
        return hash((self.topic, self.encoding, tuple(sorted(self.metadata.items()))))


@dataclass(frozen=True)
class Pieces:
    """Payloads of messages as they lie in one buffer.

    start, length (n,): where each payload lies, bytes.
    """

    data: bytes
    start: Integers
    length: Integers

    def __len__(self) -> int:
        return len(self.start)


# What a message holds: bytes, or their place in a buffer.
Payloads = Sequence[bytes | memoryview] | Pieces


def encoded(record: McapRecord) -> bytes:
    """Return a record as bytes."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def message_records(head: NDArray[np.void], payloads: Payloads) -> bytes | memoryview:
    """Return the records of messages."""
    width = head.itemsize
    if not isinstance(payloads, Pieces):
        heads = head.tobytes()
        parts: list[bytes | memoryview] = [b""] * (2 * len(payloads))
        parts[0::2] = [heads[at : at + width] for at in range(0, len(heads), width)]
        parts[1::2] = payloads
        return b"".join(parts)
    end = np.cumsum(payloads.length + width)
    begin = end - payloads.length
    made = np.empty(int(end[-1]), np.uint8)
    _items(made, width)[begin - width] = head.view(f"V{width}")
    # Those of one length at once: no message becomes an object of its own.
    source = np.frombuffer(payloads.data, np.uint8)
    for length in np.flatnonzero(np.bincount(payloads.length)).tolist():
        rows = np.flatnonzero(payloads.length == length)
        if length:
            _items(made, length)[begin[rows]] = _items(source, length)[payloads.start[rows]]
    return made.data


def _items(octets: Bytes, width: int) -> NDArray[np.void]:
    """Return a view with an item of some bytes beginning at every byte."""
    return np.ndarray((len(octets) - width + 1,), f"V{width}", octets, strides=(1,))


def index_record(channel: int, rows: NDArray[np.void]) -> bytes:
    """Return the index of the messages of one channel in a chunk, rows as in `INDEX_ROW`."""
    head = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + rows.nbytes, channel, rows.nbytes)
    return head + rows.tobytes()


COMPRESSION = "lz4"


@dataclass(frozen=True)
class SealedChunk:
    """A chunk as it stands in a file, whichever that is.

    record, indexes: the record of the chunk and those of its messages by the number of their channel.
    definitions: schemas and channels that are new in it.
    counts: number of messages of each channel.
    begin_ns, end_ns: first and last time of receipt, UTC, nanoseconds since 1970.
    packed, unpacked: size of its content, bytes.
    """

    record: bytes
    indexes: Mapping[int, bytes]
    definitions: tuple[bytes, ...]
    counts: Mapping[int, int]
    begin_ns: int
    end_ns: int
    packed: int
    unpacked: int

    @property
    def size(self) -> int:
        """What it takes in a file, bytes."""
        return len(self.record) + sum(map(len, self.indexes.values()))


def sealed(
    pieces: list[bytes | memoryview],
    definitions: tuple[bytes, ...],
    index: Mapping[int, list[NDArray[np.void]]],
) -> SealedChunk:
    """Pack what belongs into a chunk; index: rows as in `INDEX_ROW` of each channel."""
    import lz4.frame

    content = b"".join(pieces)
    packed = lz4.frame.compress(content)
    rows = {number: np.concatenate(parts) for number, parts in sorted(index.items())}
    begin = min((int(r["log_ns"].min()) for r in rows.values()), default=0)
    end = max((int(r["log_ns"].max()) for r in rows.values()), default=0)
    chunk = mcap.Chunk(COMPRESSION, packed, end, begin, zlib.crc32(content), len(content))
    return SealedChunk(
        encoded(chunk),
        {number: index_record(number, row) for number, row in rows.items()},
        definitions,
        {number: len(row) for number, row in rows.items()},
        begin,
        end,
        len(packed),
        len(content),
    )


class OpenChunk:
    """Collects messages until they are sealed; channels keep their numbers from chunk to chunk.

    A chunk carries the schemas and channels that are new in it. `definitions` are all so far.
    """

    def __init__(self) -> None:
        self.definitions: list[bytes] = []
        self._schemas: dict[Schema, int] = {}
        self._channels: dict[Channel, int] = {}
        self._sealed = 0
        self._clear()

    def _clear(self) -> None:
        self._pieces: list[bytes | memoryview] = []
        self._index: defaultdict[int, list[NDArray[np.void]]] = defaultdict(list)
        self.size = 0
        self._sealed = len(self.definitions)

    def channel(self, channel: Channel) -> int:
        """Return the number of a channel; a new one is defined here."""
        number = self._channels.get(channel)
        if number is None:
            number = self._channels[channel] = len(self._channels)
            schema = 0
            if channel.schema is not None:
                schema = self._schemas.get(channel.schema, 0)
                if not schema:
                    schema = self._schemas[channel.schema] = len(self._schemas) + 1
                    kept = channel.schema
                    self._define(encoded(mcap.Schema(schema, kept.data, kept.encoding, kept.name)))
            metadata = dict(channel.metadata)
            self._define(encoded(mcap.Channel(number, channel.topic, channel.encoding, metadata, schema)))
        return number

    def messages(
        self, channel: Channel, payloads: Payloads, log_ns: Integers, publish_ns: Integers, sequence: Integers
    ) -> None:
        """Add messages of one channel.

        log_ns, publish_ns (n,): time of receipt and time of the device, UTC, nanoseconds since 1970.
        """
        if not len(payloads):
            return
        number = self.channel(channel)
        if isinstance(payloads, Pieces):
            size = payloads.length
        else:
            size = np.fromiter(map(len, payloads), np.int64, len(payloads))
        head = np.empty(len(payloads), MESSAGE_ROW)
        head["opcode"] = Opcode.MESSAGE
        head["size"] = size + (MESSAGE_ROW.itemsize - 9)
        head["channel"] = number
        head["sequence"] = sequence & 0xFFFFFFFF
        head["log_ns"] = log_ns
        head["publish_ns"] = publish_ns
        end = np.cumsum(size + MESSAGE_ROW.itemsize)
        index = np.empty(len(payloads), INDEX_ROW)
        index["log_ns"] = log_ns
        index["offset"] = self.size
        index["offset"][1:] += end[:-1].astype(np.uint64)
        self._pieces.append(message_records(head, payloads))
        self.size += int(end[-1])
        self._index[number].append(index)

    def seal(self) -> SealedChunk | None:
        """Return what was collected and begin the next chunk; None when it is empty."""
        if not self._pieces:
            return None
        chunk = sealed(self._pieces, tuple(self.definitions[self._sealed :]), self._index)
        self._clear()
        return chunk

    def _define(self, record: bytes) -> None:
        self.definitions.append(record)
        self._pieces.append(record)
        self.size += len(record)

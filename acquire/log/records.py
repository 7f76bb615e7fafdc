"""Records of MCAP files (specification: mcap.dev, version 0) by its published package; messages as arrays.

The package makes one message at a time. Ours are only the records of messages and their indexes, many at
once: a recording has tens of thousands of them a second.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
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

"""Records of MCAP files as bytes (specification: mcap.dev, version 0)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

FOOTER_BYTES = 9 + 20
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


@dataclass(frozen=True)
class Schema:
    """How the payload of a channel is to be read: name, encoding and definition."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Channel:
    """A channel of the log.

    Parameters
    ----------
    topic : str
        Its topic; several channels may share one.
    encoding : str
        Message encoding.
    schema : Schema or None
        None for raw frames.
    metadata : mapping of str to str
        What is true of every message of the channel, such as the kind of its heights.
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

    Parameters
    ----------
    data : bytes
        The buffer.
    start, length : int64 (n,)
        Where each payload lies, bytes.
    """

    data: bytes
    start: NDArray[np.int64]
    length: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)


# What a message holds: bytes, or their place in a buffer.
Payloads = Sequence[bytes | memoryview] | Pieces


def text(value: str) -> bytes:
    """Return a string after its length in bytes."""
    encoded = value.encode()
    return struct.pack("<I", len(encoded)) + encoded


def table(values: Mapping[str, str]) -> bytes:
    """Return a map of strings after its length in bytes."""
    body = b"".join(text(key) + text(value) for key, value in values.items())
    return struct.pack("<I", len(body)) + body


def record(opcode: int, body: bytes) -> bytes:
    """Return a record."""
    return struct.pack("<BQ", opcode, len(body)) + body


def schema_record(number: int, schema: Schema) -> bytes:
    """Return the record of a schema."""
    body = text(schema.name) + text(schema.encoding) + struct.pack("<I", len(schema.data)) + schema.data
    return record(SCHEMA, struct.pack("<H", number) + body)


def channel_record(number: int, schema: int, channel: Channel) -> bytes:
    """Return the record of a channel."""
    body = text(channel.topic) + text(channel.encoding) + table(channel.metadata)
    return record(CHANNEL, struct.pack("<HH", number, schema) + body)


def attachment_record(name: str, media_type: str, data: bytes, log_ns: int, create_ns: int) -> bytes:
    """Return the record of an attached file."""
    body = struct.pack("<QQ", log_ns, create_ns) + text(name) + text(media_type)
    body += struct.pack("<Q", len(data)) + data
    return record(ATTACHMENT, body + struct.pack("<I", zlib.crc32(body)))


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


def _items(octets: NDArray[np.uint8], width: int) -> NDArray[np.void]:
    """Return a view with an item of some bytes beginning at every byte."""
    return np.ndarray((len(octets) - width + 1,), f"V{width}", octets, strides=(1,))


def index_record(channel: int, rows: NDArray[np.void]) -> bytes:
    """Return the index of the messages of one channel in a chunk, rows as in `INDEX_ROW`."""
    return record(MESSAGE_INDEX, struct.pack("<HI", channel, rows.nbytes) + rows.tobytes())


def footer(summary: bytes, summary_start: int, offsets_start: int) -> bytes:
    """Return the footer and the closing magic; its checksum covers the summary and its own first fields."""
    head = struct.pack("<BQQQ", FOOTER, 20, summary_start, offsets_start)
    return head + struct.pack("<I", zlib.crc32(head, zlib.crc32(summary))) + MAGIC

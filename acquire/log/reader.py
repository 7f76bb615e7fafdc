"""Reading flight logs in the order of the file, also such that end early.

A flight log as arrays: one for each field of each topic.
"""

import io
import json
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap import records as mcap
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from numpy.typing import NDArray

from acquire.log.chunk import MAGIC, MESSAGE_ROW, MOST_UNSAFE, PART_OF, Channel, Schema
from photocal.base.arrays import Flags, Integers
from photocal.base.console import printable
from photocal.base.errors import InputMalformedError, InputNotFoundError, reading

# What is unpacked or read at once; chunks of our own and of other programs have one to some megabytes.
LONGEST_CHUNK, LONGEST_RECORD = 64 << 20, 256 << 20
# How a record that is damaged shows.
_UNREADABLE = (struct.error, EndOfFile, LookupError, ValueError, OverflowError)


@dataclass(frozen=True)
class LoggedMessages:
    """Messages of one channel in one chunk, in the order of the file.

    payloads (n,): the messages.
    log_ns, publish_ns (n,): time of receipt and of the device, UTC, nanoseconds since 1970.
    sequence (n,): their numbers.
    """

    channel: Channel
    payloads: list[bytes]
    log_ns: Integers
    publish_ns: Integers
    sequence: Integers

    def rows(self, chosen: Flags) -> "LoggedMessages":
        """Return some of the messages."""
        payloads = [payload for payload, keep in zip(self.payloads, chosen.tolist(), strict=True) if keep]
        columns = self.log_ns[chosen], self.publish_ns[chosen], self.sequence[chosen]
        return LoggedMessages(self.channel, payloads, *columns)


@dataclass
class LogReader:
    """Reads one flight log; tables and definitions fill while `chunks` is iterated.

    A log that is still being written is read by iterating again: it goes on where it ended before.

    metadata: tables by name.
    attachments: attached files by name.
    complete: whether the file ended with its footer.
    position: where in the file the next record begins.
    wanted: tells of which channels messages are given; otherwise of all.
    """

    path: Path
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, mcap.Attachment] = field(default_factory=dict)
    complete: bool = False
    position: int = 0
    wanted: Callable[[Channel], bool] | None = None
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, Channel] = field(default_factory=dict)

    def chunks(
        self, damaged: Callable[[InputMalformedError], None] | None = None
    ) -> Iterator[list[LoggedMessages]]:
        """Yield the messages of each whole chunk, channel by channel.

        A log without its end may end in what a power cut has torn: it is read up to there.

        raises InputNotFoundError: when the file is missing, empty or a folder.
        raises InputMalformedError: when it is no MCAP file or a chunk in it is damaged.
        """
        torn: InputMalformedError | None = None
        whole = False
        for opcode, body in self._records():
            try:
                messages = self._take(opcode, body)
            except (InputMalformedError, *_UNREADABLE) as damage:
                torn = torn or self._refusal(damage)
                if damaged is not None:
                    damaged(self._refusal(damage))
                continue
            if torn is not None and damaged is None and (messages is not None or self.complete):
                raise torn
            if messages is not None:
                whole = True
                yield messages
        if torn is not None and damaged is None and not whole:
            raise torn

    def _refusal(self, damage: Exception) -> InputMalformedError:
        if isinstance(damage, InputMalformedError):
            return damage
        reason = printable(str(damage)) or "it ends early"
        return InputMalformedError(
            f"a record cannot be read ({reason})", "run acquire recover", where=self.path
        )

    def _take(self, opcode: int, body: bytes) -> list[LoggedMessages] | None:
        stream = ReadDataStream(io.BytesIO(body))
        if opcode == Opcode.CHUNK:
            return self._chunk(mcap.Chunk.read(stream))
        if opcode == Opcode.METADATA:
            table = mcap.Metadata.read(stream)
            self.metadata[table.name] = table.metadata
        elif opcode == Opcode.ATTACHMENT:
            file = mcap.Attachment.read(stream)
            self.attachments[file.name] = file
        elif opcode == Opcode.FOOTER:
            self.complete = True
        return None

    def _records(self) -> Iterator[tuple[int, bytes]]:
        if self.path.is_dir():
            raise InputNotFoundError("is a folder, a flight log was expected", where=self.path)
        with reading(self.path):
            stream = self.path.open("rb")
        with stream:
            total = self.path.stat().st_size
            magic = stream.read(len(MAGIC))
            malformed = InputMalformedError.at(self.path)
            if magic != MAGIC:
                what = "is not a flight log (MCAP)" if magic else "is empty"
                raise malformed(what, "name an .mcap file, or import the recording first")
            stream.seek(max(self.position, len(magic)))
            while not self.complete and len(head := stream.read(9)) == 9:
                opcode, size = struct.unpack("<BQ", head)
                if size > total - stream.tell():
                    return
                if size > LONGEST_RECORD:
                    raise malformed(
                        f"holds a record of {size} bytes, more than {LONGEST_RECORD}",
                        "leave out attached files of that size",
                    )
                body = stream.read(size)
                self.position = stream.tell()
                yield opcode, body

    def _chunk(self, chunk: mcap.Chunk) -> list[LoggedMessages]:
        malformed = InputMalformedError.at(self.path)
        try:
            content = _unpacked(chunk)
        except (RuntimeError, ValueError, EOFError, MemoryError) as damage:
            raise malformed(f"a chunk cannot be unpacked ({damage})", "run acquire recover") from damage
        if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
            raise malformed("the checksum of a chunk is wrong", "run acquire recover")
        return self._messages(content)

    def _messages(self, content: bytes) -> list[LoggedMessages]:
        places: dict[int, list[int]] = {}
        sizes: dict[int, list[int]] = {}
        width = MESSAGE_ROW.itemsize
        at, end = 0, len(content)
        while at + 9 <= end:
            opcode, size = content[at], int.from_bytes(content[at + 1 : at + 9], "little")
            if opcode == Opcode.MESSAGE:
                number = content[at + 9] | content[at + 10] << 8
                places.setdefault(number, []).append(at)
                sizes.setdefault(number, []).append(size)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, content[at + 9 : at + 9 + size])
            at += 9 + size
        if at != end:
            raise ValueError("a message extends beyond the end of its chunk")
        messages = []
        for number, starts in places.items():
            if self.wanted is not None and not self.wanted(self._channels[number]):
                continue
            place = np.array(starts, np.int64)
            head = np.ndarray((end - width + 1,), MESSAGE_ROW, content, strides=(1,))[place]
            payloads = [content[a + width : a + 9 + s] for a, s in zip(starts, sizes[number], strict=True)]
            messages.append(
                LoggedMessages(
                    self._channels[number],
                    payloads,
                    head["log_ns"].astype(np.int64),
                    head["publish_ns"].astype(np.int64),
                    head["sequence"].astype(np.int64),
                )
            )
        return messages

    def _define(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(io.BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = mcap.Schema.read(stream)
            self._schemas[schema.id] = Schema(schema.name, schema.encoding, schema.data)
            return
        channel = mcap.Channel.read(stream)
        known = self._schemas.get(channel.schema_id)
        self._channels[channel.id] = Channel(channel.topic, channel.message_encoding, known, channel.metadata)


# Recording, topic and encoding; numbers of messages and their times of receipt.
_Stream = tuple[str, str, str]
_Heads = tuple[Integers, Integers]


class Repeats:
    """Leaves out what an earlier file of the same recording holds, too.

    What a disk has not confirmed is written again to the next file; where the disk was pulled, the first may
    have it all the same. It is the same message where its number and its time of receipt are.
    """

    def __init__(self) -> None:
        self._path: Path | None = None
        # The last messages of the file that is read: a recorder writes no others again.
        self._here: deque[tuple[int, dict[_Stream, _Heads]]] = deque()
        self._bytes = 0
        self._earlier: dict[_Stream, _Heads] = {}

    def without(self, reader: LogReader, chunk: list[LoggedMessages]) -> list[LoggedMessages]:
        """Return what is new in a chunk, the files of a recording one after the other."""
        recording = reader.metadata.get(PART_OF, {}).get("first_file")
        if recording is None:
            return chunk
        if reader.path != self._path:
            self._next_file(reader.path)
        size, heads, new = 0, dict[_Stream, _Heads](), list[LoggedMessages]()
        for part in chunk:
            stream = recording, part.channel.topic, part.channel.encoding
            size += sum(map(len, part.payloads))
            heads[stream] = part.sequence, part.log_ns
            known = self._known(stream, part)
            if not known.all():
                new.append(part.rows(~known) if known.any() else part)
        self._here.append((size, heads))
        self._bytes += size
        while self._bytes > MOST_UNSAFE:
            self._bytes -= self._here.popleft()[0]
        return new

    def _known(self, stream: _Stream, part: LoggedMessages) -> Flags:
        numbers, times = self._earlier.get(stream, (part.sequence[:0], part.log_ns[:0]))
        if not len(numbers):
            return np.zeros(len(part.payloads), bool)
        at = np.minimum(np.searchsorted(numbers, part.sequence), len(numbers) - 1)
        return np.asarray((numbers[at] == part.sequence) & (times[at] == part.log_ns))

    def _next_file(self, path: Path) -> None:
        for stream in {stream for _, heads in self._here for stream in heads}:
            parts = [heads[stream] for _, heads in self._here if stream in heads]
            every = [self._earlier[stream], *parts] if stream in self._earlier else parts
            numbers, times = (np.concatenate(columns) for columns in zip(*every, strict=True))
            order = np.argsort(numbers, kind="stable")
            self._earlier[stream] = numbers[order], times[order]
        self._path, self._bytes = path, 0
        self._here.clear()


def _unpacked(chunk: mcap.Chunk) -> bytes:
    """Return the content of a chunk: as much as it claims to be, which is bounded, and no more."""
    size = chunk.uncompressed_size
    if size > LONGEST_CHUNK:
        raise ValueError(f"its header states {size} bytes, more than {LONGEST_CHUNK}")
    if chunk.compression == "lz4":
        import lz4.frame

        content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "zstd":
        import zstandard

        unpacker = zstandard.ZstdDecompressor(max_window_size=LONGEST_CHUNK)
        with unpacker.stream_reader(chunk.data, read_across_frames=True) as stream:
            content = stream.read(size + 1)
    elif chunk.compression:
        raise ValueError(f"compression {printable(chunk.compression)!r}")
    else:
        content = chunk.data
    if len(content) != size:
        raise ValueError(
            f"its header states {size} bytes and has {'more' if len(content) > size else len(content)}"
        )
    return bytes(content)


def has_end(path: Path) -> bool:
    """Tell whether a log was closed: it ends as it began."""
    try:
        with path.open("rb") as stream:
            stream.seek(-len(MAGIC), io.SEEK_END)
            return stream.read() == MAGIC and stream.tell() > len(MAGIC)
    except OSError:
        return False


def link_of(channel: Channel) -> str:
    """Return the link that a channel belongs to: the first part of its topic."""
    return channel.topic.lstrip("/").partition("/")[0]


def read_json(payload: bytes, path: Path) -> dict[str, Any]:
    """Return the object of a message in JSON."""
    try:
        value = json.loads(payload)
    except (ValueError, RecursionError) as damage:
        raise InputMalformedError(
            f"a message is not JSON ({type(damage).__name__})", "run acquire recover", where=path
        ) from damage
    return value if isinstance(value, dict) else {}


Decode = Callable[[bytes], dict[str, Any]]


def arrays_of_log(
    path: Path, topics: frozenset[str], repeats: Repeats | None = None
) -> dict[str, dict[str, NDArray[Any]]]:
    """Read topics in one pass; without any all that are decoded.

    repeats: of the files before this one of a recording.
    """
    rows: dict[str, list[dict[str, Any]]] = {}
    decoders: dict[Channel, Decode] = {}
    reader, repeats = LogReader(path), repeats or Repeats()
    for chunk in reader.chunks():
        for messages in repeats.without(reader, chunk):
            channel = messages.channel
            if channel.topic not in topics if topics else channel.schema is None:
                continue
            decode = decoders.setdefault(channel, _decoder(channel))
            rows_of_topic = rows.setdefault(channel.topic, [])
            times = zip(messages.log_ns.tolist(), messages.publish_ns.tolist(), strict=True)
            for (log_ns, publish_ns), payload in zip(times, messages.payloads, strict=True):
                rows_of_topic.append({"log_ns": log_ns, "publish_ns": publish_ns, **decode(bytes(payload))})
    return {topic: _columns(rows_of_topic) for topic, rows_of_topic in sorted(rows.items())}


def _decoder(channel: Channel) -> Decode:
    if channel.schema is None:
        return lambda payload: {"payload": payload}
    if channel.encoding == "json":
        return lambda payload: _flat(json.loads(payload))
    return _protobuf(channel.schema)


def _protobuf(schema: Schema) -> Decode:
    from google.protobuf import descriptor_pool, json_format, message_factory
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))

    def decode(payload: bytes) -> dict[str, Any]:
        """Turn a message into a flat mapping of its fields."""
        message = kind.FromString(payload)
        return _flat(json_format.MessageToDict(message, preserving_proto_field_name=True))

    return decode


def _flat(content: dict[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{before}{key}.")
        else:
            flat[before + key] = value
    return flat


def _columns(rows: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Columns of messages; what a message leaves out is NaN, an empty text, or None among lists."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(values: list[Any]) -> NDArray[Any]:
    known = [value for value in values if value is not None]
    if all(isinstance(value, str) for value in known):
        return np.array(["" if value is None else value for value in values])
    if all(isinstance(value, int | float) for value in known):
        whole = len(known) == len(values) and all(isinstance(value, int) for value in known)
        return np.array(values if whole else [np.nan if value is None else float(value) for value in values])
    numbers = all(isinstance(v, list) and all(isinstance(x, int | float) for x in v) for v in values)
    if numbers and len({len(value) for value in values}) == 1:
        return np.array(values, dtype=float)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column

"""Writing flight logs: blocks of messages at once, so that the speed does not hang on single messages."""

import zlib
from collections import defaultdict
from collections.abc import Mapping
from io import RawIOBase
from typing import BinaryIO

import numpy as np
from mcap import records as mcap
from mcap.opcode import Opcode
from numpy.typing import NDArray

from acquire.log import records
from acquire.log.records import Channel, Payloads, Pieces, Schema, encoded
from photocal.base.arrays import Integers

LIBRARY = "photocal"
COMPRESSION = "lz4"


class LogWriter:
    """Writes one MCAP file; what `end_chunk` has returned from is complete in the file.

    Messages are collected in an open chunk. Each chunk carries the schemas and channels that were new in it
    and is followed by the indexes of its messages, so a file that ends after any chunk can be repaired from
    what is there.
    """

    def __init__(self, stream: BinaryIO | RawIOBase, library: str = LIBRARY) -> None:
        self._stream = stream
        self._library = library
        self._position = 0
        self._crc = 0
        self._schemas: dict[Schema, int] = {}
        self._channels: dict[Channel, int] = {}
        self._definitions: list[bytes] = []
        self._pieces: list[bytes | memoryview] = []
        self._size = 0
        self._index: defaultdict[int, list[NDArray[np.void]]] = defaultdict(list)
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._chunks: list[bytes] = []
        self._attachments: list[bytes] = []
        self._metadata: list[bytes] = []
        self._span: tuple[int, int] | None = None
        self._put(records.MAGIC)
        self._put(encoded(mcap.Header("", library)))

    def continued(self, stream: BinaryIO | RawIOBase) -> "LogWriter":
        """Return the writer of a next file, which takes over what is not in this one yet.

        The channels keep their numbers and are defined again, so each file stands for itself.
        """
        following = LogWriter(stream, self._library)
        following._schemas = dict(self._schemas)
        following._channels = dict(self._channels)
        # Those of the open chunk come with it.
        waiting = {id(piece) for piece in self._pieces}
        for definition in self._definitions:
            if id(definition) in waiting:
                following._definitions.append(definition)
            else:
                following._define(definition)
        shift = np.uint64(following._size)
        for number, parts in self._index.items():
            for part in parts:
                moved = part.copy()
                moved["offset"] += shift
                following._index[number].append(moved)
                following._counts[number] += len(moved)
        following._pieces.extend(self._pieces)
        following._size += self._size
        self._pieces.clear()
        self._index.clear()
        self._size = 0
        return following

    @property
    def open_bytes(self) -> int:
        """Size of the messages that are not in the file yet."""
        return self._size

    def channel(self, channel: Channel) -> int:
        """Return the number of a channel; a new one is written with the open chunk."""
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
        """Add messages of one channel to the open chunk.

        log_ns, publish_ns (n,): time of receipt and time of the device, UTC, nanoseconds since 1970.
        """
        if not len(payloads):
            return
        number = self.channel(channel)
        if isinstance(payloads, Pieces):
            size = payloads.length
        else:
            size = np.fromiter(map(len, payloads), np.int64, len(payloads))
        head = np.empty(len(payloads), records.MESSAGE_ROW)
        head["opcode"] = Opcode.MESSAGE
        head["size"] = size + (records.MESSAGE_ROW.itemsize - 9)
        head["channel"] = number
        head["sequence"] = sequence & 0xFFFFFFFF
        head["log_ns"] = log_ns
        head["publish_ns"] = publish_ns
        end = np.cumsum(size + records.MESSAGE_ROW.itemsize)
        index = np.empty(len(payloads), records.INDEX_ROW)
        index["log_ns"] = log_ns
        index["offset"] = self._size
        index["offset"][1:] += end[:-1].astype(np.uint64)
        self._pieces.append(records.message_records(head, payloads))
        self._size += int(end[-1])
        self._index[number].append(index)
        self._counts[number] += len(payloads)

    def end_chunk(self) -> None:
        """Write the open chunk; nothing happens when it is empty."""
        if not self._pieces:
            return
        import lz4.frame

        content = b"".join(self._pieces)
        packed = lz4.frame.compress(content)
        rows = {number: np.concatenate(parts) for number, parts in sorted(self._index.items())}
        begin = min((int(r["log_ns"].min()) for r in rows.values()), default=0)
        end = max((int(r["log_ns"].max()) for r in rows.values()), default=0)
        check = zlib.crc32(content)
        chunk = encoded(mcap.Chunk(COMPRESSION, packed, end, begin, check, len(content)))
        start = self._position
        offsets = {}
        after = start + len(chunk)
        indexes = []
        for number, row in rows.items():
            offsets[number] = after
            indexes.append(records.index_record(number, row))
            after += len(indexes[-1])
        # One write: a crash leaves either a whole chunk or a torn last one, never a hole.
        self._put(b"".join([chunk, *indexes]))
        self._chunks.append(
            encoded(
                mcap.ChunkIndex(
                    chunk_length=len(chunk),
                    chunk_start_offset=start,
                    compression=COMPRESSION,
                    compressed_size=len(packed),
                    message_end_time=end,
                    message_index_length=after - start - len(chunk),
                    message_index_offsets=offsets,
                    message_start_time=begin,
                    uncompressed_size=len(content),
                )
            )
        )
        if rows:
            self._span = (min(begin, self._span[0]), max(end, self._span[1])) if self._span else (begin, end)
        self._pieces.clear()
        self._index.clear()
        self._size = 0

    def attachment(self, name: str, media_type: str, data: bytes, log_ns: int, create_ns: int = 0) -> None:
        """Attach a file."""
        self.end_chunk()
        start = self._position
        record = encoded(mcap.Attachment(create_ns, log_ns, name, media_type, data))
        self._put(record)
        place = mcap.AttachmentIndex(start, len(record), log_ns, create_ns, len(data), name, media_type)
        self._attachments.append(encoded(place))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named table of texts."""
        self.end_chunk()
        start = self._position
        record = encoded(mcap.Metadata(name, dict(values)))
        self._put(record)
        self._metadata.append(encoded(mcap.MetadataIndex(start, len(record), name)))

    def close(self) -> None:
        """Write the last chunk, the summary and the footer; the stream stays open."""
        self.end_chunk()
        self._put(encoded(mcap.DataEnd(self._crc)))
        begin, end = self._span or (0, 0)
        statistics = mcap.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=end,
            message_start_time=begin,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups = {
            Opcode.SCHEMA: [d for d in self._definitions if d[0] == Opcode.SCHEMA],
            Opcode.CHANNEL: [d for d in self._definitions if d[0] == Opcode.CHANNEL],
            Opcode.STATISTICS: [encoded(statistics)],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: self._attachments,
            Opcode.METADATA_INDEX: self._metadata,
        }
        start = self._position
        summary = b""
        offsets = b""
        for opcode, group in groups.items():
            body = b"".join(group)
            if body:
                offsets += encoded(mcap.SummaryOffset(opcode, start + len(summary), len(body)))
                summary += body
        footer = encoded(mcap.Footer(start, start + len(summary), 0))[:-4]
        check = zlib.crc32(summary + offsets + footer)
        self._put(summary + offsets + footer + check.to_bytes(4, "little") + records.MAGIC)

    def _define(self, record: bytes) -> None:
        self._definitions.append(record)
        self._pieces.append(record)
        self._size += len(record)

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)

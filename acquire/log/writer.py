"""Writing flight logs: messages in blocks, so that the speed does not depend on single messages."""

import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from io import RawIOBase
from typing import BinaryIO

from mcap import records as mcap
from mcap.opcode import Opcode

from acquire.log.chunk import COMPRESSION, MAGIC, Channel, OpenChunk, Payloads, SealedChunk, encoded, sealed
from photocal.base.arrays import Integers


class LogWriter:
    """Writes one MCAP file; what `end_chunk` or `put` has returned from is complete in the file.

    Messages are collected in an open chunk, or come in chunks that are sealed. Each chunk carries the
    schemas and channels that were new in it and is followed by the indexes of its messages, so a file that
    ends after any chunk can be repaired from what is there.
    """

    def __init__(self, stream: BinaryIO | RawIOBase) -> None:
        self._stream = stream
        self._position = 0
        self._crc = 0
        self._open = OpenChunk()
        # A set that keeps its order: chunks may define again what others have defined.
        self._definitions: dict[bytes, None] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[bytes] = []
        self._attachments: list[bytes] = []
        self._metadata: list[bytes] = []
        self._span: tuple[int, int] | None = None
        self._put(MAGIC)
        self._put(encoded(mcap.Header("", "photocal")))

    @property
    def open_bytes(self) -> int:
        """Size of the messages that are not in the file yet."""
        return self._open.size

    def messages(
        self, channel: Channel, payloads: Payloads, log_ns: Integers, publish_ns: Integers, sequence: Integers
    ) -> None:
        """Add messages of one channel to the open chunk, see `OpenChunk.messages`."""
        self._open.messages(channel, payloads, log_ns, publish_ns, sequence)

    def end_chunk(self) -> None:
        """Write the open chunk; nothing happens when it is empty."""
        if (chunk := self._open.seal()) is not None:
            self.put(chunk)

    def define(self, definitions: Sequence[bytes]) -> None:
        """Write schemas and channels that chunks to come do not define again."""
        if definitions:
            self.put(sealed(list(definitions), tuple(definitions), {}))

    def put(self, chunk: SealedChunk) -> None:
        """Write a chunk."""
        start = self._position
        offsets = {}
        after = start + len(chunk.record)
        for number, index in chunk.indexes.items():
            offsets[number] = after
            after += len(index)
        # One write: a crash leaves either a whole chunk or a torn last one, never a hole.
        self._put(b"".join([chunk.record, *chunk.indexes.values()]))
        place = mcap.ChunkIndex(
            chunk_length=len(chunk.record),
            chunk_start_offset=start,
            compression=COMPRESSION,
            compressed_size=chunk.packed,
            message_end_time=chunk.end_ns,
            message_index_length=after - start - len(chunk.record),
            message_index_offsets=offsets,
            message_start_time=chunk.begin_ns,
            uncompressed_size=chunk.unpacked,
        )
        self._chunks.append(encoded(place))
        self._definitions.update(dict.fromkeys(chunk.definitions))
        self._counts.update(chunk.counts)
        if chunk.counts:
            begin, end = self._span or (chunk.begin_ns, chunk.end_ns)
            self._span = min(chunk.begin_ns, begin), max(chunk.end_ns, end)

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
        schemas = [d for d in self._definitions if d[0] == Opcode.SCHEMA]
        channels = [d for d in self._definitions if d[0] == Opcode.CHANNEL]
        statistics = mcap.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(channels),
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=end,
            message_start_time=begin,
            metadata_count=len(self._metadata),
            schema_count=len(schemas),
        )
        groups = {
            Opcode.SCHEMA: schemas,
            Opcode.CHANNEL: channels,
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
        self._put(summary + offsets + footer + check.to_bytes(4, "little") + MAGIC)

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)

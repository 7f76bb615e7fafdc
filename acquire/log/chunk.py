"""Messages in memory on their way into a flight log: an open chunk, and one that is sealed."""

import zlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from mcap import records as mcap
from mcap.opcode import Opcode
from numpy.typing import NDArray

from acquire.log import records
from acquire.log.records import Channel, Payloads, Pieces, Schema, encoded
from photocal.base.arrays import Integers

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
        {number: records.index_record(number, row) for number, row in rows.items()},
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
        index["offset"] = self.size
        index["offset"][1:] += end[:-1].astype(np.uint64)
        self._pieces.append(records.message_records(head, payloads))
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

"""Reading flight logs in the order of the file, also such that end early."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.log import records
from acquire.log.records import Channel, Schema
from drivers.errors import InputMalformedError, InputNotFoundError


@dataclass(frozen=True)
class Messages:
    """Messages of one channel in one chunk, in the order of the file.

    Parameters
    ----------
    channel : Channel
        The channel.
    payloads : list of bytes (n,)
        The messages.
    log_ns, publish_ns : int64 (n,)
        Time of receipt and of the device, UTC, nanoseconds since 1970.
    sequence : int64 (n,)
        Their numbers.
    """

    channel: Channel
    payloads: list[bytes]
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    sequence: NDArray[np.int64]


@dataclass(frozen=True)
class Attachment:
    """An attached file: its kind, content, and the times of its attaching and making (UTC ns)."""

    media_type: str
    data: bytes
    log_ns: int
    create_ns: int


@dataclass
class LogReader:
    """Reads one flight log; tables and definitions fill while `chunks` is iterated.

    A log that is still being written is read by iterating again: it goes on where it ended before.

    Parameters
    ----------
    path : Path
        The file.
    metadata : dict
        Tables by name.
    attachments : dict
        Attached files by name.
    complete : bool
        Whether the file ended with its footer.
    position : int
        Where in the file the next record begins.
    """

    path: Path
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    complete: bool = False
    position: int = 0
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, Channel] = field(default_factory=dict)

    def chunks(
        self, damaged: Callable[[InputMalformedError], None] | None = None
    ) -> Iterator[list[Messages]]:
        """Yield the messages of each whole chunk, channel by channel.

        Parameters
        ----------
        damaged : callable, optional
            Is told of each damaged record, which is then passed over; without it the first one is an error.

        Raises
        ------
        InputNotFoundError
            When the file is missing, empty or a folder.
        InputMalformedError
            When it is no MCAP file or a chunk in it is damaged.
        """
        for opcode, body in self._records():
            try:
                found = self._take(opcode, body)
            except InputMalformedError as refusal:
                if damaged is None:
                    raise
                damaged(refusal)
                continue
            except (struct.error, UnicodeDecodeError, LookupError, ValueError) as damage:
                unreadable = InputMalformedError(
                    f"a record cannot be read ({damage})", where=self.path, remedy="run acquire recover"
                )
                if damaged is None:
                    raise unreadable from damage
                damaged(unreadable)
                continue
            if found is not None:
                yield found

    def _take(self, opcode: int, body: bytes) -> list[Messages] | None:
        if opcode == records.CHUNK:
            return self._chunk(body)
        if opcode == records.METADATA:
            cursor = _Cursor(body)
            name = cursor.text()
            self.metadata[name] = cursor.table()
        elif opcode == records.ATTACHMENT:
            cursor = _Cursor(body)
            times = cursor.number("<Q"), cursor.number("<Q")
            name, media_type = cursor.text(), cursor.text()
            data = cursor.bytes(cursor.number("<Q"))
            self.attachments[name] = Attachment(media_type, data, *times)
        elif opcode == records.FOOTER:
            self.complete = True
        return None

    def _records(self) -> Iterator[tuple[int, bytes]]:
        if self.path.is_dir():
            raise InputNotFoundError("is a folder, a flight log was expected", where=self.path)
        try:
            stream = self.path.open("rb")
        except OSError as refusal:
            reason = (refusal.strerror or str(refusal)).lower()
            raise InputNotFoundError(
                f"cannot be read ({reason})", where=self.path, remedy="check name and rights"
            ) from refusal
        with stream:
            total = self.path.stat().st_size
            magic = stream.read(len(records.MAGIC))
            if magic != records.MAGIC:
                what = "is no flight log (MCAP)" if magic else "is empty"
                raise InputMalformedError(
                    what, where=self.path, remedy="name an .mcap file, or import the recording first"
                )
            stream.seek(max(self.position, len(magic)))
            while not self.complete and len(head := stream.read(9)) == 9:
                opcode, size = struct.unpack("<BQ", head)
                if size > total - stream.tell():
                    return
                body = stream.read(size)
                self.position = stream.tell()
                yield opcode, body

    def _chunk(self, body: bytes) -> list[Messages]:
        cursor = _Cursor(body, 16)
        size, check = cursor.number("<Q"), cursor.number("<I")
        compression = cursor.text()
        packed = cursor.bytes(cursor.number("<Q"))
        try:
            content = _unpack(compression, packed, size)
        except (RuntimeError, ValueError, EOFError, MemoryError) as damage:
            raise InputMalformedError(
                f"a chunk cannot be unpacked ({damage})", where=self.path, remedy="run acquire recover"
            ) from damage
        if check and zlib.crc32(content) != check:
            raise InputMalformedError(
                "the checksum of a chunk disagrees", where=self.path, remedy="run acquire recover"
            )
        return self._messages(content)

    def _messages(self, content: bytes) -> list[Messages]:
        places: dict[int, list[int]] = {}
        sizes: dict[int, list[int]] = {}
        width = records.MESSAGE_ROW.itemsize
        at, end = 0, len(content)
        while at + 9 <= end:
            opcode, size = content[at], int.from_bytes(content[at + 1 : at + 9], "little")
            if opcode == records.MESSAGE:
                number = content[at + 9] | content[at + 10] << 8
                places.setdefault(number, []).append(at)
                sizes.setdefault(number, []).append(size)
            elif opcode in (records.SCHEMA, records.CHANNEL):
                self._define(opcode, content[at + 9 : at + 9 + size])
            at += 9 + size
        found = []
        for number, starts in places.items():
            place = np.array(starts, np.int64)
            head = np.ndarray((end - width + 1,), records.MESSAGE_ROW, content, strides=(1,))[place]
            payloads = [content[a + width : a + 9 + s] for a, s in zip(starts, sizes[number], strict=True)]
            found.append(
                Messages(
                    self._channels[number],
                    payloads,
                    head["log_ns"].astype(np.int64),
                    head["publish_ns"].astype(np.int64),
                    head["sequence"].astype(np.int64),
                )
            )
        return found

    def _define(self, opcode: int, body: bytes) -> None:
        cursor = _Cursor(body)
        number = cursor.number("<H")
        if opcode == records.SCHEMA:
            name, encoding = cursor.text(), cursor.text()
            self._schemas[number] = Schema(name, encoding, cursor.bytes(cursor.number("<I")))
            return
        schema = self._schemas.get(cursor.number("<H"))
        self._channels[number] = Channel(cursor.text(), cursor.text(), schema, cursor.table())


def _unpack(compression: str, packed: bytes, size: int) -> bytes:
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.decompress(packed))
    if compression == "zstd":
        import zstandard

        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if compression:
        raise ValueError(f"compression {compression!r}")
    return packed


class _Cursor:
    def __init__(self, data: bytes, at: int = 0) -> None:
        self._data = data
        self._at = at

    def number(self, form: str) -> int:
        (value,) = struct.unpack_from(form, self._data, self._at)
        self._at += struct.calcsize(form)
        return int(value)

    def bytes(self, count: int) -> bytes:
        piece = self._data[self._at : self._at + count]
        self._at += count
        return piece

    def text(self) -> str:
        return self.bytes(self.number("<I")).decode()

    def table(self) -> dict[str, str]:
        end = self.number("<I") + self._at
        values = {}
        while self._at < end:
            key = self.text()
            values[key] = self.text()
        return values

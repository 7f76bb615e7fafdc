"""Repair of flight logs that end early or are damaged inside."""

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from acquire.channels.link import LinkLog
from acquire.log.chunk import ARRIVED_ENCODING, ARRIVED_HEAD
from acquire.log.reader import LoggedMessages, LogReader, link_of
from acquire.log.writer import LogWriter
from drivers.frames import StreamFramer
from drivers.protocols import wires_of
from photocal.base.errors import InputMalformedError
from photocal.base.files import output_file


@dataclass
class _Unframed:
    """What came over a link and was written before it was framed, see `acquire.log.chunk.ARRIVED_HEAD`."""

    protocol: str = ""
    framed: int = 0
    next: int = 0
    pieces: list[tuple[int, int, bytes]] = field(default_factory=list)

    def take(self, part: LoggedMessages) -> None:
        """Take messages of the link."""
        if part.channel.encoding == ARRIVED_ENCODING:
            self.protocol = part.channel.metadata.get("protocol", "")
            for payload, time_ns in zip(part.payloads, part.log_ns.tolist(), strict=True):
                offset, self.framed = ARRIVED_HEAD.unpack_from(payload)
                self.pieces.append((offset, time_ns, payload[ARRIVED_HEAD.size :]))
        else:
            self.framed += sum(map(len, part.payloads))
            self.next = max(self.next, int(part.sequence[-1]) + 1)
        self.pieces = [piece for piece in self.pieces if piece[0] + len(piece[2]) > self.framed]

    def write(self, writer: LogWriter, link: str) -> int:
        """Frame what is left; return the number of frames."""
        framer, log = StreamFramer(wires_of(self.protocol)), LinkLog(writer.messages, link, [], self.next)
        for offset, time_ns, data in self.pieces:
            batch = framer.feed(data[max(0, self.framed - offset) :])
            log.write(batch, np.full(len(batch), time_ns))
        batch = framer.close()
        log.write(batch, np.full(len(batch), log.last_ns))
        return log.tally.frames


def recover(path: Path, output: Path) -> dict[str, Any]:
    """Write what is whole in a log to a new one with all indexes.

    returns: `messages` and `chunks` of the repaired log, `had_its_end`, and `damaged`: what was passed over,
        in words.
    raises InputNotFoundError, InputMalformedError: when the file is missing, is not a flight log or
        holds nothing complete.
    raises OutputError: when the new log cannot be written.
    """
    reader = LogReader(path)
    damage: list[str] = []
    messages = chunks = 0
    with output_file(output) as aside, aside.open("wb") as stream:
        writer = LogWriter(stream)
        tables: set[str] = set()
        files: set[str] = set()
        links: defaultdict[str, _Unframed] = defaultdict(_Unframed)
        for chunk in reader.chunks(lambda refusal: damage.append(refusal.what)):
            _copy_notes(reader, writer, tables, files)
            for part in chunk:
                writer.messages(part.channel, part.payloads, part.log_ns, part.publish_ns, part.sequence)
                messages += len(part.payloads)
                if part.channel.schema is None:
                    links[link_of(part.channel)].take(part)
            writer.end_chunk()
            chunks += 1
        messages += sum(link.write(writer, name) for name, link in links.items() if link.pieces)
        _copy_notes(reader, writer, tables, files)
        whole = reader.complete and not damage
        if not whole and not messages and not files:
            raise InputMalformedError(
                "has no intact chunk, there is nothing to save", "use another copy", where=path
            )
        writer.close()
    counts = {"messages": messages, "chunks": chunks}
    return {**counts, "had_its_end": reader.complete, "damaged": damage}


def _copy_notes(reader: LogReader, writer: LogWriter, tables: set[str], files: set[str]) -> None:
    for name, values in reader.metadata.items():
        if name not in tables:
            tables.add(name)
            writer.metadata(name, values)
    for name, file in reader.attachments.items():
        if name not in files:
            files.add(name)
            writer.attachment(name, file.media_type, file.data, file.log_time, file.create_time)

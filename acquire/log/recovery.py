"""Repair of flight logs that end early or are damaged inside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquire.log.reader import LogReader
from acquire.log.writer import LogWriter
from acquire.outputs import output_file
from drivers.errors import InputMalformedError


@dataclass(frozen=True)
class Recovered:
    """What a repair has saved.

    Parameters
    ----------
    messages, chunks : int
        What the repaired log holds.
    damaged : tuple of str
        What was passed over, in words.
    complete : bool
        Whether the log had its end.
    """

    messages: int
    chunks: int
    damaged: tuple[str, ...]
    complete: bool

    @property
    def intact(self) -> bool:
        """Whether there was nothing to repair."""
        return self.complete and not self.damaged


def recover(path: Path, output: Path) -> Recovered:
    """Write what is whole in a log to a new one with all indexes.

    Parameters
    ----------
    path : Path
        The log; it is not changed.
    output : Path
        The repaired log.

    Raises
    ------
    InputNotFoundError, InputMalformedError
        When the file is missing, is no flight log or holds nothing that is whole.
    OutputError
        When the new log cannot be written.
    """
    reader = LogReader(path)
    damage: list[str] = []
    messages = chunks = 0
    with output_file(output) as aside, aside.open("wb") as stream:
        writer = LogWriter(stream)
        tables: set[str] = set()
        files: set[str] = set()
        for chunk in reader.chunks(lambda refusal: damage.append(refusal.what)):
            _copy_notes(reader, writer, tables, files)
            for part in chunk:
                writer.messages(part.channel, part.payloads, part.log_ns, part.publish_ns, part.sequence)
                messages += len(part.payloads)
            writer.end_chunk()
            chunks += 1
        _copy_notes(reader, writer, tables, files)
        if not chunks and not tables and not files:
            raise InputMalformedError(
                "holds no whole chunk, there is nothing to save", where=path, remedy="look for another copy"
            )
        writer.close()
    return Recovered(messages, chunks, tuple(damage), reader.complete)


def _copy_notes(reader: LogReader, writer: LogWriter, tables: set[str], files: set[str]) -> None:
    for name, values in reader.metadata.items():
        if name not in tables:
            tables.add(name)
            writer.metadata(name, values)
    for name, file in reader.attachments.items():
        if name not in files:
            files.add(name)
            writer.attachment(name, file.media_type, file.data, file.log_ns, file.create_ns)

"""What is watched: a flight log, the folder of a recorder, or its configuration."""

from __future__ import annotations

from pathlib import Path

from acquire.log.records import MAGIC
from acquire.monitor.tail import Tail
from drivers.errors import InputMalformedError, InputNotFoundError


def tail_of(source: Path) -> Tail:
    """Return the tail of a log (``.mcap``), of the logs in a folder, or of a configuration (``.toml``).

    Raises
    ------
    InputNotFoundError
        When it does not exist; the output folder of a configuration need not exist yet.
    InputMalformedError
        When it is a file of another kind.
    ConfigurationError
        When the configuration cannot be meant.
    """
    if source.is_dir():
        return Tail([source])
    if source.suffix == ".toml":
        from acquire.recording.configuration import read_configuration

        recording = read_configuration(source).recording
        return Tail([source.parent / folder for folder in (recording.output, *recording.spare)])
    if not source.is_file():
        raise InputNotFoundError(
            "does not exist",
            where=source,
            remedy="name a flight log, the folder of a recording or its configuration",
        )
    with source.open("rb") as stream:
        begin = stream.read(len(MAGIC))
    # One that is only just being begun may still be shorter.
    if not MAGIC.startswith(begin):
        raise InputMalformedError(
            "is no flight log (MCAP)",
            where=source,
            remedy="name an .mcap file, or import the recording first",
        )
    return Tail(source)

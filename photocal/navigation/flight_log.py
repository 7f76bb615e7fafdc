"""One flight in one or several logs, read as one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from acquire.log.reader import LogReader, Messages


def messages_of(logs: tuple[Path, ...]) -> Iterator[Messages]:
    """Give the messages of logs that follow each other (rotated or resumed recordings)."""
    for path in logs:
        for chunk in LogReader(path).chunks():
            yield from chunk


def named(logs: tuple[Path, ...]) -> str:
    """Return the names of the logs for a message."""
    return ", ".join(map(str, logs))

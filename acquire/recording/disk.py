"""Logs on the disk: writes that are whole or not there, names that are free, logs without an end."""

from __future__ import annotations

import contextlib
import datetime as dt
import io
import itertools
import os
from collections.abc import Callable
from pathlib import Path

from acquire.log import records


class WholeWrites(io.RawIOBase):
    """A file whose writes are complete or fail; after a failure it ends where the last complete one ended.

    file: where the bytes go, unbuffered.
    """

    def __init__(self, file: io.FileIO) -> None:
        super().__init__()
        self._file = file
        self.size = 0

    def writable(self) -> bool:
        """Tell that it can be written."""
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Write all of `data`."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._file.truncate(self.size)
            self._file.seek(self.size)
            raise
        self.size += len(data)
        return len(data)

    def make_safe(self) -> None:
        """Wait until the disk has everything."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def new_file(path: Path) -> WholeWrites:
    """Make a file that does not exist yet."""
    return WholeWrites(io.FileIO(path, "xb"))


def new_log(
    folder: Path, time_ns: int, make: Callable[[Path], WholeWrites] = new_file
) -> tuple[Path, WholeWrites]:
    """Make the file of a log under a name that is free; the folder is made.

    Whoever makes the file has it: a name that another recorder takes at the same moment is passed over.
    """
    folder.mkdir(parents=True, exist_ok=True)
    moment = dt.datetime.fromtimestamp(time_ns / 1e9, dt.UTC).strftime("%Y%m%dT%H%M%SZ")
    for number in itertools.count(1):
        # Sorted by their names the files of a second stand in their order, too.
        path = folder / (f"flight-{moment}.mcap" if number == 1 else f"flight-{moment}_{number:02d}.mcap")
        with contextlib.suppress(FileExistsError):
            return path, make(path)
    raise AssertionError


def unclosed(folder: Path) -> list[Path]:
    """Return the logs in a folder that have no end: recordings that were cut off, or still run."""
    return [path for path in sorted(folder.glob("flight-*.mcap")) if not _has_end(path)]


def _has_end(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            stream.seek(-len(records.MAGIC), io.SEEK_END)
            return stream.read() == records.MAGIC and stream.tell() > len(records.MAGIC)
    except OSError:
        return False

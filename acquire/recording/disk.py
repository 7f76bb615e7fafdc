"""Logs on the disk: writes that are whole or not there, names that are free, logs without an end."""

from __future__ import annotations

import datetime as dt
import io
import os
from pathlib import Path

from acquire.log import records
from drivers.errors import OutputError


class WholeWrites(io.RawIOBase):
    """A file whose writes are complete or fail; after a failure it ends where the last complete one ended.

    Parameters
    ----------
    file : raw file
        Where the bytes go, unbuffered.
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


def new_path(folder: Path, time_ns: int) -> Path:
    """Return the path of a file that does not exist yet; the folder is made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as failure:
        raise OutputError(
            f"cannot be made ({failure.strerror or failure})", where=folder, remedy="choose another folder"
        ) from failure
    moment = dt.datetime.fromtimestamp(time_ns / 1e9, dt.UTC).strftime("%Y%m%dT%H%M%SZ")
    path = folder / f"flight-{moment}.mcap"
    number = 1
    while path.exists():
        number += 1
        # Sorted by their names the files of a second stand in their order, too.
        path = folder / f"flight-{moment}_{number:02d}.mcap"
    return path


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

"""The files of a recording: one after the other, and on to the next place when a disk is full."""

import contextlib
import datetime as dt
import errno
import io
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from acquire.log import records
from acquire.log.records import Channel
from acquire.log.writer import LogWriter
from photocal.base.arrays import Integers
from photocal.base.errors import OutputError

# What is held in memory while no disk takes anything, and how often it is tried again.
HELD_BYTES = 256 << 20
TRY_AGAIN_S = 5.0

# Kind (see `acquire.recording.alarms`) and words of what had to be done.
Notice = tuple[str, str]


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
    """Make the file of a log under a name that is free; the folder is made."""
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


@dataclass(frozen=True)
class Limits:
    """When a file is ended and the next begun: size in bytes, age in seconds; 0 for never."""

    size: int = 0
    age_s: float = 0.0


class LogFiles:
    """Writes messages to one log file after the other.

    begin: writes to each file what stands at its beginning.
    clock_ns: the clock of the host, UTC nanoseconds since 1970.
    """

    def __init__(
        self,
        folders: Sequence[Path],
        begin: Callable[[LogWriter], None],
        limits: Limits,
        clock_ns: Callable[[], int],
        make: Callable[[Path], WholeWrites] = new_file,
    ) -> None:
        self._folders = list(folders)
        self._begin = begin
        self._limits = limits
        self._clock_ns = clock_ns
        self._make = make
        self._place = 0
        # When writing is tried again, UTC ns; None while there is a file.
        self._again_ns: int | None = None
        # A disk may take seconds to write what it has taken: nobody waits for it but this thread.
        self._waiter = ThreadPoolExecutor(1, "disk")
        self._safe: Future[None] | None = None
        self.paths: list[Path] = []
        path = self._folders[0]
        try:
            path, self._stream = new_log(path, clock_ns(), make)
            self._writer = LogWriter(self._stream)
            begin(self._writer)
        except OSError as failure:
            raise OutputError(
                f"cannot be written ({failure.strerror or failure})",
                "make room, or choose another folder",
                where=path,
            ) from failure
        self._begun_ns = clock_ns()
        self.paths.append(path)

    @property
    def open_bytes(self) -> int:
        """Size of the messages that are not in a file yet."""
        return self._writer.open_bytes

    def messages(
        self,
        channel: Channel,
        payloads: records.Payloads,
        log_ns: Integers,
        publish_ns: Integers,
        sequence: Integers,
    ) -> None:
        """Add messages, see `LogWriter.messages`."""
        self._writer.messages(channel, payloads, log_ns, publish_ns, sequence)

    def end_chunk(self) -> list[Notice]:
        """Write the open chunk; return in words what had to be done for that.

        Where every place is full the messages are held in memory and writing is tried again.

        raises OutputError: when it can be written nowhere and more is held than `HELD_BYTES`.
        """
        if self._again_ns is not None:
            return self._try_again()
        try:
            self._writer.end_chunk()
        except OSError as failure:
            return self._move(failure)
        return []

    def make_safe(self) -> list[Notice]:
        """Write everything, let the disk make it safe, and begin the next file when it is time."""
        # See `end_chunk`. Whether the disk has it is known by the next call, or later where the disk is slow.
        notices = self.end_chunk()
        if self._again_ns is not None:
            return notices
        if self._safe is not None and self._safe.done():
            failure = self._settled()
            if failure is not None:
                # What was written to this file cannot be trusted to be on the disk: nothing more goes there.
                return notices + self._move(failure)
        if self._safe is None:
            self._safe = self._waiter.submit(self._stream.make_safe)
        age_s = (self._clock_ns() - self._begun_ns) / 1e9
        if (self._limits.size and self._stream.size >= self._limits.size) or (
            self._limits.age_s and age_s >= self._limits.age_s
        ):
            notices += self._rotate()
        return notices

    def close(self) -> list[Notice]:
        """Write what is left and the summary; raises OutputError when what is held can be written nowhere."""
        self._again_ns = None if self._again_ns is None else 0
        notices = self.end_chunk()
        if self._again_ns is not None:
            raise self._refusal("no place has room")
        notices += self._finish()
        self._waiter.shutdown()
        return notices

    def _settled(self) -> OSError | None:
        """Wait for the disk; return why it failed."""
        running, self._safe = self._safe, None
        if running is None:
            return None
        failure = running.exception()
        if failure is not None and not isinstance(failure, OSError):
            raise failure
        return failure

    def _finish(self) -> list[Notice]:
        path = self.paths[-1]
        try:
            if (late := self._settled()) is not None:
                raise late
            self._writer.close()
            self._stream.make_safe()
        except OSError as failure:
            reason = failure.strerror or failure
            return [("disk_full", f"{path} has no summary ({reason}): acquire recover adds it")]
        finally:
            self._stream.close()
        return []

    def _rotate(self) -> list[Notice]:
        try:
            path, stream = new_log(self._folders[self._place], self._clock_ns(), self._make)
        except OSError as failure:
            return self._move(failure)
        following = self._writer.continued(stream)
        notices = self._finish()
        self._writer, self._stream = following, stream
        self.paths.append(path)
        self._begun_ns = self._clock_ns()
        try:
            self._begin(self._writer)
        except OSError as failure:
            return notices + self._move(failure)
        return [*notices, ("note", f"recording to {path}")]

    def _move(self, failure: OSError) -> list[Notice]:
        """Go on in the first place that takes what is not written yet."""
        reason = failure.strerror or str(failure)
        full = self.paths[-1]
        self._settled()
        self._stream.close()
        # After waiting, room may have come anywhere.
        first = 0 if self._again_ns is not None else self._place
        for place in range(first, len(self._folders)):
            made = None
            try:
                made = path, stream = new_log(self._folders[place], self._clock_ns(), self._make)
                self._writer = self._writer.continued(stream)
                self._begin(self._writer)
                self._writer.end_chunk()
            except OSError:
                if made is not None:
                    # We have made it, and nothing that was taken is in it alone.
                    made[1].close()
                    made[0].unlink(missing_ok=True)
                continue
            self._stream, self._place = stream, place
            self.paths.append(path)
            self._begun_ns = self._clock_ns()
            waited, self._again_ns = self._again_ns is not None, None
            if waited:
                return [("note", f"there is room again, recording goes on in {path}")]
            text = f"{full} cannot be written any more ({reason}), recording goes on in {path}"
            return [("disk_full", text)]
        if self.open_bytes > HELD_BYTES:
            raise self._refusal(reason) from failure
        waited = self._again_ns is not None
        self._again_ns = self._clock_ns() + round(TRY_AGAIN_S * 1e9)
        if waited:
            return []
        text = f"no place can be written ({reason}): make room now, what comes is held in memory"
        return [("disk_full", text)]

    def _try_again(self) -> list[Notice]:
        """Look for a place when it is time for that, or when too much is held."""
        clock_ns = self._clock_ns()
        # A clock that was set back must not put it off.
        soon = self._again_ns is not None and clock_ns < self._again_ns <= clock_ns + TRY_AGAIN_S * 1e9
        if soon and self.open_bytes <= HELD_BYTES:
            return []
        return self._move(OSError(errno.ENOSPC, "no room yet"))

    def _refusal(self, reason: str) -> OutputError:
        return OutputError(
            f"the recording cannot go on ({reason}): {self.open_bytes} bytes lost, what was written is safe",
            "make room or name a spare folder, then acquire recover this file",
            where=self.paths[-1],
        )

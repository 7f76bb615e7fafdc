"""The files of a recording: one after the other, and on to the next place when a disk is full."""

import contextlib
import datetime as dt
import errno
import io
import itertools
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from acquire.log import records
from acquire.log.records import Channel
from acquire.log.writer import LogWriter
from photocal.base.arrays import Integers
from photocal.base.errors import OutputError
from photocal.base.operating_system import sync_folder

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
        self._path = Path(os.fsdecode(file.name)).absolute()
        self._folders = list(self._path.parents[:2])
        # Where a file system gives its files no lasting numbers, only that there is one can be asked.
        self._numbered = self._same()
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
        """Wait until the disk has everything, the first time also the name of the file and of its folder."""
        os.fsync(self._file.fileno())
        while self._folders:
            # Not every file system knows how to; the file itself is on the disk.
            with contextlib.suppress(OSError):
                sync_folder(self._folders[0])
            del self._folders[0]

    @property
    def at_its_name(self) -> bool:
        """Whether the file is still what its name names: it may have been deleted or moved meanwhile.

        Windows lets nobody delete or move an open file: there nothing is compared.
        """
        try:
            return sys.platform == "win32" or self._same() or not self._numbered
        except FileNotFoundError:
            return False
        except OSError:
            # Whether it is there cannot be known; that it cannot be written any more will be told.
            return True

    def _same(self) -> bool:
        return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())

    def whereabouts(self) -> Path | None:
        """Return where a moved file is now, as far as the system tells; None when it is deleted."""
        with contextlib.suppress(OSError):
            if os.fstat(self._file.fileno()).st_nlink:
                path = Path(f"/proc/self/fd/{self._file.fileno()}").readlink()
                return path if path.exists() else None
        return None

    def copy_to(self, target: io.FileIO) -> None:
        """Copy all that was written, safe on the disk: what has no name any more gets one again."""
        with io.FileIO(os.dup(self._file.fileno())) as content, target:
            content.seek(0)
            shutil.copyfileobj(content, target, 1 << 20)
            os.fsync(target.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def new_file(path: Path) -> WholeWrites:
    """Make a file that does not exist yet."""
    return WholeWrites(io.FileIO(path, "x+b"))


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
class RotationLimits:
    """When a file is ended and the next begun: size in bytes, age in seconds; 0 for never."""

    size: int = 0
    age_s: float = 0.0


class LogFiles:
    """Writes messages to one log file after the other.

    A file that is deleted while it is written is copied back from what the system still has of it; one that
    is moved is left where it is. Either way recording goes on in the next file.

    begin: writes to each file what stands at its beginning.
    clock_ns: the clock of the host, UTC nanoseconds since 1970.
    steady_s: a clock that never jumps, seconds.
    """

    def __init__(
        self,
        folders: Sequence[Path],
        begin: Callable[[LogWriter], None],
        limits: RotationLimits,
        clock_ns: Callable[[], int],
        make: Callable[[Path], WholeWrites] = new_file,
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folders = list(folders)
        self._begin = begin
        self._limits = limits
        self._clock_ns, self._steady_s = clock_ns, steady_s
        self._make = make
        self._place = 0
        # When writing is tried again, by the steady clock; None while there is a file.
        self._again_s: float | None = None
        # A disk may take seconds to write what it has taken: nobody waits for it but this thread.
        self._waiter = ThreadPoolExecutor(1, "disk")
        self._safe: Future[None] | None = None
        # Deleted files that are being copied back, each with its name and that of its copy.
        self._rescuer = ThreadPoolExecutor(1, "rescue")
        self._rescues: list[tuple[Path, Path, Future[None]]] = []
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
        self._begun_s = steady_s()
        self.paths.append(path)

    def existing(self) -> list[Path]:
        """Return the files of the recording that there are now."""
        return [path for path in self.paths if path.is_file()]

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
        if self._again_s is not None:
            return self._try_again()
        try:
            self._writer.end_chunk()
        except OSError as failure:
            return self._move(failure)
        return []

    def make_safe(self) -> list[Notice]:
        """Write everything, let the disk make it safe, and begin the next file when it is time."""
        # See `end_chunk`. Whether the disk has it is known by the next call, or later where the disk is slow.
        notices = [*self._rescued(), *self.end_chunk()]
        if self._again_s is not None:
            return notices
        if not self._stream.at_its_name:
            return notices + self._replace()
        if self._safe is not None and self._safe.done():
            failure = self._settled()
            if failure is not None:
                # What was written to this file cannot be trusted to be on the disk: nothing more goes there.
                return notices + self._move(failure)
        if self._safe is None:
            self._safe = self._waiter.submit(self._stream.make_safe)
        age_s = self._steady_s() - self._begun_s
        if (self._limits.size and self._stream.size >= self._limits.size) or (
            self._limits.age_s and age_s >= self._limits.age_s
        ):
            notices += self._rotate()
        return notices

    def close(self) -> list[Notice]:
        """Write what is left and the summary; raises OutputError when what is held can be written nowhere."""
        self._again_s = None if self._again_s is None else -math.inf
        notices = self.end_chunk()
        if self._again_s is not None:
            raise self._refusal("no place has room")
        if not self._stream.at_its_name:
            notices += self._replace()
        notices += self._finish()
        self._waiter.shutdown()
        self._rescuer.shutdown()
        notices += self._rescued()
        gone = [path for path in self.paths if not path.is_file()]
        return [*notices, *(("file_gone", f"{path} was deleted or moved after its end") for path in gone)]

    def _replace(self) -> list[Notice]:
        """Go on in a new file, since the open one is not under its name any more."""
        gone, stream, moved = self.paths[-1], self._stream, self._stream.whereabouts()
        for place in range(self._place, len(self._folders)):
            made = None
            try:
                made = path, following = new_log(self._folders[place], self._clock_ns(), self._make)
                # The one without a name gets its end, too.
                self._writer, before = self._writer.continued(following), self._writer
            except OSError:
                if made is not None:
                    _discard(*made)
                continue
            notices = self._end(before, stream, gone)
            self._stream, self._place, self._begun_s = following, place, self._steady_s()
            if moved is None:
                notices += self._rescue(gone, stream, path.parent)
            else:
                _close(stream)
                self.paths[-1] = moved
            self.paths.append(path)
            what = "was deleted" if moved is None else f"was moved to {moved}"
            notices.append(("file_gone", f"{gone} {what} while it was written, recording goes on in {path}"))
            try:
                self._begin(self._writer)
            except OSError as failure:
                notices += self._move(failure)
            return notices
        # What has no name can still be written: it is tried again with the next flush.
        return [("file_gone", f"{gone} was deleted or moved, and no new file can be made: look at the disk")]

    def _rescue(self, gone: Path, stream: WholeWrites, folder: Path) -> list[Notice]:
        """Copy a file that has lost its name to a new one in a thread of its own."""
        names = (gone.name, *(f"{gone.stem}_saved{number}.mcap" for number in range(1, 100)))
        copy, reason = None, "no name is free"
        for name in names:
            try:
                copy = io.FileIO(folder / name, "xb")
                break
            except FileExistsError:
                continue
            except OSError as failure:
                reason = str(failure.strerror or failure)
                break
        if copy is None:
            _close(stream)
            self.paths.remove(gone)
            return [("file_gone", f"{gone} was deleted and cannot be saved ({reason}): it is lost")]
        self._rescues.append((gone, Path(copy.name), self._rescuer.submit(_copy_back, stream, copy)))
        return []

    def _rescued(self) -> list[Notice]:
        """Return what became of the deleted files that were copied back by now."""
        notices = []
        for rescue in [rescue for rescue in self._rescues if rescue[2].done()]:
            self._rescues.remove(rescue)
            gone, copy, copying = rescue
            place = self.paths.index(gone)
            if (failure := copying.exception()) is None:
                self.paths[place] = copy
                notices.append(("note", f"{gone} was deleted, what was in it is saved in {copy}"))
            else:
                del self.paths[place]
                notices.append(
                    ("file_gone", f"{gone} was deleted and cannot be saved ({failure}): it is lost")
                )
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
        """End the open file."""
        try:
            return self._end(self._writer, self._stream, self.paths[-1])
        finally:
            _close(self._stream)

    def _end(self, writer: LogWriter, stream: WholeWrites, path: Path) -> list[Notice]:
        """Give a file its summary."""
        try:
            if (late := self._settled()) is not None:
                raise late
            writer.close()
            stream.make_safe()
        except OSError as failure:
            reason = failure.strerror or failure
            return [("disk_full", f"{path} has no summary ({reason}): acquire recover adds it")]
        return []

    def _rotate(self) -> list[Notice]:
        try:
            path, stream = new_log(self._folders[self._place], self._clock_ns(), self._make)
        except OSError as failure:
            return self._move(failure)
        try:
            following = self._writer.continued(stream)
        except OSError as failure:
            _discard(path, stream)
            return self._move(failure)
        notices = self._finish()
        self._writer, self._stream = following, stream
        self.paths.append(path)
        self._begun_s = self._steady_s()
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
        _close(self._stream)
        # After waiting, room may have come anywhere.
        first = 0 if self._again_s is not None else self._place
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
                    _discard(*made)
                continue
            self._stream, self._place = stream, place
            self.paths.append(path)
            self._begun_s = self._steady_s()
            waited, self._again_s = self._again_s is not None, None
            if waited:
                return [("note", f"there is room again, recording goes on in {path}")]
            text = f"{full} cannot be written any more ({reason}), recording goes on in {path}"
            return [("disk_full", text)]
        if self.open_bytes > HELD_BYTES:
            raise self._refusal(reason) from failure
        waited = self._again_s is not None
        self._again_s = self._steady_s() + TRY_AGAIN_S
        if waited:
            return []
        text = f"no place can be written ({reason}): make room now, what comes is held in memory"
        return [("disk_full", text)]

    def _try_again(self) -> list[Notice]:
        """Look for a place when it is time for that, or when too much is held."""
        soon = self._again_s is not None and self._steady_s() < self._again_s
        if soon and self.open_bytes <= HELD_BYTES:
            return []
        return self._move(OSError(errno.ENOSPC, "no room yet"))

    def _refusal(self, reason: str) -> OutputError:
        return OutputError(
            f"the recording cannot go on ({reason}): {self.open_bytes} bytes lost, what was written is safe",
            "make room or name a spare folder, then acquire recover this file",
            where=self.paths[-1],
        )


def _copy_back(stream: WholeWrites, copy: io.FileIO) -> None:
    try:
        stream.copy_to(copy)
    except OSError:
        with contextlib.suppress(OSError):
            Path(copy.name).unlink(missing_ok=True)
        raise
    finally:
        _close(stream)


def _close(stream: WholeWrites) -> None:
    # A disk that fails may refuse even that; what it has taken stays.
    with contextlib.suppress(OSError):
        stream.close()


def _discard(path: Path, stream: WholeWrites) -> None:
    """Take away a file that we have made in vain."""
    _close(stream)
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)

"""One file of a recording: whole writes, what the disk has confirmed of them, and its name."""

import contextlib
import datetime as dt
import io
import itertools
import os
import shutil
import sys
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path

from acquire.log.chunk import MOST_UNSAFE, SealedChunk
from acquire.log.reader import has_end
from acquire.log.writer import LogWriter
from photocal.base.operating_system import sync_folder


class WholeWrites(io.RawIOBase):
    """A file whose writes are complete or fail; after a failure it ends where the last complete one ended.

    file: where the bytes go, unbuffered; path: its name.
    """

    def __init__(self, file: io.FileIO) -> None:
        super().__init__()
        self._file = file
        self.path = Path(os.fsdecode(file.name)).absolute()
        self._folders = list(self.path.parents[:2])
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
            # Whether it is there is unknown; if it cannot be written any more, the next write reports it.
            return True

    def _same(self) -> bool:
        return os.path.samestat(os.fstat(self._file.fileno()), self.path.stat())

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

    def cut(self, size: int) -> None:
        """Shorten the file."""
        self._file.truncate(size)
        self._file.seek(size)
        self.size = size

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
    return [path for path in sorted(folder.glob("flight-*.mcap")) if not has_end(path)]


def in_background(name: str, act: Callable[[], None]) -> "Future[None]":
    """Do something in a thread that nobody waits for at the end of the program, as a disk may hang."""
    future: Future[None] = Future()

    def run() -> None:
        """Do it, and keep how it ended."""
        try:
            act()
        except BaseException as failure:
            future.set_exception(failure)
        else:
            future.set_result(None)

    try:
        threading.Thread(target=run, name=name, daemon=True).start()
    except RuntimeError:
        # A computer that has no more threads to give does it at once.
        run()
    return future


@dataclass
class _Flush:
    """A flush that is under way: since when, and how much is safe when it succeeds."""

    begun_s: float
    done: "Future[None]"
    chunks: int
    size: int


@dataclass
class OpenFile:
    """A file of the recording while it is written.

    begun_s: when it was begun, by a clock that never jumps.
    safe_bytes: where it is cut when what is beyond is written elsewhere; None: that is in no memory any more.
    unsafe: the chunks of it that the disk has not confirmed, oldest first: they can be written elsewhere.
    """

    path: Path
    stream: WholeWrites
    writer: LogWriter
    begun_s: float
    safe_bytes: int | None
    unsafe: deque[SealedChunk] = field(default_factory=deque)
    _unsafe_bytes: int = 0
    _flush: _Flush | None = None
    _flush_again: bool = False

    def put(self, chunk: SealedChunk) -> None:
        """Write a chunk."""
        self.writer.put(chunk)
        self.unsafe.append(chunk)
        self._unsafe_bytes += chunk.size
        while self._unsafe_bytes > MOST_UNSAFE:
            self._drop_first()
            self.safe_bytes = None

    def flush(self, steady_s: float) -> None:
        """Let the disk make safe what is written; where it is still at that, as soon as it is not."""
        self._flush_again = self._flush is not None
        if self._flush is None:
            done = in_background("disk", self.stream.make_safe)
            self._flush = _Flush(steady_s, done, len(self.unsafe), self.stream.size)

    @property
    def flush_overdue(self) -> bool:
        """Whether a flush had to wait for the one before, which has ended."""
        return self._flush_again and self._flush is not None and self._flush.done.done()

    def flushing_s(self, steady_s: float) -> float:
        """Tell how long the disk has been at the flush that is under way."""
        return 0.0 if self._flush is None else steady_s - self._flush.begun_s

    def settle(self, *, wait: bool = False) -> OSError | None:
        """Take note of a flush that has ended; return why it failed."""
        flush = self._flush
        if flush is None or not (wait or flush.done.done()):
            return None
        failure = flush.done.exception()
        self._flush = None
        if failure is None:
            for _ in range(flush.chunks):
                self._drop_first()
            self.safe_bytes = None if self.safe_bytes is None else flush.size
        elif not isinstance(failure, OSError):
            raise failure
        return failure

    def secure(self) -> None:
        """Wait until the disk has everything; raises OSError when it cannot."""
        if (failure := self.settle(wait=True)) is not None:
            raise failure
        self.stream.make_safe()
        self.unsafe.clear()
        self._unsafe_bytes = 0

    def end(self) -> None:
        """Write the summary and wait for the disk; raises OSError when it cannot."""
        if (failure := self.settle(wait=True)) is not None:
            raise failure
        try:
            self.writer.close()
        finally:
            # Where there is no room for a summary the rest is safe all the same.
            self.secure()

    def give_up(self) -> None:
        """Cut off what was written elsewhere, when the disk lets go of it, and close the file."""
        # What a late flush still confirms has been written elsewhere, too.
        size = self.safe_bytes
        self.settle(wait=True)
        with contextlib.suppress(OSError):
            if size is not None:
                self.stream.cut(size)
        self.close()

    def close(self) -> None:
        """Close the file: a disk that fails may refuse even that; what it has taken stays."""
        with contextlib.suppress(OSError):
            self.stream.close()

    def _drop_first(self) -> None:
        if self.unsafe:
            self._unsafe_bytes -= self.unsafe.popleft().size
            if self._flush is not None:
                self._flush.chunks = max(0, self._flush.chunks - 1)


def discard(path: Path, stream: WholeWrites) -> None:
    """Take away a file that was made in vain."""
    with contextlib.suppress(OSError):
        stream.close()
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)

"""The files of a recording: one after the other, in the next place when a disk is full, fails or hangs.

What of a recording is kept longest while no disk takes anything and the memory fills.
"""

import contextlib
import errno
import io
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from pathlib import Path

from acquire.log.chunk import (
    ARRIVED_ENCODING,
    DAMAGE_ENCODING,
    PART_OF,
    Channel,
    OpenChunk,
    Payloads,
    SealedChunk,
)
from acquire.log.writer import LogWriter
from acquire.recording.log_file import OpenFile, WholeWrites, discard, in_background, new_file, new_log
from photocal.base.arrays import Integers
from photocal.base.errors import OutputError, reason
from photocal.base.operating_system import available_memory

# Words of what may be left out, and the share of the memory up to which it is kept: the least of worth first.
DECODED = "decoded messages (they can be made again from the raw ones)"
VEHICLE = "raw frames of vehicles and sentences, alarms and damage"
RECEIVER = "raw frames of GNSS receivers and corrections"
CAMERA = "camera events"
SHARE = {DECODED: 0.5, VEHICLE: 0.75, RECEIVER: 0.95, CAMERA: 1.0}
_OF_LITTLE_WORTH = ("mavlink", "nmea", DAMAGE_ENCODING, ARRIVED_ENCODING)


def worth(channel: Channel) -> str:
    """Return as what a channel counts, one of `SHARE`.

    Camera events come once, and what a receiver has measured cannot be made again; an autopilot keeps a log
    of its own.
    """
    if channel.topic.startswith("/camera/"):
        return CAMERA
    if channel.topic == "/alarm":
        return VEHICLE
    if channel.schema is not None:
        return DECODED
    return VEHICLE if channel.encoding in _OF_LITTLE_WORTH else RECEIVER


# What is held in memory while no disk takes anything (no more than a quarter of what is free), and how often
# it is tried again.
HELD_BYTES = 256 << 20
# A flush longer than the first is reported; after the second, recording continues in the next folder.
SLOW_S, HUNG_S, SLOW_TOLD_S = 1.0, 8.0, 10.0
# How long a stop waits for a disk, and for one that was left because it fails or hangs.
LAST_FLUSH_S, GIVE_UP_S = 60.0, 1.0

# Kind (see `acquire.recording.alarms`) and words of what had to be done.
Notice = tuple[str, str]


class LogFiles:
    """Writes messages to one log file after the other.

    What the disk has not confirmed is kept in memory: where a flush fails it is written again, elsewhere.
    A file that is deleted while it is written is copied back from what the system still has of it; one that
    is moved is left where it is. Either way recording continues in the next file.

    begin: writes to each file what stands at its beginning.
    most_bytes, most_s: size and age at which a file is ended and the next begun; 0 for never.
    clock_ns: the clock of the host, UTC nanoseconds since 1970.
    steady_s: a clock that never jumps, seconds.
    """

    def __init__(
        self,
        folders: Sequence[Path],
        begin: Callable[[LogWriter], None],
        clock_ns: Callable[[], int],
        make: Callable[[Path], WholeWrites] = new_file,
        steady_s: Callable[[], float] = time.monotonic,
        *,
        most_bytes: int = 0,
        most_s: float = 0.0,
    ) -> None:
        self._folders = list(folders)
        self._begin = begin
        self._most_bytes, self._most_s = most_bytes, most_s
        self._clock_ns, self._steady_s = clock_ns, steady_s
        self._make = make
        self._open = OpenChunk()
        # Chunks that are in no file yet.
        self._waiting: deque[SealedChunk] = deque()
        self._waiting_bytes = 0
        self._most_held = min(HELD_BYTES, (available_memory() or 4 * HELD_BYTES) // 4)
        self._left_out: Counter[str] = Counter()
        self._told_left_out: set[str] = set()
        self._place = 0
        # When writing is tried again, by the steady clock; None while there is a file.
        self._again_s: float | None = None
        self._slow_due_s, self._slow = -math.inf, False
        # Files that are ended, and those whose end of it is written elsewhere, in threads of their own.
        self._ends: list[tuple[OpenFile, Future[None]]] = []
        self._doubted: list[OpenFile] = []
        self._given_up: list[Future[None]] = []
        # Deleted files that are being copied back, each with the name of its copy.
        self._rescues: list[tuple[OpenFile, Path, Future[None]]] = []
        self.paths: list[Path] = []
        # By the name of its first file a recording is known in each that follows.
        self._first, self._begun = "", 0
        try:
            self._file: OpenFile | None = self._new(0)
        except OSError as failure:
            raise OutputError(
                f"cannot be written ({reason(failure)})",
                "free disk space, or choose another folder",
                where=self._folders[0],
            ) from failure

    def existing(self) -> list[Path]:
        """Return the files of the recording that there are now."""
        return [path for path in self.paths if path.is_file()]

    @property
    def open_bytes(self) -> int:
        """Size of the messages that are in no chunk yet."""
        return self._open.size

    @property
    def held_bytes(self) -> int:
        """Size of the messages that are not in a file yet."""
        return self._open.size + self._waiting_bytes

    def messages(
        self,
        channel: Channel,
        payloads: Payloads,
        log_ns: Integers,
        publish_ns: Integers,
        sequence: Integers,
    ) -> None:
        """Add messages, see `OpenChunk.messages`; while no disk takes any, those of little worth go first."""
        if self._again_s is not None and self.held_bytes > SHARE[worth(channel)] * self._most_held:
            self._left_out[worth(channel)] += len(payloads)
            return
        self._open.messages(channel, payloads, log_ns, publish_ns, sequence)

    def end_chunk(self) -> list[Notice]:
        """Write the open chunk; return in words what had to be done for that.

        Where every place is full the chunks are held in memory and writing is tried again.
        """
        if (chunk := self._open.seal()) is not None:
            self._waiting.append(chunk)
            self._waiting_bytes += chunk.size
        if self._again_s is not None:
            return [*self._try_again(), *self._tell_left_out()]
        return self._write()

    def make_safe(self) -> list[Notice]:
        """Write everything, let the disk make it safe, and begin the next file when it is time."""
        # Whether the disk has it is known by the next call, or later where the disk is slow.
        notices = [*self._rescued(), *self._ended(), *self.end_chunk()]
        file, now = self._file, self._steady_s()
        if file is None:
            return notices
        if not file.stream.at_its_name:
            return notices + self._replace(file)
        if (failure := file.settle()) is not None:
            # What was written to this file cannot be trusted to be on the disk: nothing more goes there.
            return notices + self._move(failure, doubtful=True)
        flushing_s = file.flushing_s(now)
        notices += self._pace(file, flushing_s, now)
        if flushing_s > HUNG_S and self._place + 1 < len(self._folders):
            hung = OSError(errno.ETIMEDOUT, f"no answer for {flushing_s:.0f} s")
            return notices + self._move(hung, doubtful=True)
        file.flush(now)
        if (self._most_bytes and file.stream.size >= self._most_bytes) or (
            self._most_s and now - file.begun_s >= self._most_s
        ):
            notices += self._rotate(file)
        return notices

    @property
    def flush_overdue(self) -> bool:
        """Whether a disk that was too slow for the last flush has caught up, and should go on at once."""
        return self._file is not None and self._file.flush_overdue

    def close(self) -> list[Notice]:
        """Write what is left and the summary; raises OutputError when what is held can be written nowhere."""
        self._again_s = None if self._again_s is None else -math.inf
        notices = [*self.end_chunk(), *self._ended(LAST_FLUSH_S)]
        file = self._file
        if file is not None and not file.stream.at_its_name:
            notices += self._replace(file)
        notices += self._rescued(LAST_FLUSH_S)
        if self._again_s is None:
            # What files that were ended meanwhile could not keep has come back.
            notices += self._write()
        notices += self._end_last()
        if self._waiting:
            notices += self._move(OSError(errno.EIO, "the last flush has failed"))
            notices += self._end_last()
        notices += self._tell_left_out(last=True)
        wait(self._given_up, GIVE_UP_S)
        gone = [path for path in self.paths if not path.is_file()]
        return [*notices, *(("file_gone", f"{path} was deleted or moved after its end") for path in gone)]

    def _new(self, place: int) -> OpenFile:
        """Begin a file in a place; raises OSError when that takes not even its beginning and one chunk."""
        path, stream = new_log(self._folders[place], self._clock_ns(), self._make)
        try:
            writer = LogWriter(stream)
            first = self._first or path.name
            writer.metadata(PART_OF, {"first_file": first, "file": f"{self._begun + 1}"})
            self._begin(writer)
            writer.define(self._open.definitions)
            made = OpenFile(path, stream, writer, self._steady_s(), stream.size)
            if self._waiting:
                self._put_first(made)
        except OSError:
            # We have made it, and nothing that was taken is in it alone.
            discard(path, stream)
            raise
        self._place = place
        self._first, self._begun = first, self._begun + 1
        self.paths.append(path)
        return made

    def _write(self) -> list[Notice]:
        """Write the chunks that wait."""
        file = self._file
        while self._waiting and file is not None:
            try:
                self._put_first(file)
            except OSError as failure:
                return self._move(failure)
        return []

    def _put_first(self, file: OpenFile) -> None:
        file.put(self._waiting[0])
        self._waiting_bytes -= self._waiting.popleft().size

    def _put_back(self, file: OpenFile) -> None:
        """Let what the disk has not confirmed of a file wait for being written again."""
        self._waiting.extendleft(reversed(file.unsafe))
        self._waiting_bytes += sum(chunk.size for chunk in file.unsafe)

    def _pace(self, file: OpenFile, flushing_s: float, now: float) -> list[Notice]:
        """Tell when the disk takes too long, and when that is over."""
        if now < self._slow_due_s:
            return []
        if flushing_s > SLOW_S:
            self._slow, self._slow_due_s = True, now + SLOW_TOLD_S
            text = (
                f"the disk has not confirmed a write for {flushing_s:.1f} s: a power cut now would lose that "
                f"and more ({file.path.name})"
            )
            return [("disk_slow", text)]
        was_slow, self._slow = self._slow, False
        return [("note", f"the disk keeps up again ({file.path.name})")] if was_slow else []

    def _rotate(self, file: OpenFile) -> list[Notice]:
        try:
            self._file = self._new(self._place)
        except OSError as failure:
            return self._move(failure)
        self._end(file)
        return [("note", f"recording to {self._file.path}")]

    def _end(self, file: OpenFile) -> None:
        self._ends.append((file, in_background("end of file", file.end)))

    def _end_last(self) -> list[Notice]:
        if self._file is None:
            raise self._refusal("no folder can be written")
        self._end(self._file)
        self._file = None
        return self._ended(LAST_FLUSH_S)

    def _ended(self, patience_s: float = 0.0) -> list[Notice]:
        """Return what became of files that were ended; what a disk has not kept waits to be written again."""
        notices = []
        until = time.monotonic() + patience_s
        for end in list(self._ends):
            file, ending = end
            try:
                failure = ending.exception(max(0.0, until - time.monotonic()))
            except TimeoutError:
                if patience_s:
                    self._ends.remove(end)
                    text = f"the disk does not answer, unconfirmed data may be missing ({file.path.name})"
                    notices.append(("disk_slow", text))
                continue
            self._ends.remove(end)
            file.close()
            if failure is not None and not isinstance(failure, OSError):
                raise failure
            if failure is not None:
                self._put_back(file)
                notices.append(_no_summary(file, failure))
        return notices

    def _replace(self, file: OpenFile) -> list[Notice]:
        """Go on in a new file, since the open one is not under its name any more."""
        gone, moved = file.path, file.stream.whereabouts()
        following = self._go_on(self._place)
        if following is None:
            # What has no name can still be written: it is tried again with the next flush.
            return [
                ("file_gone", f"{gone} was deleted or moved, and no new file can be made: check the disk")
            ]
        notices = []
        try:
            # The one without a name gets its end, too.
            file.end()
        except OSError as failure:
            notices.append(_no_summary(file, failure))
        if moved is None:
            notices += self._rescue(file, following.path.parent)
        else:
            file.close()
            self.paths[self.paths.index(gone)] = moved
        what = "was deleted" if moved is None else f"was moved to {moved}"
        text = f"{gone} {what} while it was written, recording continues in {following.path}"
        return [*notices, ("file_gone", text)]

    def _go_on(self, first: int) -> OpenFile | None:
        """Begin the next file in the first place, from one on, that takes it; None where none does."""
        for place in range(first, len(self._folders)):
            with contextlib.suppress(OSError):
                self._file = self._new(place)
                return self._file
        return None

    def _rescue(self, file: OpenFile, folder: Path) -> list[Notice]:
        """Copy a file that has lost its name to a new one in a thread of its own."""
        gone = file.path
        names = (gone.name, *(f"{gone.stem}_saved{number}.mcap" for number in range(1, 100)))
        copy, why = None, "no name is free"
        for name in names:
            try:
                copy = io.FileIO(folder / name, "xb")
                break
            except FileExistsError:
                continue
            except OSError as failure:
                why = reason(failure)
                break
        if copy is None:
            file.close()
            self._put_back(file)
            self.paths.remove(gone)
            return [("file_gone", f"{gone} was deleted and cannot be saved ({why}): it is lost")]
        target = copy
        copying = in_background("rescue", lambda: _copy_back(file, target))
        self._rescues.append((file, Path(copy.name), copying))
        return []

    def _rescued(self, patience_s: float = 0.0) -> list[Notice]:
        """Return what became of the deleted files that were copied back by now."""
        notices = []
        for rescue in list(self._rescues):
            file, copy, copying = rescue
            gone = file.path
            try:
                failure = copying.exception(patience_s)
            except TimeoutError:
                continue
            self._rescues.remove(rescue)
            place = self.paths.index(gone)
            if failure is None:
                self.paths[place] = copy
                notices.append(("note", f"{gone} was deleted, its content is saved in {copy}"))
            else:
                del self.paths[place]
                self._put_back(file)
                text = f"{gone} was deleted and cannot be saved ({failure}): it is lost"
                notices.append(("file_gone", text))
        return notices

    def _move(self, failure: OSError, *, doubtful: bool = False) -> list[Notice]:
        """Go on in the first place that takes what is not written yet.

        doubtful: whether the disk may not have what was written since the last flush that it has confirmed.
        """
        # A disk that is full or away is tried again after this.
        try_again_s = 5.0
        why = reason(failure)
        full = self.paths[-1]
        left, self._file = self._file, None
        if left is not None and doubtful:
            self._put_back(left)
            self._doubted.append(left)
        elif left is not None:
            self._ends.append((left, in_background("end of file", left.secure)))
        waited = self._again_s is not None
        # After waiting, room may have come anywhere; a disk that hangs is not tried again before that.
        following = self._go_on(0 if waited else self._place + (failure.errno == errno.ETIMEDOUT))
        if following is None:
            self._again_s = self._steady_s() + try_again_s
            text = f"no folder can be written ({why}): free disk space now, new data are kept in memory"
            return [] if waited else [("disk_full", text)]
        self._again_s = None
        self._given_up += [in_background("give up", file.give_up) for file in self._doubted]
        self._doubted.clear()
        if waited:
            told = "note", f"disk space is free again, recording continues in {following.path}"
        else:
            what = f"{full} can no longer be written ({why})"
            told = "disk_full", f"{what}, recording continues in {following.path}"
        return [told, *self._write()]

    def _try_again(self) -> list[Notice]:
        """Look for a place when it is time for that."""
        if self._again_s is not None and self._steady_s() < self._again_s:
            return []
        return self._move(OSError(errno.ENOSPC, "no free space yet"))

    def _tell_left_out(self, *, last: bool = False) -> list[Notice]:
        """Tell once what is left out, and how much it was at the end."""
        if last:
            return [("disk_full", f"not kept: {n} {what}") for what, n in sorted(self._left_out.items())]
        new = [what for what in self._left_out if what not in self._told_left_out]
        self._told_left_out.update(new)
        return [("disk_full", f"the memory is full: no longer kept: {what}") for what in new]

    def _refusal(self, reason: str) -> OutputError:
        left_out = "".join(f", {number} {what}" for what, number in sorted(self._left_out.items()))
        return OutputError(
            f"the recording cannot continue ({reason}): {self.held_bytes} bytes{left_out} lost, "
            "what was written is safe",
            "free disk space or name a spare folder, then acquire recover this file",
            where=self.paths[-1],
        )


def _no_summary(file: OpenFile, failure: OSError) -> Notice:
    return "disk_full", f"{file.path} has no summary ({reason(failure)}): acquire recover adds it"


def _copy_back(file: OpenFile, copy: io.FileIO) -> None:
    try:
        file.stream.copy_to(copy)
    except OSError:
        with contextlib.suppress(OSError):
            Path(copy.name).unlink(missing_ok=True)
        raise
    finally:
        file.close()

"""Following the log of a recording while it grows, from one file to the next."""

import contextlib
import datetime as dt
import math
import re
import shutil
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from acquire.log.chunk import MAGIC, PART_OF
from acquire.log.reader import LoggedMessages, LogReader, Repeats, has_end
from acquire.monitor.reducer import state_after
from acquire.monitor.state import ComputerState, RecordingState
from acquire.monitor.traffic import looked
from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError, reason
from photocal.base.time_scales import SECOND_NS

# What one step reads at most, so that a long log shows its beginning at once.
_MOST_CHUNKS = 20
_NAME = re.compile(r"flight-(\d{8}T\d{6}Z)(?:_(\d+))?\.mcap")

# The name of the first file of a recording, and which of its files one is.
_Part = tuple[str, int]


class Tail:
    """Reads what is new in the logs of a recording."""

    def __init__(self, source: Path | Sequence[Path]) -> None:
        self._folders = [] if isinstance(source, Path) else list(source)
        self._waiting = [source] if isinstance(source, Path) else []
        self._reader: LogReader | None = None
        # What each log says that was there; the one that is read may be gone since.
        self._parts: dict[Path, _Part] = {}
        self._repeats = Repeats()
        self.flight = ""
        self.trouble = ""

    @property
    def path(self) -> Path | None:
        """The file that is read; None as long as there is none."""
        return None if self._reader is None else self._reader.path

    @property
    def ended(self) -> bool:
        """Whether the file has its end and no other follows yet."""
        return self._reader is not None and self._reader.complete and not self._waiting

    def step(self) -> tuple[list[list[LoggedMessages]], bool]:
        """Return chunks that have come, and whether there may be more at once."""
        chunks = self._read()
        if len(chunks) == _MOST_CHUNKS:
            return chunks, True
        # Only what was read to its end is left for the next file.
        done = not chunks or (self._reader is not None and self._reader.complete)
        return chunks, done and self._next()

    def _read(self) -> list[list[LoggedMessages]]:
        if self._reader is None:
            return []
        chunks: list[list[LoggedMessages]] = []
        self.trouble = ""
        try:
            if self._reader.path.stat().st_size < len(MAGIC):
                return []
            for chunk in self._reader.chunks(self._damaged):
                chunks.append(self._repeats.without(self._reader, chunk))
                if len(chunks) == _MOST_CHUNKS:
                    break
        except OSError as refusal:
            self.trouble = f"{self._reader.path} is missing ({reason(refusal)})"
        except PhotocalError as refusal:
            self.trouble = str(refusal)
        return chunks

    def _damaged(self, refusal: PhotocalError) -> None:
        self.trouble = str(refusal)

    def _next(self) -> bool:
        """Go on to the next file; return whether there was one."""
        if not self._waiting and self._folders:
            self._waiting = self._new_files()
        if not self._waiting:
            return False
        path = self._waiting.pop(0)
        if self._reader is None or not self._goes_on(self._reader.path, path):
            self.flight = path.name
        self._reader = LogReader(path)
        return True

    def _new_files(self) -> list[Path]:
        """Return files newer than the one that is read; at the beginning those of the latest flight."""
        paths = [path for folder in self._folders if folder.is_dir() for path in folder.iterdir()]
        # Of a file that was just made it is not known yet which recording it belongs to.
        unseen = [path for path in paths if path not in self._parts and _NAME.fullmatch(path.name)]
        parts = {path: part for path in unseen if (part := _part(path)) is not None}
        self._parts.update(parts)
        logs = sorted(parts, key=lambda path: (not _to_come(parts[path]), parts[path], path.name))
        if self._reader is not None:
            current = self._parts[self._reader.path]
            return [path for path in logs if _follows(path, parts[path], current)]
        first = len(logs) - 1
        while first > 0 and self._goes_on(logs[first - 1], logs[first]):
            first -= 1
        return logs[max(first, 0) :]

    def _goes_on(self, before: Path, path: Path) -> bool:
        """Whether a log goes on with the flight of the one before it.

        The next file of a recorder does, and that of one which died and was started again at once. A log that
        was closed as it should be is followed by another flight.
        """
        if self._parts[before][0] == self._parts[path][0]:
            return True
        last_s = _written_s(before)
        # Files of one flight follow each other within this time, also when the recorder was started again.
        same_flight_s = 60.0
        # A name has whole seconds; where the clock was set back meanwhile the gap is unknown.
        apart_s = math.nan if last_s is None else _begun_s(path) - last_s
        return -1.0 <= apart_s <= same_flight_s and not has_end(before)


def _follows(path: Path, part: _Part, current: _Part) -> bool:
    """Whether a log that has come while another was read is a later one.

    One with an earlier name is a recording begun after the clock was set back, as long as it is written; or
    else an older log that was brought here.
    """
    return part > current or (part[0] != current[0] and not has_end(path))


def _to_come(part: _Part) -> bool:
    """Whether a recording bears a time that is still to come: it was begun before the clock was set back."""
    begun_s = _begun_s(Path(part[0]))
    return math.isfinite(begun_s) and begun_s > time.time() + 1.0


def _part(path: Path) -> _Part | None:
    """Return which part of which recording a log is; None where nothing was written yet."""
    reader = LogReader(path, wanted=lambda _: False)
    try:
        if path.stat().st_size <= len(MAGIC):
            return None
        begun = any(True for _ in reader.chunks())
    except (OSError, PhotocalError):
        # What stands before the damage counts.
        begun = True
    table = reader.metadata.get(PART_OF, {})
    if "first_file" in table and (number := table.get("file", "")).isdecimal():
        return table["first_file"], int(number)
    return _named(path) if begun or reader.complete else None


def _named(path: Path) -> _Part:
    """Return what the name of a log says: older recorders number the files of a second."""
    match = _NAME.fullmatch(path.name)
    return (f"flight-{match[1]}.mcap", int(match[2] or 1)) if match else (path.name, 1)


def _begun_s(path: Path) -> float:
    match = _NAME.fullmatch(path.name)
    if match is None:
        return math.inf
    return dt.datetime.strptime(match[1], "%Y%m%dT%H%M%SZ").replace(tzinfo=dt.UTC).timestamp()


def _written_s(path: Path) -> float | None:
    try:
        return path.stat().st_mtime_ns / SECOND_NS
    except OSError:
        return None


def tail_of(source: Path) -> Tail:
    """Return the tail of a log (``.mcap``), of the logs in a folder, or of a configuration (``.toml``).

    raises InputNotFoundError: when it does not exist; the output folder of a configuration need not exist
        yet.
    raises InputMalformedError: when it is a file of another kind.
    raises ConfigurationError: when the configuration is not valid.
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
            "name a flight log, the folder of a recording or its configuration",
            where=source,
        )
    with source.open("rb") as stream:
        begin = stream.read(len(MAGIC))
    # One that is only just being begun may still be shorter.
    if not MAGIC.startswith(begin):
        raise InputMalformedError(
            "is not a flight log (MCAP)", "name an .mcap file, or import the recording first", where=source
        )
    return Tail(source)


def follow(
    tail: Tail,
    publish: Callable[[RecordingState], None],
    stop: threading.Event,
    listen: Callable[[list[LoggedMessages]], None] = lambda _: None,
) -> None:
    """Keep a state up to date until told to stop."""
    state = RecordingState()
    look_at = 0.0
    poll_s = 0.1
    look_every_s = 0.5
    while not stop.is_set():
        state, chunks, more = _stepped(tail, state)
        for chunk in chunks:
            listen(chunk)
        if chunks or time.monotonic() >= look_at:
            look_at = time.monotonic() + look_every_s
            state = looked(state, look(tail))
            publish(state)
        if not more:
            stop.wait(poll_s)


def _stepped(tail: Tail, state: RecordingState) -> tuple[RecordingState, list[list[LoggedMessages]], bool]:
    """Return the state after a step of the tail, the chunks of it, and whether there may be more at once."""
    chunks, more = tail.step()
    if tail.flight != state.flight:
        state = RecordingState(flight=tail.flight)
    for chunk in chunks:
        state = state_after(state, chunk)
    return state, chunks, more


def read_all(tail: Tail) -> RecordingState:
    """Return the state after everything that is there now."""
    state = RecordingState()
    more = True
    while more:
        state, chunks, more = _stepped(tail, state)
        # After a log without an end another may follow.
        more = more or bool(chunks)
    return looked(state, look(tail))


def look(tail: Tail) -> ComputerState:
    """Look at the computer."""
    path = tail.path
    size, free = 0, None
    if path is not None:
        size = path.stat().st_size if path.exists() else 0
        with contextlib.suppress(OSError):
            free = shutil.disk_usage(path.parent).free
    return ComputerState(time.time_ns(), path.name if path else "", size, tail.ended, free, tail.trouble)

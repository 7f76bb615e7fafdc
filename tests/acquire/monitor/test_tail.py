"""Following a recording: while a file grows, from file to file, from flight to flight."""

from __future__ import annotations

import datetime as dt
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquire.log.chunk import MAGIC, Channel
from acquire.log.writer import LogWriter
from acquire.monitor.state import RecordingState
from acquire.monitor.tail import Tail, follow, tail_of
from acquire.recording.files import LogFiles
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from tests.acquire.live import until

SECOND = 1_000_000_000
CHANNEL = Channel("/rover/raw", "ubx")


class Recorder:
    """Writes numbered messages as the recorder does, to files of its own."""

    def __init__(self, folder: Path, *, size: int = 0, clock_ns: Callable[[], int] = time.time_ns) -> None:
        self.files = LogFiles([folder], lambda _: None, clock_ns, most_bytes=size)
        self.written = 0

    def write(self, count: int = 5, *, safe: bool = True) -> None:
        for _ in range(count):
            one = np.array([time.time_ns()], np.int64)
            payload = self.written.to_bytes(4, "little") * 20
            self.files.messages(CHANNEL, [payload], one, one, np.array([self.written], np.int64))
            self.written += 1
        if safe:
            self.files.make_safe()


def read(tail: Tail) -> list[int]:
    found: list[int] = []
    more = True
    while more:
        chunks, more = tail.step()
        found += [n for chunk in chunks for part in chunk for n in part.sequence.tolist()]
    return found


def test_a_growing_file_is_read_as_it_grows(tmp_path: Path) -> None:
    tail = Tail([tmp_path])
    assert read(tail) == []
    recorder = Recorder(tmp_path)
    assert read(tail) == []
    seen = []
    for _ in range(4):
        recorder.write()
        seen.append(read(tail))
    recorder.write(safe=False)
    seen.append(read(tail))
    recorder.files.close()
    seen.append(read(tail))
    assert [len(numbers) for numbers in seen] == [5, 5, 5, 5, 0, 5]
    assert [number for numbers in seen for number in numbers] == list(range(25))
    assert tail.ended


def test_a_recording_that_goes_on_in_the_next_file_is_one_flight(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, size=600)
    tail = Tail([tmp_path])
    seen = []
    for _ in range(8):
        recorder.write()
        seen += read(tail)
    recorder.files.close()
    seen += read(tail)
    assert len(recorder.files.paths) > 2
    assert seen == list(range(40))
    assert tail.flight == recorder.files.paths[0].name
    # Who comes later sees the whole flight, too.
    late = Tail([tmp_path])
    assert read(late) == list(range(40))
    assert late.flight == tail.flight


@pytest.mark.parametrize("step_s", [90, -90], ids=["later", "the clock was set back"])
def test_files_of_one_recording_are_one_flight_whatever_their_names(tmp_path: Path, step_s: int) -> None:
    """Each file has its own second in its name, and its end, before the next is read."""
    seconds = iter(range(1_800_000_000, 1_800_000_000 + 40 * step_s, step_s))
    recorder = Recorder(tmp_path, size=600, clock_ns=lambda: next(seconds) * SECOND)
    tail = Tail([tmp_path])
    seen = []
    for _ in range(4):
        recorder.write()
        until(lambda: all(path.read_bytes().endswith(MAGIC) for path in recorder.files.paths[:-1]), "ends")
        seen += read(tail)
    recorder.files.close()
    seen += read(tail)
    names = [path.name for path in recorder.files.paths]
    assert len({name.partition("_")[0] for name in names}) > 2
    assert seen == list(range(20))
    assert tail.flight == names[0]
    late = Tail([tmp_path])
    assert read(late) == seen
    assert late.flight == names[0]


def test_a_file_deleted_while_it_is_read_is_followed_by_the_next(tmp_path: Path) -> None:
    """The third file of a recording goes on where the second was deleted: its name alone would not tell."""
    seconds = iter(range(1_800_000_000, 1_800_009_000, 90))
    recorder = Recorder(tmp_path, size=600, clock_ns=lambda: next(seconds) * SECOND)
    tail = Tail([tmp_path])
    while len(recorder.files.paths) < 3:
        recorder.write()
    deleted = recorder.files.paths[-1]
    # It counts as soon as something stands in it.
    until(lambda: read(tail) is not None and tail.path == deleted, "the third file")
    deleted.unlink()
    # The recorder notices with what it writes now, and copies the file back: it is deleted once more.
    recorder.write()
    until(deleted.exists, "the copy")
    deleted.unlink()
    recorder.write()
    last = recorder.written - 1
    until(lambda: last in read(tail), "what was written after that")
    recorder.files.close()
    assert tail.flight == recorder.files.paths[0].name


def test_a_recorder_that_died_is_followed_by_the_next(tmp_path: Path) -> None:
    first = Recorder(tmp_path)
    first.write()
    tail = Tail([tmp_path])
    assert read(tail) == list(range(5))
    second = Recorder(tmp_path)
    second.write(3)
    assert read(tail) == [0, 1, 2]
    assert tail.flight == first.files.paths[0].name


def _frames(state: RecordingState) -> int:
    """Frames of the rover so far; its link appears with the first."""
    return state.links["rover"].frames if "rover" in state.links else 0


def test_flights_of_other_days_are_not_mixed(tmp_path: Path) -> None:
    yesterday = time.time() - 86_400
    stamp = dt.datetime.fromtimestamp(yesterday, dt.UTC).strftime("%Y%m%dT%H%M%SZ")
    old = tmp_path / f"flight-{stamp}.mcap"
    with old.open("wb") as stream:
        writer = LogWriter(stream)
        one = np.array([round(yesterday * SECOND)], np.int64)
        writer.messages(CHANNEL, [b"old"], one, one, np.array([99]))
        writer.close()
    os.utime(old, (yesterday, yesterday))
    (tmp_path / "other.mcap").write_bytes(old.read_bytes())
    (tmp_path / "flight-1.recovered.mcap").write_bytes(old.read_bytes())
    states: list[RecordingState] = []
    stop = threading.Event()
    thread = threading.Thread(target=follow, args=(Tail([tmp_path]), states.append, stop))
    thread.start()
    try:
        until(lambda: bool(states) and _frames(states[-1]) == 1, "the old flight")
        assert states[-1].flight == old.name
        new = Recorder(tmp_path)
        new.write(7)
        name = new.files.paths[0].name
        until(lambda: states[-1].flight == name and _frames(states[-1]) >= 7, "the new flight")
        assert _frames(states[-1]) == 7
    finally:
        stop.set()
        thread.join()


def test_a_file_that_vanishes_and_a_damaged_chunk_are_told_in_words(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path)
    recorder.write()
    path = recorder.files.paths[0]
    whole = path.stat().st_size
    recorder.write()
    recorder.write()
    content = bytearray(path.read_bytes())
    content[whole + 60] ^= 0xFF
    path.write_bytes(content)
    tail = Tail(path)
    numbers = read_once(tail)
    assert numbers == [*range(5), *range(10, 15)]
    assert "chunk" in tail.trouble
    path.unlink()
    assert read_once(tail) == []
    assert "is missing" in tail.trouble


def read_once(tail: Tail) -> list[int]:
    tail.step()
    chunks, _ = tail.step()
    return [n for chunk in chunks for part in chunk for n in part.sequence.tolist()]


def test_what_can_be_watched(tmp_path: Path) -> None:
    configuration = tmp_path / "flight.toml"
    link = '[[link]]\nname = "rover"\nprotocol = "ubx"\nurl = "udp://127.0.0.1:1"\n'
    configuration.write_text('[recording]\noutput = "logs"\nspare = ["spare"]\n' + link)
    tail = tail_of(configuration)
    # The folders may be made by the recorder later.
    assert read(tail) == []
    recorder = Recorder(tmp_path / "spare")
    recorder.write()
    assert read(tail) == list(range(5))
    (tmp_path / "text.txt").write_text("no log at all")
    with pytest.raises(InputMalformedError, match="not a flight log"):
        tail_of(tmp_path / "text.txt")
    with pytest.raises(InputNotFoundError, match="does not exist"):
        tail_of(tmp_path / "missing.mcap")
    configuration.write_text("[recording]\n")
    with pytest.raises(ConfigurationError):
        tail_of(configuration)


def test_a_recording_after_one_that_was_ended_is_a_flight_of_its_own(tmp_path: Path) -> None:
    """Alarms of the flight before are none of this one, however soon it begins."""
    first = Recorder(tmp_path)
    first.write(3)
    tail = Tail([tmp_path])
    assert read(tail) == [0, 1, 2]
    first.files.close()
    time.sleep(1.1)
    second = Recorder(tmp_path)
    second.write(2)
    assert read(tail) == [0, 1]
    assert tail.flight == second.files.paths[0].name
    late = Tail([tmp_path])
    assert read(late) == [0, 1]


@pytest.mark.parametrize("ended", [True, False], ids=["ended", "died"])
def test_a_recording_begun_after_the_clock_was_set_back_is_noticed(ended: bool, tmp_path: Path) -> None:
    """Its name is an earlier one; so is that of an old log brought to the folder, which has its end."""
    ahead = time.time() + 7200
    first = Recorder(tmp_path, clock_ns=lambda: round(ahead * SECOND))
    first.write(3)
    if ended:
        first.files.close()
    os.utime(first.files.paths[0], (ahead, ahead))
    tail = Tail([tmp_path])
    assert read(tail) == [0, 1, 2]
    copied = tmp_path / "flight-20200101T000000Z.mcap"
    with copied.open("wb") as stream:
        writer = LogWriter(stream)
        one = np.array([SECOND], np.int64)
        writer.messages(CHANNEL, [b"old"], one, one, np.array([99]))
        writer.close()
    assert read(tail) == []
    second = Recorder(tmp_path)
    second.write(2)
    assert second.files.paths[0].name < first.files.paths[0].name
    assert read(tail) == [0, 1]
    assert tail.flight == second.files.paths[0].name
    late = Tail([tmp_path])
    assert read(late) == [0, 1]
    assert late.flight == tail.flight

"""What a recorder writes again because a disk was pulled is read once, also where the first file has it."""

from __future__ import annotations

import errno
import functools
import io
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquire.log.chunk import Channel
from acquire.log.reader import LogReader
from acquire.monitor.tail import Tail, read_all
from acquire.recording.files import LogFiles
from acquire.recording.log_file import WholeWrites
from photocal.navigation.flight_log import FlightLog
from tests.acquire.live import until

CHANNEL = Channel("/rover/raw", "ubx")


class PulledDisk(WholeWrites):
    """Confirms nothing any more, and does not let go of what it took."""

    def make_safe(self) -> None:
        raise OSError(errno.EIO, "Input/output error")

    def cut(self, size: int) -> None:
        raise OSError(errno.EIO, f"Input/output error at {size}")


def frames(files: LogFiles, first: int, count: int = 20) -> None:
    numbers = np.arange(first, first + count)
    times = time.time_ns() + numbers
    files.messages(CHANNEL, [b"%d" % n for n in numbers.tolist()], times, times, numbers)
    files.end_chunk()


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    """Two files: frames 0 to 39 stand in both, 40 to 59 in the second."""
    made: list[Path] = []

    def make(path: Path) -> WholeWrites:
        made.append(path)
        return (PulledDisk if len(made) == 1 else WholeWrites)(io.FileIO(path, "x+b"))

    files = LogFiles([tmp_path], lambda _: None, time.time_ns, make)
    frames(files, 0)
    frames(files, 20)
    until(lambda: bool(files.make_safe()), "the failure of the disk")
    frames(files, 40)
    files.close()
    assert numbers_in(files.paths[0]) == list(range(40))
    assert numbers_in(files.paths[1]) == list(range(60))
    return files.paths


def numbers_in(path: Path) -> list[int]:
    return [n for chunk in LogReader(path).chunks() for part in chunk for n in part.sequence.tolist()]


def of_flight(paths: list[Path]) -> int:
    read = FlightLog(tuple(paths))._messages
    return sum(len(messages.payloads) for messages in read)


def of_monitor(paths: list[Path]) -> int:
    return read_all(Tail([paths[0].parent])).links["rover"].frames


@pytest.mark.parametrize("count", [of_flight, of_monitor])
def test_frames_that_stand_in_two_files_of_a_recording_count_once(
    count: Callable[[list[Path]], int], logs: list[Path]
) -> None:
    assert count(logs) == 60


def test_alike_frames_of_two_recordings_are_two(tmp_path: Path) -> None:
    """Numbers begin anew with each recording; what decides is the file's own word of where it belongs."""
    numbers, paths = np.arange(20), list[Path]()
    for second in (1_700_000_000, 1_700_000_100):
        files = LogFiles([tmp_path], lambda _: None, functools.partial(int, second * 1_000_000_000))
        files.messages(CHANNEL, [b"%d" % n for n in numbers.tolist()], numbers + 5, numbers + 5, numbers)
        files.close()
        paths += files.paths
    assert of_flight(paths) == 40

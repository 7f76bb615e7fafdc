"""Disks that fill up, fail or are changed: what was taken is in one file or the next."""

from __future__ import annotations

import errno
import io
import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from acquire.importing.recovery import recover
from acquire.log.chunk import Channel, Schema
from acquire.log.reader import LogReader
from acquire.log.writer import LogWriter
from acquire.recording.files import LogFiles, worth
from acquire.recording.log_file import WholeWrites
from photocal.base.errors import InputMalformedError, OutputError
from tests.acquire.live import until
from tests.acquire.scripted import messages


class _SmallDisk(WholeWrites):
    """A disk with little room, shared by all files in a folder; it refuses what is too much."""

    def __init__(
        self, file: io.FileIO, room: dict[Path, int], folder: Path, code: int = errno.ENOSPC
    ) -> None:
        super().__init__(file)
        self._room, self._folder, self._code = room, folder, code

    def write(self, data: bytes) -> int:  # type: ignore[override]
        if self._room.get(self._folder, 1 << 40) < len(data):
            raise OSError(self._code, os.strerror(self._code))
        self._room[self._folder] = self._room.get(self._folder, 1 << 40) - len(data)
        return super().write(data)


def _fill(files: LogFiles, count: int) -> list[bytes]:
    chance = np.random.default_rng(5)
    sent = []
    for number in range(count):
        payload = chance.bytes(300)
        one = np.array([number], np.int64)
        files.messages(Channel("/rover/raw", "ubx"), [payload], one, one, one)
        sent.append(payload)
        files.make_safe()
    return sent


def _kept(paths: list[Path], folder: Path) -> list[bytes]:
    found = []
    for number, path in enumerate(paths):
        fixed = folder / f"fixed-{number}.mcap"
        # The first file of a disk that failed at once has nothing to save.
        with suppress(InputMalformedError):
            recover(path, fixed)
            found += messages(fixed, "/rover/raw")
    return found


def _readable(path: Path, topic: str) -> list[bytes]:
    """Return the messages of a topic in a log as it is, with an end or without."""
    parts = [part for chunk in LogReader(path).chunks() for part in chunk if part.channel.topic == topic]
    return [payload for part in parts for payload in part.payloads]


def _nothing(writer: LogWriter) -> None:
    writer.metadata("site", {"operator": "A. Surveyor"})


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENODEV])
def test_a_full_disk_sends_the_recording_to_the_spare_folder(code: int, tmp_path: Path) -> None:
    """Also one over a quota, one that became read-only, one that fails and one that was pulled."""
    first, spare = tmp_path / "first", tmp_path / "spare"
    room = {first: 5000}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent, code)

    files = LogFiles([first, spare], _nothing, time.time_ns, make)
    sent = _fill(files, 40)
    files.close()
    assert [path.parent for path in files.paths] == [first, spare]
    assert _kept(files.paths, tmp_path) == sent


def test_when_every_disk_is_full_what_was_written_is_safe(tmp_path: Path) -> None:
    room = {tmp_path: 5000}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent)

    files = LogFiles([tmp_path], _nothing, time.time_ns, make)
    sent = _fill(files, 40)
    with pytest.raises(OutputError, match="what was written is safe"):
        files.close()
    kept = _kept(files.paths, tmp_path)
    assert len(kept) > 5
    assert kept == sent[: len(kept)]


def test_when_a_full_disk_has_room_again_nothing_is_lost(tmp_path: Path) -> None:
    room, clock = {tmp_path: 5000}, {"ns": 1_777_626_000_000_000_000}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent)

    files = LogFiles([tmp_path], _nothing, lambda: clock["ns"], make, lambda: clock["ns"] / 1e9)
    sent = _fill(files, 20)
    told = []
    for second in range(12):
        clock["ns"] += 1_000_000_000
        told += files.make_safe()
        if second == 7:
            assert told == []
            room[tmp_path] = 1 << 20
    sent += _fill(files, 5)
    told += files.close()
    # The clock of this test runs faster than any disk.
    assert [text for kind, text in told if kind != "disk_slow"] == [
        f"disk space is free again, recording continues in {files.paths[1]}"
    ]
    assert len(files.paths) == 2
    assert sorted(_kept(files.paths, tmp_path)) == sorted(sent)


def test_a_disk_that_fails_later_sends_the_recording_to_the_next_file(tmp_path: Path) -> None:
    """What a disk took may still fail on its way to the platter: fsync tells, after the writing."""
    made: list[Path] = []

    class FailsOnce(WholeWrites):
        def make_safe(self) -> None:
            if len(made) == 1:
                raise OSError(errno.EIO, "Input/output error")
            super().make_safe()

    def make(path: Path) -> WholeWrites:
        made.append(path)
        return FailsOnce(io.FileIO(path, "xb"))

    files = LogFiles([tmp_path], _nothing, time.time_ns, make)
    sent = _fill(files, 1)
    told: list[tuple[str, str]] = []

    def failed() -> bool:
        told.extend(files.make_safe())
        return bool(told)

    until(failed, "the failure of the disk")
    sent += _fill(files, 3)
    files.close()
    assert [kind for kind, _ in told] == ["disk_full"]
    assert "input/output error" in told[0][1]
    assert len(files.paths) == 2
    assert sorted(_kept(files.paths, tmp_path)) == sorted(sent)


def test_a_full_memory_keeps_camera_events_and_receivers_longest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recording goes on, tells what is left out, and has all of the rest when there is room again."""
    monkeypatch.setattr("acquire.recording.files.HELD_BYTES", 200_000)
    room, clock = {tmp_path: 3000}, {"s": 0.0}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent)

    files = LogFiles([tmp_path], _nothing, time.time_ns, make, lambda: clock["s"])
    chance = np.random.default_rng(6)
    schema = Schema("photocal.Any", "jsonschema", b"{}")
    channels = {
        "camera": Channel("/camera/exposure", "json", schema),
        "receiver": Channel("/rover/raw", "ubx"),
        "vehicle": Channel("/vehicle/raw", "mavlink"),
        "decoded": Channel("/vehicle/attitude", "json", schema),
    }
    sent: dict[str, list[bytes]] = {name: [] for name in channels}
    told: list[tuple[str, str]] = []
    for number in range(290):
        for name, channel in channels.items():
            payload = chance.bytes(20 if name == "camera" else 300)
            one = np.array([number], np.int64)
            files.messages(channel, [payload], one, one, one)
            sent[name].append(payload)
        told += files.make_safe()
        assert files.held_bytes < 201_000
    room[tmp_path] = 1 << 20
    clock["s"] += 10.0
    told += [*files.make_safe(), *files.close()]
    kept = {
        name: [payload for path in files.paths for payload in _readable(path, channel.topic)]
        for name, channel in channels.items()
    }
    assert all(kept[name] == sent[name][: len(kept[name])] for name in channels)
    assert kept["camera"] == sent["camera"]
    assert 20 < len(kept["decoded"]) < len(kept["vehicle"]) < len(kept["receiver"]) < 290
    for name, channel in channels.items():
        words = worth(channel)
        lost = len(sent[name]) - len(kept[name])
        assert any(f"not kept: {lost} {words}" in text for _, text in told) == (lost > 0)


def test_a_disk_that_hangs_sends_the_recording_to_the_next_folder(tmp_path: Path) -> None:
    """What it had not confirmed is written again; it is told at once that a power cut would cost it."""
    hangs, clock = threading.Event(), {"s": 0.0}

    class Hanging(WholeWrites):
        def make_safe(self) -> None:
            if self.path.parent.name == "card":
                hangs.wait(60)
            super().make_safe()

    def make(path: Path) -> WholeWrites:
        return Hanging(io.FileIO(path, "x+b"))

    folders = [tmp_path / "card", tmp_path / "spare"]
    files = LogFiles(folders, _nothing, time.time_ns, make, lambda: clock["s"])
    sent, told = [], []
    for number in range(30):
        one = np.array([number], np.int64)
        sent.append(number.to_bytes(4, "little"))
        files.messages(Channel("/rover/raw", "ubx"), sent[-1:], one, one, one)
        clock["s"] += 0.5
        told += files.make_safe()
        if len(files.paths) == 2:
            break
    assert _readable(files.paths[1], "/rover/raw") == sent
    hangs.set()
    told += files.close()
    assert [kind for kind, _ in told][:2] == ["disk_slow", "disk_full"]
    assert "not confirmed a write for 1.5 s" in told[0][1]
    assert "no answer for 8 s" in told[1][1]
    # Once only, however the disk went on.
    assert _kept(files.paths, tmp_path) == sent


def test_files_rotate_and_each_stands_for_itself(tmp_path: Path) -> None:
    files = LogFiles([tmp_path], _nothing, time.time_ns, most_bytes=4000)
    sent = _fill(files, 40)
    files.close()
    assert len(files.paths) >= 4
    kept = []
    for path in files.paths:
        kept += messages(path, "/rover/raw")
        with path.open("rb") as stream:
            notes = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
        assert notes["site"] == {"operator": "A. Surveyor"}
    assert kept == sent

"""A log that somebody deletes, moves or replaces while it is written costs no frame."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from acquire.log.chunk import MAGIC
from tests.acquire.live import Process, frames_in, until
from tests.acquire.recording.undisturbed import GoodLink, configured


def delete_file(logs: Path) -> None:
    next(logs.iterdir()).unlink()


def move_folder(logs: Path) -> None:
    logs.rename(logs.parent / "kept")


def replace_file(logs: Path) -> None:
    log = next(logs.iterdir())
    log.unlink()
    log.write_bytes(b"something else")


@pytest.mark.parametrize("clean_up", [delete_file, shutil.rmtree, move_folder, replace_file])
def test_a_log_that_is_deleted_or_moved_is_told_and_nothing_is_lost(
    clean_up: Callable[[Path], None], tmp_path: Path
) -> None:
    path, port = configured(tmp_path)
    with Process([sys.executable, "-m", "acquire", "record", str(path), "--json"]) as recorder:
        with GoodLink(port) as good:
            until(lambda: frames_in(tmp_path / "logs", "good"), "the first frames")
            clean_up(tmp_path / "logs")
            recorder.line("recording continues in ")
            time.sleep(0.2)
        figures = json.loads(recorder.end())
    assert recorder.process.returncode == 0
    assert "file_gone" in {alarm["kind"] for alarm in figures["alarms"]}
    named = [Path(file) for file in figures["files"]]
    assert all(file.is_file() for file in named)
    assert len(named) == 2
    told = {frame for file in named for frame in frames_in(file, "good")}
    assert told == {frame for _, frame in good.sent}
    assert all(file.read_bytes().endswith(MAGIC) for file in named)


def test_a_log_that_is_deleted_loses_nothing_that_is_due_at_a_kill(tmp_path: Path) -> None:
    path, port = configured(tmp_path)
    command = [sys.executable, "-m", "acquire", "record", str(path)]
    with Process(command) as recorder, GoodLink(port) as good:
        until(lambda: frames_in(tmp_path / "logs", "good"), "the first frames")
        shutil.rmtree(tmp_path / "logs")
        recorder.line("is saved in ")
        time.sleep(1.5)
        recorder.process.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0

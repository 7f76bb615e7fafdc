"""`acquire monitor` at the command line."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from acquire.importing.importer import import_recordings
from tests.acquire.live import PATIENCE_S

Acquire = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, demo_flight: bytes) -> Path:
    folder = tmp_path_factory.mktemp("command")
    source, made = folder / "flight.tlog", folder / "flight.mcap"
    source.write_bytes(demo_flight)
    import_recordings([], [source], made, lambda _: None)
    return made


def test_json_prints_the_state_once(acquire: Acquire, log: Path) -> None:
    done = acquire("monitor", log, "--json")
    assert done.returncode == 0, done.stderr
    state = json.loads(done.stdout)
    assert state["schema"] == "acquire.monitor/1"
    assert state["recording"] == {"text": "ended", "level": "off"}
    info = json.loads(acquire("info", log, "--json").stdout)["links"][0]
    (link,) = state["links"]
    assert (link["frames"], link["gaps"]) == (info["frames"], info["gaps"]["count"])
    assert link["longest_gap_s"] == pytest.approx(info["gaps"]["longest_s"])
    assert state["duration_s"] == pytest.approx(info["duration_s"])


def test_into_a_pipe_the_view_is_printed_once(acquire: Acquire, log: Path) -> None:
    done = acquire("monitor", log)
    assert done.returncode == 0, done.stderr
    assert "RTK fixed" in done.stdout
    assert "\x1b" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["missing.mcap"], 3, "does not exist"),
        ([__file__], 4, "not a flight log"),
        (["--page", "--address", "here", "."], 5, "HOST:PORT"),
        (["--page", "--address", "192.0.2.1:0", "."], 5, "cannot be used for listening"),
    ],
)
def test_what_cannot_be_meant_is_one_line(
    acquire: Acquire, arguments: list[str], code: int, word: str
) -> None:
    done = acquire("monitor", *arguments)
    assert (done.returncode, done.stderr.count("\n")) == (code, 1), done.stderr
    assert word in done.stderr


def test_in_a_terminal_it_is_live_and_leaves_a_clean_screen(log: Path) -> None:
    ours, theirs = pytest.importorskip("pty", reason="Windows has no such terminals").openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    process = subprocess.Popen(
        [sys.executable, "-m", "acquire", "monitor", str(log)],
        stdin=theirs, stdout=theirs, stderr=theirs, env=environment,
    )  # fmt: skip
    os.close(theirs)
    shown = b""
    end = time.monotonic() + PATIENCE_S
    while b"RTK fixed" not in shown and time.monotonic() < end:
        if select.select([ours], [], [], 1)[0]:
            shown += os.read(ours, 65536)
    assert b"\x1b[?1049h" in shown
    process.send_signal(signal.SIGINT)
    while select.select([ours], [], [], PATIENCE_S)[0]:
        # The end of the last program that had it open is the end of a terminal.
        try:
            piece = os.read(ours, 65536)
        except OSError:
            break
        shown += piece
    assert process.wait(PATIENCE_S) == 0
    os.close(ours)
    # The other screen was left, and the cursor is there again.
    assert shown.rindex(b"\x1b[?1049l") > shown.rindex(b"\x1b[?1049h")
    assert b"Traceback" not in shown

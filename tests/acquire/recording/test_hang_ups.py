"""A hang-up of the terminal is a stop, unless the recorder shall outlive it."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acquire.live import Process, is_bound, until
from tests.acquire.recording.undisturbed import OUTPUTS, Output, configured, stops_in_time


@pytest.fixture(autouse=True)
def _hang_ups_are_heard() -> Iterator[None]:
    """Programs that are started inherit what is ignored, also where the tests themselves run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("output", OUTPUTS)
def test_a_hang_up_is_a_stop_that_waits_for_no_output(output: Output, tmp_path: Path) -> None:
    stops_in_time(output, signal.SIGHUP, tmp_path)


def test_a_recorder_that_shall_outlive_its_terminal_does(tmp_path: Path) -> None:
    """By nohup a hang-up is ignored from the start."""
    path, port = configured(tmp_path)
    ignored = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    program = f"{ignored}; from acquire.commands.cli import main; main()"
    with Process([sys.executable, "-c", program, "record", str(path)]) as recorder:
        until(lambda: is_bound(port), "the port")
        recorder.process.send_signal(signal.SIGHUP)
        time.sleep(0.5)
        assert recorder.process.poll() is None

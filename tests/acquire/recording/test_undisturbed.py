"""Outputs and devices that take nothing cost the log nothing that is due at a kill."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from drivers import rtcm3
from tests.acquire.live import Process, free_port, is_bound, until
from tests.acquire.recording.undisturbed import (
    OUTPUTS,
    GoodLink,
    Output,
    configured,
    recording,
    with_a_mute_link,
)


@pytest.mark.parametrize("output", OUTPUTS)
def test_an_output_that_takes_nothing_costs_no_frame_at_a_kill(output: Output, tmp_path: Path) -> None:
    path, port = with_a_mute_link(tmp_path)
    with (
        output() as end,
        recording(path, "--json", stdout=end, stderr=end) as recorder,
        GoodLink(port) as good,
    ):
        time.sleep(2.5)
        assert recorder.poll() is None
        recorder.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0


def corrections(base: int, every_s: float, ended: threading.Event) -> None:
    frame = rtcm3.encode(b"\x43\x50" + bytes(792))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        while not ended.wait(every_s):
            line.sendto(frame, ("127.0.0.1", base))


@contextlib.contextmanager
def terminal_nobody_reads() -> Iterator[str]:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield f"serial:{os.ttyname(theirs)}"
    for end in (ours, theirs):
        os.close(end)


@contextlib.contextmanager
def server_that_never_reads() -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.parametrize(
    ("device", "every_s"), [(terminal_nobody_reads, 0.05), (server_that_never_reads, 0.0005)]
)
def test_a_device_that_takes_nothing_costs_the_other_links_nothing(
    device: Callable[[], contextlib.AbstractContextManager[str]], every_s: float, tmp_path: Path
) -> None:
    base, ended = free_port(), threading.Event()
    with device() as url, ExitStack() as stack:
        path, port = configured(
            tmp_path,
            ("rover", "ubx", url, "silent_s = 600"),
            ("base", "rtcm3", f"udp://127.0.0.1:{base}", 'silent_s = 600\ncorrections_to = ["rover"]'),
        )
        command = [sys.executable, "-m", "acquire", "record", str(path)]
        recorder = stack.enter_context(Process(command))
        good = stack.enter_context(GoodLink(port))
        until(lambda: is_bound(base), "the port of the base")
        sender = threading.Thread(target=corrections, args=(base, every_s, ended))
        stack.callback(sender.join)
        stack.callback(ended.set)
        sender.start()
        recorder.line("rover does not accept the data sent to it")
        time.sleep(2.0)
        recorder.process.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0
    alarms = [line for line in recorder.told if "does not accept the data sent to it" in line]
    assert len(alarms) == 1

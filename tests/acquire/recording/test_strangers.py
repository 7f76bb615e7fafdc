"""Strangers at the ports cost the log nothing."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as tables

from drivers import rtcm3
from tests.acquire.live import Process, free_port, is_bound, until
from tests.acquire.recording.undisturbed import GoodLink, configured, recording


def test_a_stranger_does_not_take_the_ear_of_the_vehicle(tmp_path: Path) -> None:
    """A byte from elsewhere after each frame: answers and corrections go on to the vehicle, all of them."""
    vehicle, base = free_port(), free_port()
    path, _ = configured(
        tmp_path,
        (
            "vehicle",
            "mavlink",
            f"udp://127.0.0.1:{vehicle}",
            "silent_s = 600\n[link.vehicle]\ntimesync_s = 0.1",
        ),
        ("base", "rtcm3", f"udp://127.0.0.1:{base}", 'silent_s = 600\ncorrections_to = ["vehicle"]'),
    )
    mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
    correction = rtcm3.encode(b"\x43\x50" + bytes(100))
    with ExitStack() as stack:
        stack.enter_context(recording(path, stderr=subprocess.DEVNULL))
        ours, stranger, caster = (
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(3)
        )
        for line in (ours, stranger):
            line.setblocking(False)
        until(lambda: is_bound(vehicle) and is_bound(base), "the ports")
        heard: dict[str, int] = {}
        for _ in range(100):
            ours.sendto(tables.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(mav), ("127.0.0.1", vehicle))
            stranger.sendto(b"x", ("127.0.0.1", vehicle))
            caster.sendto(correction, ("127.0.0.1", base))
            time.sleep(0.02)
            with contextlib.suppress(BlockingIOError):
                while True:
                    for message in mav.parse_buffer(ours.recv(4096)) or ():
                        heard[message.get_type()] = heard.get(message.get_type(), 0) + 1
        with pytest.raises(BlockingIOError):
            stranger.recv(4096)
    assert heard["TIMESYNC"] > 10
    assert heard["GPS_RTCM_DATA"] > 80


SENDERS = """
import socket, sys, time
lines = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
piece = bytes.fromhex(sys.argv[3])
begin, sent = time.monotonic(), 0
while True:
    for line in lines:
        line.sendto(piece, ("127.0.0.1", int(sys.argv[1])))
    sent += 2
    ahead = begin + sent / float(sys.argv[2]) - time.monotonic()
    if ahead > 0.001:
        time.sleep(ahead)
"""


def memory_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_two_senders_at_one_port_are_told_once_and_cost_nothing(tmp_path: Path) -> None:
    shared = free_port()
    path, port = configured(tmp_path, ("shared", "ubx", f"udp://127.0.0.1:{shared}", "silent_s = 600"))
    with ExitStack() as stack:
        recorder = stack.enter_context(Process([sys.executable, "-m", "acquire", "record", str(path)]))
        good = stack.enter_context(GoodLink(port))
        until(lambda: is_bound(shared), "the shared port")
        arguments = [str(shared), "40000", good.sent[0][1].hex() if good.sent else "b562"]
        senders = stack.enter_context(subprocess.Popen([sys.executable, "-c", SENDERS, *arguments]))
        stack.callback(senders.kill)
        time.sleep(3.0)
        early_mb = memory_mb(recorder.process.pid)
        time.sleep(4.0)
        grown_mb = memory_mb(recorder.process.pid) - early_mb
        recorder.process.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0
    moves = [line for line in recorder.told if "come from another address" in line]
    assert len(moves) == 1
    # It was 12 MB a second.
    assert grown_mb < 20

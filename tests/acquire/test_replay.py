"""Replay to programs of others and to plain sockets and terminals."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pymavlink import mavutil

from acquire.importing.importer import import_recordings
from acquire.log.replay import replay
from acquire.transports.sinks import MemorySink

Acquire = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, demo_flight: bytes) -> Path:
    folder = tmp_path_factory.mktemp("replay")
    source, made = folder / "flight.tlog", folder / "flight.mcap"
    source.write_bytes(demo_flight)
    import_recordings([], [source], made, lambda _: None)
    return made


def frames_of(data: bytes) -> list[bytes]:
    found, at = [], 0
    while at < len(data):
        end = at + 8 + data[at + 9] + 12
        found.append(data[at + 8 : end])
        at = end
    return found


@pytest.fixture
def start(log: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    running: list[subprocess.Popen[str]] = []

    def run(*arguments: object) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "acquire.cli", "replay", str(log), *map(str, arguments)]
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return running[-1]

    yield run
    for process in running:
        process.kill()
        process.communicate()


def address(process: subprocess.Popen[str]) -> str:
    assert process.stderr is not None
    return process.stderr.readline().split(" to ")[1].strip()


def test_the_frames_keep_their_order_and_their_pace(log: Path, demo_flight: bytes) -> None:
    now = [100.0]
    sink = MemorySink()
    result = replay(log, "vehicle", sink, 4.0, lambda: now[0], lambda s: now.__setitem__(0, now[0] + s))
    assert sink.frames == frames_of(demo_flight)
    assert now[0] - 100.0 == pytest.approx(result.recorded_s / 4, rel=1e-6)
    assert result.recorded_s == pytest.approx(59.75)


def test_a_tcp_reader_gets_the_stream_byte_for_byte(
    start: Callable[..., subprocess.Popen[str]], demo_flight: bytes
) -> None:
    process = start("--to", "tcp://127.0.0.1:0", "--speed", "0")
    host, port = address(process).removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), timeout=20) as reader:
        received = b""
        while piece := reader.recv(65536):
            received += piece
    assert received == b"".join(frames_of(demo_flight))
    assert process.wait(20) == 0


def test_a_terminal_reader_gets_the_stream_byte_for_byte(
    start: Callable[..., subprocess.Popen[str]], demo_flight: bytes
) -> None:
    process = start("--to", "pty", "--speed", "0")
    expected = b"".join(frames_of(demo_flight))
    port = os.open(address(process), os.O_RDONLY | os.O_NOCTTY)
    received = b""
    while len(received) < len(expected):
        received += os.read(port, 65536)
    os.close(port)
    assert received == expected


def test_pymavlink_sees_every_message_over_udp(
    start: Callable[..., subprocess.Popen[str]], demo_flight: bytes
) -> None:
    ground = mavutil.mavlink_connection("udpin:127.0.0.1:0")
    # pymavlink keeps the port that the system chose.
    port = ground.port.getsockname()[1]
    process = start("--to", f"udp://127.0.0.1:{port}", "--speed", "60")
    seen: Counter[str] = Counter()
    until = time.monotonic() + 20
    while sum(seen.values()) < 810 and time.monotonic() < until:
        message = ground.recv_match(blocking=True, timeout=1)
        if message is not None:
            seen[message.get_type()] += 1
    ground.close()
    assert process.wait(20) == 0
    assert sum(seen.values()) == len(frames_of(demo_flight))
    assert seen["ATTITUDE"] == 240
    assert "BAD_DATA" not in seen


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--to", "carrier-pigeon"], 5),
        (["--to", "udp://nowhere"], 5),
        (["--to", "udp://127.0.0.1:99999"], 5),
        (["--to", "pty", "--link", "rover"], 5),
        (["--to", "tcp://203.0.113.1:5000"], 10),
    ],
)
def test_addresses_that_cannot_be_meant(arguments: list[str], code: int, acquire: Acquire, log: Path) -> None:
    done = acquire("replay", log, *arguments)
    assert done.returncode == code, done.stderr
    assert done.stderr.count("\n") == 1

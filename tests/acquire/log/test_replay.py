"""Replay to programs of others and to plain sockets and terminals."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymavlink import mavutil

from acquire.importing.importer import import_recordings
from acquire.log.replay import replay
from acquire.transports.sinks import open_sink
from tests.acquire.live import PATIENCE_S, Process, Recorder, await_frame, frames_in

Acquire = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, demo_flight: bytes) -> Path:
    folder = tmp_path_factory.mktemp("replay")
    source, made = folder / "flight.tlog", folder / "flight.mcap"
    source.write_bytes(demo_flight)
    import_recordings([], [source], made, lambda _: None)
    return made


class MemorySink:
    """Keeps the frames: the twin of a sink."""

    lost = 0

    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def send(self, frame: bytes) -> None:
        """Keep one frame."""
        self.frames.append(frame)


def frames_of(data: bytes) -> list[bytes]:
    found, at = [], 0
    while at < len(data):
        end = at + 8 + data[at + 9] + 12
        found.append(data[at + 8 : end])
        at = end
    return found


@pytest.fixture
def start(log: Path) -> Iterator[Callable[..., Process]]:
    with ExitStack() as running:

        def run(*arguments: object) -> Process:
            command = [sys.executable, "-m", "acquire", "replay", str(log), *map(str, arguments)]
            return running.enter_context(Process(command))

        yield run


def address(process: Process) -> str:
    return process.line(" to ").split(" to ")[1]


def test_the_frames_keep_their_order_and_their_pace(log: Path, demo_flight: bytes) -> None:
    now = [100.0]
    sink = MemorySink()
    result = replay(log, "vehicle", sink, 4.0, lambda: now[0], lambda s: now.__setitem__(0, now[0] + s))
    assert sink.frames == frames_of(demo_flight)
    assert now[0] - 100.0 == pytest.approx(result["recorded_s"] / 4, rel=1e-6)
    assert result["recorded_s"] == pytest.approx(59.75)


def test_a_tcp_reader_gets_the_stream_byte_for_byte(
    start: Callable[..., Process], demo_flight: bytes
) -> None:
    process = start("--to", "tcp://127.0.0.1:0", "--speed", "0")
    host, port = address(process).removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as reader:
        received = b""
        while piece := reader.recv(65536):
            received += piece
    assert received == b"".join(frames_of(demo_flight))
    process.ended()
    assert process.process.returncode == 0


def test_a_terminal_reader_gets_the_stream_byte_for_byte(
    start: Callable[..., Process], demo_flight: bytes
) -> None:
    process = start("--to", "pty", "--speed", "0")
    expected = b"".join(frames_of(demo_flight))
    port = os.open(address(process), os.O_RDONLY | os.O_NOCTTY)
    received = b""
    while len(received) < len(expected):
        received += os.read(port, 65536)
    os.close(port)
    assert received == expected


@pytest.mark.parametrize("to", ["tcp://127.0.0.1:0", "pty"])
def test_recording_a_replay_gives_the_same_frames_in_the_same_order(
    to: str, start: Callable[..., Process], log: Path, tmp_path: Path
) -> None:
    there = address(start("--to", to, "--speed", "0"))
    configuration = tmp_path / "flight.toml"
    configuration.write_text(
        '[recording]\noutput = "logs"\nflush_s = 0.1\n[[link]]\nname = "again"\nprotocol = "mavlink"\n'
        f'url = "{there if "://" in there else f"serial:{there}"}"\n'
    )
    sent = frames_in(log, "vehicle")
    with Recorder(configuration) as recorder:
        await_frame(recorder.path, "again", sent[-1])
        recorder.figures()
    assert frames_in(recorder.path, "again") == sent


def test_pymavlink_sees_every_message_over_udp(log: Path, demo_flight: bytes) -> None:
    ground = mavutil.mavlink_connection("udpin:127.0.0.1:0")
    # pymavlink keeps the port that the system chose.
    port = ground.port.getsockname()[1]
    seen: Counter[str] = Counter()

    def play() -> None:
        with open_sink(f"udp://127.0.0.1:{port}") as (sink, _):
            replay(log, "vehicle", sink, 60.0, time.monotonic, time.sleep)

    sender = threading.Thread(target=play)
    sender.start()
    expected = len(frames_of(demo_flight))
    end = time.monotonic() + PATIENCE_S
    while seen.total() < expected and time.monotonic() < end:
        message = ground.recv_match(blocking=True, timeout=1)
        if message is not None:
            seen[message.get_type()] += 1
    sender.join()
    ground.close()
    assert seen.total() == expected
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


@pytest.mark.parametrize("speed", [20.0, 0.0])
def test_a_reader_that_is_slow_gets_every_datagram(speed: float, tmp_path: Path, demo_flight: bytes) -> None:
    """Ten thousand datagrams, many times what its socket holds; it looks away for a while again and again."""
    source, log = tmp_path / "long.tlog", tmp_path / "long.mcap"
    source.write_bytes(demo_flight * 12)
    import_recordings([], [source], log, lambda _: None)
    expected = frames_in(log, "vehicle")
    got: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reader:
        reader.bind(("127.0.0.1", 0))
        reader.settimeout(PATIENCE_S)

        def read() -> None:
            while len(got) < len(expected):
                if len(got) % 1000 == 0:
                    time.sleep(0.05)
                got.append(reader.recv(65536))

        reading = threading.Thread(target=read)
        reading.start()
        with open_sink(f"udp://127.0.0.1:{reader.getsockname()[1]}") as (sink, _):
            clock = itertools.count()
            sent = replay(log, "vehicle", sink, speed, lambda: float(next(clock)), lambda _: None)
        reading.join()
    assert got == expected
    assert sent["lost"] == 0


def test_datagrams_that_no_reader_got_are_numbered() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reader:
        reader.bind(("127.0.0.1", 0))
        port = reader.getsockname()[1]
        with open_sink(f"udp://127.0.0.1:{port}") as (sink, _):
            for _ in range(10):
                sink.send(b"read")
            assert sink.lost == 0
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                # Somebody else fills the socket: what is lost then is not the replay's alone, but it is told.
                for _ in range(3000):
                    other.sendto(bytes(100), ("127.0.0.1", port))
            held = 0
            reader.settimeout(0.01)
            with contextlib.suppress(TimeoutError):
                while reader.recv(100):
                    held += 1
            assert sink.lost == 3010 - held
            reader.close()
            for _ in range(7):
                sink.send(b"nobody")
            assert sink.lost == 3010 - held + 7

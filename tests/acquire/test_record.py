"""Recording from live ports: what was sent is in the log, whatever happens to links and process."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue

import pytest
from mcap.reader import make_reader

from acquire.log.recovery import recover
from acquire.recording.reader import Arrival, read_link
from acquire.transports.sources import LinkLostError
from drivers.ubx import wire as ubx

Acquire = Callable[..., subprocess.CompletedProcess[str]]
Start = Callable[[str], tuple[subprocess.Popen[str], Path]]
SITE = '[site]\noperator = "A. Surveyor"\n'


def raw(path: Path, link: str) -> list[bytes]:
    with path.open("rb") as stream:
        found = [
            (m.sequence, m.data)
            for _, channel, m in make_reader(stream, validate_crcs=True).iter_messages()
            if channel.topic == f"/{link}/raw"
        ]
    return [data for _, data in sorted(found)]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    running = []

    def run(links: str) -> tuple[subprocess.Popen[str], Path]:
        configuration = tmp_path / "flight.toml"
        configuration.write_text('[recording]\noutput = "logs"\n' + links + SITE)
        command = [sys.executable, "-m", "acquire.cli", "record", str(configuration), "--json"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        running.append(process)
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("recording to "), line + process.stderr.read()
        return process, Path(line.removeprefix("recording to ").strip())

    yield run
    for process in running:
        process.kill()
        process.communicate()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def link(name: str, protocol: str, url: str) -> str:
    return f'[[link]]\nname = "{name}"\nprotocol = "{protocol}"\nurl = "{url}"\n'


def frames_of(data: bytes) -> list[bytes]:
    found, at = [], 0
    while at < len(data):
        end = at + 8 + data[at + 9] + 12
        found.append(data[at + 8 : end])
        at = end
    return found


def numbered(number: int, size: int = 100) -> bytes:
    return ubx.encode(0x0213, number.to_bytes(4, "little") + bytes(size))


def test_links_of_several_kinds_are_recorded_and_closed_properly(start: Start, demo_flight: bytes) -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    server = socket.create_server(("127.0.0.1", 0))
    port = free_port()
    process, path = start(
        link("vehicle", "mavlink", f"udp://127.0.0.1:{port}")
        + link("rover", "ubx", f"serial:{os.ttyname(theirs)}")
        + link("base", "rtcm3", f"tcp://127.0.0.1:{server.getsockname()[1]}")
    )
    connection, _ = server.accept()
    time.sleep(0.7)
    sent = frames_of(demo_flight)[:200]
    rover = [numbered(n) for n in range(50)]
    base = [numbered(n, 7) for n in range(50)]
    first, second = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for number, frame in enumerate(sent):
        # The sender changes its port on the way.
        (first if number < 100 else second).sendto(frame, ("127.0.0.1", port))
        if number < 50:
            os.write(ours, rover[number])
            connection.sendall(base[number])
        time.sleep(0.001)
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=20)
    assert process.returncode == 0, errors
    figures = {entry["link"]: entry["frames"] for entry in json.loads(output)["links"]}
    assert figures == {"vehicle": 200, "rover": 50, "base": 50}
    assert raw(path, "vehicle") == sent
    assert raw(path, "rover") == rover
    assert raw(path, "base") == base
    with path.open("rb") as stream:
        notes = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert notes["site"] == {"operator": "A. Surveyor"}
    for port_or_socket in (first, second, connection, server):
        port_or_socket.close()
    os.close(ours)
    os.close(theirs)


def test_what_was_sent_a_second_before_a_kill_survives(start: Start, tmp_path: Path) -> None:
    """20 kB/s and kill -9 at a random moment: at most the last second is lost, the rest is byte for byte."""
    chance = random.Random(4)  # noqa: S311 - moments, not secrets
    for round_ in range(3):
        port = free_port()
        process, path = start(link("rover", "ubx", f"udp://127.0.0.1:{port}"))
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        time.sleep(0.8)
        sent: list[tuple[float, bytes]] = []
        end = time.monotonic() + 1.5 + chance.random()
        while time.monotonic() < end:
            frame = numbered(len(sent), 188)
            sender.sendto(frame, ("127.0.0.1", port))
            sent.append((time.monotonic(), frame))
            time.sleep(0.01)
        killed = time.monotonic()
        process.kill()
        process.communicate()
        sender.close()
        fixed = tmp_path / f"fixed-{round_}.mcap"
        recover(path, fixed)
        kept = raw(fixed, "rover")
        assert kept == [frame for _, frame in sent[: len(kept)]]
        assert all(moment > killed - 1.0 for moment, _ in sent[len(kept) :])


def test_a_file_that_cannot_grow_is_followed_by_the_next_and_nothing_is_lost(tmp_path: Path) -> None:
    """A limit on the size of files stands for a full disk: each write beyond it fails on the way."""
    port = free_port()
    configuration = tmp_path / "flight.toml"
    configuration.write_text(
        '[recording]\noutput = "logs"\nflush_s = 0.1\n' + link("rover", "ubx", f"udp://127.0.0.1:{port}")
    )
    limited = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000));"
        "from acquire.cli import main; main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", limited, "record", str(configuration), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    assert process.stderr.readline().startswith("recording to ")
    time.sleep(0.5)
    chance = random.Random(1)  # noqa: S311 - filling, not secrets
    sent = [ubx.encode(0x0213, chance.randbytes(400)) for _ in range(500)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for frame in sent:
            sender.sendto(frame, ("127.0.0.1", port))
            time.sleep(0.003)
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=20)
    assert process.returncode == 0, errors
    figures = json.loads(output)
    assert len(figures["files"]) >= 4
    assert {alarm["kind"] for alarm in figures["alarms"]} == {"disk_full"}
    kept = []
    for number, path in enumerate(map(Path, figures["files"])):
        fixed = tmp_path / f"fixed-{number}.mcap"
        recover(path, fixed)
        kept += raw(fixed, "rover")
    assert kept == sent


class FlakySource:
    """The twin of a port that vanishes and returns."""

    peer = ""

    def __init__(self, script: list[bytes | None]) -> None:
        self._script = script
        self.opened = 0

    def open(self) -> None:
        self.opened += 1
        if self.opened % 2 == 0:
            raise LinkLostError("no such port")

    def read(self, timeout_s: float) -> bytes:
        if not self._script:
            time.sleep(timeout_s)
            return b""
        piece = self._script.pop(0)
        if piece is None:
            raise LinkLostError("unplugged")
        return piece

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_port_that_vanishes_and_returns_is_opened_again() -> None:
    source = FlakySource([b"one", None, b"two", None, b"three"])
    arrivals: SimpleQueue[Arrival] = SimpleQueue()
    stop = threading.Event()
    thread = threading.Thread(target=read_link, args=("rover", source, arrivals, stop, time.time_ns))
    thread.start()
    seen: list[Arrival] = []
    while b"three" not in [a.data for a in seen]:
        seen.append(arrivals.get(timeout=10))
    stop.set()
    thread.join(5)
    assert [a.data for a in seen if a.data] == [b"one", b"two", b"three"]
    events = [a.event for a in seen if a.event]
    assert events == ["is lost: unplugged", "is back", "is lost: unplugged", "is back"]


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("[recording\n", "TOML"),
        ('[recording]\noutput = "x"\n', "link"),
        ('[recording]\noutput = "x"\nspeed = 1\n' + link("a", "ubx", "udp://127.0.0.1:1"), "recording.speed"),
        ('[recording]\noutput = "x"\n' + link("a", "can", "udp://127.0.0.1:1"), "link.0.protocol"),
        ('[recording]\noutput = "x"\n' + link("a b", "ubx", "udp://127.0.0.1:1"), "link.0.name"),
        ('[recording]\noutput = "x"\n' + 2 * link("a", "ubx", "udp://127.0.0.1:1"), "twice"),
        ('[recording]\noutput = "x"\n' + link("a", "ubx", "bluetooth"), "no address"),
    ],
)
def test_configurations_that_cannot_be_meant(
    content: str, word: str, acquire: Acquire, tmp_path: Path
) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(content)
    done = acquire("record", path)
    assert done.returncode == 5, done.stderr
    assert done.stderr.count("\n") == 1
    assert word in done.stderr


def test_a_missing_configuration_is_told(acquire: Acquire, tmp_path: Path) -> None:
    assert acquire("record", tmp_path / "missing.toml").returncode == 3

"""Recording from live ports: what was sent is in the log, whatever happens to links and process."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from mcap.reader import make_reader

from acquire.importing.recovery import recover
from acquire.recording.reader import Arrival, Inbox, read_link
from acquire.transports.sources import LinkLostError, Source
from drivers import ubx
from tests.acquire.live import Recorder, await_frame, frames_in, free_port, is_bound, until

Acquire = Callable[..., subprocess.CompletedProcess[str]]
Start = Callable[..., Recorder]
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
    with ExitStack() as running:

        def run(links: str, *program: str) -> Recorder:
            configuration = tmp_path / "flight.toml"
            recording = '[recording]\noutput = "logs"\nflush_s = 0.1\nleast_free_mb = 0\n'
            configuration.write_text(recording + links + SITE)
            return running.enter_context(Recorder(configuration, *program))

        yield run


def link(name: str, protocol: str, url: str) -> str:
    return f'[[link]]\nname = "{name}"\nprotocol = "{protocol}"\nurl = "{url}"\nsilent_s = 600\n'


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
    pytest.importorskip("tty", reason="Windows has no such terminals").setraw(theirs)
    port = free_port()
    sent, greeting = frames_of(demo_flight)[:200], ubx.encode(0x0107, bytes(92))
    rover = [numbered(n) for n in range(50)]
    base = [numbered(n, 7) for n in range(50)]
    with ExitStack() as ports:
        server = ports.enter_context(socket.create_server(("127.0.0.1", 0)))
        first, second = (
            ports.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)
        )
        recorder = start(
            link("vehicle", "mavlink", f"udp://127.0.0.1:{port}")
            + link("rover", "ubx", f"serial:{os.ttyname(theirs)}")
            + link("base", "rtcm3", f"tcp://127.0.0.1:{server.getsockname()[1]}")
        )
        connection = ports.enter_context(server.accept()[0])
        until(lambda: is_bound(port), "the port of the vehicle")

        def heard() -> bool:
            # A serial port that is being opened throws away what it holds.
            os.write(ours, greeting)
            return greeting in frames_in(recorder.path, "rover")

        until(heard, "the rover")
        for number, frame in enumerate(sent):
            # The sender changes its port on the way.
            (first if number < 100 else second).sendto(frame, ("127.0.0.1", port))
            if number < 50:
                os.write(ours, rover[number])
                connection.sendall(base[number])
        # A terminal passes bytes on in its own time; what goes by the network has arrived when it was sent.
        await_frame(recorder.path, "rover", rover[-1])
        figures = {entry["link"]: entry["frames"] for entry in recorder.figures()["links"]}
    os.close(ours)
    os.close(theirs)
    greetings = raw(recorder.path, "rover").count(greeting)
    assert figures == {"vehicle": 200, "rover": 50 + greetings, "base": 50}
    assert raw(recorder.path, "vehicle") == sent
    assert raw(recorder.path, "rover") == greetings * [greeting] + rover
    assert raw(recorder.path, "base") == base
    with recorder.path.open("rb") as stream:
        notes = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert notes["site"] == {"operator": "A. Surveyor"}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_was_safe_before_a_kill_survives(seed: int, start: Start, tmp_path: Path) -> None:
    """Kill -9 between two chunks, at any moment: how old the lost part can be stands in evidence/kill.md."""
    chance = random.Random(seed)  # noqa: S311 - moments, not secrets
    port = free_port()
    recorder = start(link("rover", "ubx", f"udp://127.0.0.1:{port}"))
    until(lambda: is_bound(port), "the port of the rover")
    sent = [numbered(n, 188) for n in range(150)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for frame in sent[:100]:
            sender.sendto(frame, ("127.0.0.1", port))
        await_frame(recorder.path, "rover", sent[99])
        for frame in sent[100:]:
            sender.sendto(frame, ("127.0.0.1", port))
            time.sleep(0.004 * chance.random())
    recorder.end(signal.SIGKILL)
    fixed = tmp_path / "fixed.mcap"
    recover(recorder.path, fixed)
    kept = raw(fixed, "rover")
    assert len(kept) >= 100
    assert kept == sent[: len(kept)]


def test_a_file_that_cannot_grow_is_followed_by_the_next_and_nothing_is_lost(
    start: Start, tmp_path: Path
) -> None:
    """A limit on the size of files stands for a full disk: each write beyond it fails on the way."""
    port = free_port()
    limited = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000));"
        "from acquire.commands.cli import main; main()"
    )
    recorder = start(link("rover", "ubx", f"udp://127.0.0.1:{port}"), sys.executable, "-c", limited)
    until(lambda: is_bound(port), "the port of the rover")
    chance = random.Random(1)  # noqa: S311 - filling, not secrets
    sent = [ubx.encode(0x0213, chance.randbytes(400)) for _ in range(500)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for at in range(0, len(sent), 50):
            for frame in sent[at : at + 50]:
                sender.sendto(frame, ("127.0.0.1", port))
            # The port holds no more than some hundred datagrams.
            await_frame(tmp_path / "logs", "rover", sent[at + 49])
    figures = recorder.figures()
    assert len(figures["files"]) >= 4
    assert {alarm["kind"] for alarm in figures["alarms"]} == {"disk_full"}
    found = []
    for number, path in enumerate(map(Path, figures["files"])):
        fixed = tmp_path / f"fixed-{number}.mcap"
        recover(path, fixed)
        found += raw(fixed, "rover")
    assert found == sent


class FlakySource(Source):
    """The twin of a port that vanishes and returns."""

    def __init__(self, script: list[bytes | None]) -> None:
        super().__init__()
        self._script = script
        self.opened = 0

    def open(self, _stop: threading.Event) -> None:
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
    inbox, stop = Inbox("rover", time.time_ns), threading.Event()
    thread = threading.Thread(target=read_link, args=(source, inbox, stop))
    thread.start()
    seen: list[Arrival] = []

    def three() -> bool:
        seen.extend(inbox.take(1 << 20))
        return b"three" in [a.data for a in seen]

    until(three, "the third piece")
    stop.set()
    thread.join()
    assert [a.data for a in seen if a.data] == [b"one", b"two", b"three"]
    events = [a.event for a in seen if a.event]
    assert events == ["is lost: unplugged", "is back", "is lost: unplugged", "is back"]


def test_what_has_arrived_before_the_stop_is_taken() -> None:
    pieces = [bytes([number]) for number in range(50)]
    inbox, stop = Inbox("rover", time.time_ns), threading.Event()

    class Full(FlakySource):
        """Told to stop while it still holds something."""

        def read(self, timeout_s: float) -> bytes:
            stop.set()
            return super().read(timeout_s)

    read_link(Full(list(pieces)), inbox, stop)
    assert [arrival.data for arrival in inbox.take(1 << 20)] == pieces


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("[recording\n", "TOML"),
        ('[recording]\noutput = "x"\n', "link"),
        ('[recording]\noutput = "x"\nspeed = 1\n' + link("a", "ubx", "udp://127.0.0.1:1"), "recording.speed"),
        ('[recording]\noutput = "x"\n' + link("a", "can", "udp://127.0.0.1:1"), "link.1.protocol"),
        ('[recording]\noutput = "x"\n' + link("a b", "ubx", "udp://127.0.0.1:1"), "link.1.name"),
        ('[recording]\noutput = "x"\n' + 2 * link("a", "ubx", "udp://127.0.0.1:1"), "twice"),
        ('[recording]\noutput = "x"\n' + link("a", "ubx", "bluetooth"), "not an address"),
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

"""Study: a long day, compressed: links that come and go, bad casters, a clock that is set, files that rotate.

Writes `docs/evidence/long_day.md`. A recorder, a process of its own whose clock this study sets, records a
link of 100 frames a second beside one that comes and goes all the time and a caster that is bad in turn.

Run: `make evidence`, or `python -m tests.evidence.long_day [SECONDS]`.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import itertools
import json
import mmap
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from acquire.recording.configuration import read_configuration
from acquire.recording.recorder import Host, record
from photocal.base.operating_system import stopped_by_signals
from tests.acquire.live import Process, frames_in
from tests.acquire.recording.undisturbed import GoodLink, configured, numbered

LASTS_S, AT_ONCE = 150.0, 5
ROTATE_MIN, ROTATE_MB = 0.15, 0.05
# Seconds by which the clock of the recorder is set at a share of the time; -1: a leap second is put in.
SETTINGS = {0.1: -1.0, 0.25: 3600.0, 0.4: -7200.0, 0.55: -3e8, 0.7: 3e8, 0.85: 3600.0}
FIRST_FRAME = 1_000_000
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "long_day.md"


@dataclass
class Flapping:
    """A TCP server that sends some frames and closes, each time."""

    times: int = 0
    sent: list[bytes] = field(default_factory=list)

    def serve(self, server: socket.socket, stop: threading.Event) -> None:
        """Serve until told to stop."""
        while not stop.is_set():
            with contextlib.suppress(OSError):
                line, _ = server.accept()
                with line:
                    for _ in range(AT_ONCE):
                        frame = numbered(FIRST_FRAME + len(self.sent))
                        line.sendall(frame)
                        self.sent.append(frame)
                    # All of it is taken before the end of the connection comes.
                    line.shutdown(socket.SHUT_WR)
                    line.settimeout(1.0)
                    line.recv(1)
                self.times += 1


@dataclass
class BadCaster:
    """A caster that hangs, redirects, has a head without an end, refuses the password and drops, in turn."""

    asked: int = 0
    positions: int = 0

    def serve(self, server: socket.socket, stop: threading.Event) -> None:
        """Serve until told to stop."""
        ways = itertools.cycle((self._hang, self._redirect, self._endless, self._refuse, self._drop))
        while not stop.is_set():
            with contextlib.suppress(OSError):
                line, _ = server.accept()
                with line:
                    line.settimeout(1.0)
                    head = line.recv(4096)
                    self.asked += 1
                    self.positions += b"GPGGA" in head or b"GNGGA" in head
                    next(ways)(line, stop)

    def _hang(self, _line: socket.socket, stop: threading.Event) -> None:
        stop.wait(2.0)

    def _redirect(self, line: socket.socket, _stop: threading.Event) -> None:
        line.sendall(b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\n\r\n")

    def _endless(self, line: socket.socket, stop: threading.Event) -> None:
        line.sendall(b"HTTP/1.1 200 OK\r\n")
        until_s = time.monotonic() + 2.0
        while time.monotonic() < until_s and not stop.is_set():
            line.sendall(b"X-Again: " + b"x" * 4000 + b"\r\n")

    def _refuse(self, line: socket.socket, _stop: threading.Event) -> None:
        line.sendall(b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\n\r\n")

    def _drop(self, _line: socket.socket, _stop: threading.Event) -> None:
        """Say nothing and close."""


@dataclass(frozen=True)
class Day:
    """What was seen: frames sent and lost, comings and goings, memory (MB) and descriptors each second."""

    sent: int
    lost: int
    flapped: int
    flapped_sent: int
    flapped_lost: int
    asked: int
    positions: int
    files: int
    jumps: int
    memory_mb: list[float]
    descriptors: list[int]
    stop_s: float
    code: int


@contextlib.contextmanager
def serving(server: Flapping | BadCaster) -> Iterator[int]:
    """Let a server serve at a port."""
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.2)
        thread = threading.Thread(target=server.serve, args=(listener, stop), daemon=True)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            stop.set()
            thread.join()


def day(lasts_s: float = LASTS_S) -> Day:
    """Record for a while and look what is there."""
    flapping, caster = Flapping(), BadCaster()
    with tempfile.TemporaryDirectory() as name, serving(flapping) as line, serving(caster) as mount:
        folder = Path(name)
        position = "position = [-22.7, -43.2, 30.0]\nposition_every_s = 1"
        path, port = configured(
            folder,
            ("flapping", "ubx", f"tcp://127.0.0.1:{line}", ""),
            ("caster", "rtcm3", f"ntrip://127.0.0.1:{mount}/X", f"silent_s = 5\n{position}"),
        )
        rotation = f'output = "logs"\nrotate_min = {ROTATE_MIN}\nrotate_mb = {ROTATE_MB}\n'
        path.write_text(path.read_text().replace('output = "logs"\n', rotation))
        offset = folder / "offset"
        offset.write_bytes(bytes(8))
        command = [sys.executable, "-m", "tests.evidence.long_day", "record", str(path), str(offset)]
        with Process(command) as recorder, GoodLink(port) as good:
            memory, descriptors = _watched(recorder, offset, lasts_s)
            good.end()
            stopped_s = time.monotonic()
            printed = recorder.end()
            stop_s = time.monotonic() - stopped_s
        kept, flapped = (set(frames_in(folder / "logs", link)) for link in ("good", "flapping"))
        figures = json.loads(printed.splitlines()[-1])
        return Day(
            len(good.sent),
            sum(frame not in kept for _, frame in good.sent),
            flapping.times,
            len(flapping.sent),
            sum(frame not in flapped for frame in flapping.sent),
            caster.asked,
            caster.positions,
            figures["files"],
            figures["jumps"],
            memory,
            descriptors,
            stop_s,
            recorder.process.returncode,
        )


def _watched(recorder: Process, offset: Path, lasts_s: float) -> tuple[list[float], list[int]]:
    """Set the clock of the recorder now and then; return its memory and descriptors each second."""
    begin, due, total_s = time.monotonic(), sorted(SETTINGS.items()), 0.0
    memory, descriptors = [], []
    pid = recorder.process.pid
    while (now := time.monotonic() - begin) < lasts_s:
        if due and now > due[0][0] * lasts_s:
            total_s += due.pop(0)[1]
            with offset.open("r+b") as stream:
                stream.write(round(total_s * 1e9).to_bytes(8, "little", signed=True))
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        memory.append(pages * mmap.PAGESIZE / 1e6)
        descriptors.append(len(list(Path(f"/proc/{pid}/fd").iterdir())))
        time.sleep(1.0)
    return memory, descriptors


def recorded(path: Path, offset: Path) -> None:
    """Record with a clock that another process sets, and print figures."""
    # As the command does: what was made in a flight is not looked through at the end.
    atexit.register(gc.freeze)
    stop = stopped_by_signals()
    with offset.open("r+b") as stream, mmap.mmap(stream.fileno(), 8) as shift:

        def clock_ns() -> int:
            return time.time_ns() + int.from_bytes(shift[:8], "little", signed=True)

        chosen = read_configuration(path)
        done = record(chosen, path.parent, stop, lambda _: None, Host(clock_ns=clock_ns))
    jumps = sum(alarm.kind == "clock_jump" for alarm in done.alarms)
    sys.stdout.write(json.dumps({"files": len(done.paths), "jumps": jumps}) + "\n")


def main() -> None:
    """Run the study and write its table; or be its recorder."""
    if sys.argv[1:2] == ["record"]:
        recorded(Path(sys.argv[2]), Path(sys.argv[3]))
        return
    lasts_s = float(sys.argv[1]) if len(sys.argv) > 1 else LASTS_S
    d = day(lasts_s)
    memory, descriptors = (np.array_split(np.array(v), 4) for v in (d.memory_mb, d.descriptors))
    settings = ", ".join(f"{seconds:+g}" for seconds in SETTINGS.values())
    lines = [
        "# A long day, compressed",
        "",
        f"{lasts_s:g} s of a recorder with three links. The first has 100 frames a second. The second is a",
        f"TCP link that sends {AT_ONCE} frames and closes, again and again. The third is a caster that in",
        "turn hangs, redirects, sends a header without an end, refuses the password and drops the",
        f"connection. The clock of the recorder is set by {settings} s (the first step is that of an",
        f"inserted leap second). A new file begins after {ROTATE_MIN * 60:g} s or {ROTATE_MB:g} MB.",
        "Required: nothing lost, constant memory and number of descriptors. What a day does to a recorder",
        "(connections, files, clocks) is compressed into minutes; 24 hours of flight are in",
        "[long-flight.md](long-flight.md).",
        "",
        "| | |",
        "|---|---|",
        f"| frames of the good link, lost | {d.sent}, {d.lost} |",
        f"| connections of the link that closes | {d.flapped} |",
        f"| frames of it, lost | {d.flapped_sent}, {d.flapped_lost} |",
        f"| requests to the caster, with a position | {d.asked}, {d.positions} |",
        f"| steps of the clock, reported | {len(SETTINGS)}, {d.jumps} |",
        f"| files | {d.files} |",
        f"| memory in each quarter, greatest, MB | {', '.join(f'{m.max():.1f}' for m in memory)} |",
        f"| descriptors in each quarter, greatest | {', '.join(f'{n.max():.0f}' for n in descriptors)} |",
        f"| stop, s; exit code | {d.stop_s:.2f}; {d.code} |",
        "",
        "Made by `python -m tests.evidence.long_day`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()

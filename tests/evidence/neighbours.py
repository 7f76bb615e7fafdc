"""Study: what do hostile neighbours of the monitor, and a poor computer, cost a recording?

Writes `docs/evidence/neighbours.md`. A recorder gets 100 frames a second; the page and the Foxglove door of
`acquire monitor` beside it are attacked by a process of its own. Then a recorder is given few descriptors,
little memory and one core, at 20 times the load of a field.

Run: `make evidence`, or `python -m tests.evidence.neighbours`.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquire.log.replay import raw_frames
from drivers import ubx
from tests.acquire.live import Process, frames_in, free_port, is_bound, until
from tests.acquire.recording.undisturbed import GoodLink, configured
from tests.evidence.kill import FRAME_BYTES, numbered

LASTS_S, LOAD_S = 8.0, 12.0
# Twenty times the 20 kB/s of a vehicle and of a receiver.
HEAVY_BYTES_S = 400_000
SILENT_LINKS, MEMORY_MB, DESCRIPTORS = 40, 512, 64
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "neighbours.md"


def half_open(page: int, door: int, _target: str) -> None:
    """Open 500 connections that never finish their request, again and again."""
    lines = [socket.create_connection(("127.0.0.1", (page, door)[n % 2])) for n in range(500)]
    while True:
        for line in lines:
            with contextlib.suppress(OSError):
                line.send(b"G")
        time.sleep(0.5)


def slow_readers(page: int, door: int, target: str) -> None:
    """Ask for the feed and for the channels, and read nothing."""
    lines = []
    for number in range(80):
        line = socket.create_connection(("127.0.0.1", (page, door)[number % 2]))
        line.send(_get("/feed", page) if number % 2 == 0 else _upgrade(target, door))
        lines.append(line)
    time.sleep(600)


def websocket_flood(_page: int, door: int, target: str) -> None:
    """Send masked messages of 64 kB as fast as they are taken."""
    message = b"\x82\xff" + struct.pack(">Q", 1 << 16) + bytes(4) + bytes(1 << 16)
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", door)) as line:
            line.send(_upgrade(target, door))
            while True:
                line.sendall(message)


def giant_bodies(page: int, _door: int, _target: str) -> None:
    """Send bodies without an end."""
    head = f"POST /heard HTTP/1.1\r\nHost: 127.0.0.1:{page}\r\nContent-Length: 1000000000000\r\n\r\n"
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", page)) as line:
            line.sendall(head.encode())
            while True:
                line.sendall(b"1" * (1 << 16))


def foreign_requests(page: int, _door: int, _target: str) -> None:
    """Ask as fast as they are answered, with hosts, origins and paths of others."""
    paths = ["/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/feed?" + "x" * 60_000, "/heard"]
    heads = [
        "Host: evil.example",
        "Origin: http://evil.example",
        "Transfer-Encoding: chunked",
        "X: " + "y" * 9000,
    ]
    number = 0
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", page)) as line:
            path, head = paths[number % 4], heads[number // 4 % 4]
            line.sendall(f"GET {path} HTTP/1.1\r\n{head}\r\n\r\n".encode())
            line.settimeout(0.2)
            line.recv(1000)
        number += 1


ATTACKS: dict[str, Callable[[int, int, str], None]] = {
    f.__name__: f for f in (half_open, slow_readers, websocket_flood, giant_bodies, foreign_requests)
}


def _get(path: str, port: int) -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()


def _upgrade(target: str, port: int) -> bytes:
    return (
        f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    ).encode()


@dataclass(frozen=True)
class Heard:
    """How a recorder fared: frames sent and due ones lost at a kill, delay from sending to receipt, s."""

    sent: int
    lost: int
    median_s: float
    p99_s: float
    worst_s: float


@contextlib.contextmanager
def attacked(attack: str, logs: Path) -> Iterator[None]:
    """Have the page and the door of a monitor attacked."""
    page, door = free_port(), free_port()
    monitor = [sys.executable, "-m", "acquire", "monitor", str(logs), "--page"]
    addresses = ["--address", f"127.0.0.1:{page}", "--foxglove", "--foxglove-address", f"127.0.0.1:{door}"]
    with Process([*monitor, *addresses]) as process:
        target = "/?" + process.line("Foxglove: ").partition("/?")[2]
        until(lambda: _answers(page), "the page")
        attacker = [sys.executable, "-m", "tests.evidence.neighbours", attack, str(page), str(door), target]
        with subprocess.Popen(attacker, stderr=subprocess.DEVNULL) as hostile:
            try:
                yield
            finally:
                hostile.kill()


def _answers(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 0.2):
        return True
    return False


def heard_under(attack: str, lasts_s: float = LASTS_S) -> Heard:
    """Record while the monitor is attacked, kill the recorder and look what it had."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        path, port = configured(folder)
        command = [sys.executable, "-m", "acquire", "record", str(path)]
        recorder = stack.enter_context(Process(command))
        good = stack.enter_context(GoodLink(port))
        until(lambda: frames_in(folder / "logs", "good"), "the first frames")
        if attack:
            stack.enter_context(attacked(attack, folder / "logs"))
        begun = len(good.sent)
        time.sleep(lasts_s)
        recorder.process.kill()
        lost = good.lost(folder, time.monotonic())
        offset_s = time.time() - time.monotonic()
        sent = {frame: sent_s + offset_s for sent_s, frame in good.sent}
        (log,) = (folder / "logs").glob("*.mcap")
        came = {frame: time_ns / 1e9 for time_ns, frame in raw_frames(log, "good")}
        late = [came[frame] - sent[frame] for _, frame in good.sent[begun:] if frame in came]
        delays = np.array(late)
        quantiles = [float(np.quantile(delays, share)) for share in (0.5, 0.99, 1.0)]
        return Heard(len(good.sent), lost, *quantiles)


@dataclass(frozen=True)
class Poor:
    """What a poor computer recorded: of each link frames sent and lost, events decoded, and what was told."""

    sent: dict[str, int]
    lost: dict[str, int]
    events: int
    alarms: list[str]
    memory_mb: float
    descriptors: int
    code: int


def event(number: int) -> bytes:
    """Return a time mark with a number (TIM-TM2)."""
    payload = struct.pack("<BBHHHIIIII", 0, 0xCA, number, 2400, 2400, number * 50, 0, number * 50, 0, 20)
    return ubx.encode(0x0D03, payload)


def send(port: int, kind: str, for_s: float) -> None:
    """Send numbered events, 20 a second, or heavy frames, and print how many."""
    make, every_s, at_once = (event, 0.05, 1)
    if kind != "camera":
        make, every_s, at_once = numbered, 0.01, HEAVY_BYTES_S // 100 // FRAME_BYTES
    begin, number = time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        turn = 0
        while time.monotonic() < begin + for_s:
            for _ in range(at_once):
                line.sendto(make(number), ("127.0.0.1", port))
                number += 1
            turn += 1
            time.sleep(max(0.0, begin + turn * every_s - time.monotonic()))
    sys.stdout.write(str(number))


def poor_computer(for_s: float = LOAD_S) -> Poor:
    """Record 20 times the load with few descriptors, little memory and one core."""
    with tempfile.TemporaryDirectory() as name, memory_group() as group:
        folder = Path(name)
        ports = {link: free_port() for link in ("camera", "vehicle", "rover")}
        silent = [
            (f"silent{n}", "ubx", f"udp://127.0.0.1:{free_port()}", "silent_s = 600")
            for n in range(SILENT_LINKS)
        ]
        loaded = [(link, "ubx", f"udp://127.0.0.1:{port}", "silent_s = 600") for link, port in ports.items()]
        path, port = configured(folder, *loaded, *silent)
        join = f"echo $$ > {group}/cgroup.procs; " if group else ""
        core = "taskset -c 0 " if shutil.which("taskset") else ""
        inner = f"ulimit -n {DESCRIPTORS}; {join}exec {core}{sys.executable} -m acquire record {path} --json"
        with Process(["sh", "-c", inner]) as recorder, GoodLink(port) as good:
            until(lambda: all(map(is_bound, ports.values())), "the ports")
            senders = {
                link: subprocess.Popen(
                    [sys.executable, "-m", "tests.evidence.neighbours", "send", str(port), link, str(for_s)],
                    stdout=subprocess.PIPE,
                    text=True,
                )
                for link, port in ports.items()
            }
            counts = {link: int(sender.communicate()[0]) for link, sender in senders.items()}
            status = Path(f"/proc/{recorder.process.pid}/status").read_text().splitlines()
            memory = next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024
            descriptors = len(list(Path(f"/proc/{recorder.process.pid}/fd").iterdir()))
            good.end()
            recorder.end()
        logs = folder / "logs"
        made = {"camera": event, "vehicle": numbered, "rover": numbered}
        lost = {}
        for link, count in counts.items():
            kept = set(frames_in(logs, link))
            lost[link] = sum(made[link](number) not in kept for number in range(count))
        kept = set(frames_in(logs, "good"))
        lost["good"] = sum(frame not in kept for _, frame in good.sent)
        events = _exposures(logs)
        alarms = [line.strip() for line in recorder.told if re.search("arrive (faster )?than", line)]
        counts["good"] = len(good.sent)
        return Poor(counts, lost, events, alarms, memory, descriptors, recorder.process.returncode)


def _exposures(logs: Path) -> int:
    from acquire.log.reader import LogReader

    chunks = (chunk for log in logs.glob("*.mcap") for chunk in LogReader(log).chunks())
    return sum(len(p.payloads) for chunk in chunks for p in chunk if p.channel.topic == "/camera/exposure")


@contextlib.contextmanager
def memory_group() -> Iterator[Path | None]:
    """Give a group of processes with little memory, where the system lets us make one."""
    group = Path(f"/sys/fs/cgroup/memory/photocal-{os.getpid()}")
    try:
        group.mkdir()
        (group / "memory.limit_in_bytes").write_text(str(MEMORY_MB << 20))
    except OSError:
        yield None
        return
    try:
        yield group
    finally:
        with contextlib.suppress(OSError):
            group.rmdir()


def main() -> None:
    """Run the study and write its tables; or be an attacker or a sender of it."""
    if len(sys.argv) > 1 and sys.argv[1] in ATTACKS:
        ATTACKS[sys.argv[1]](int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
        return
    if len(sys.argv) > 1 and sys.argv[1] == "send":
        send(int(sys.argv[2]), sys.argv[3], float(sys.argv[4]))
        return
    rows = []
    for attack in ("", *ATTACKS):
        h = heard_under(attack)
        words = (ATTACKS[attack].__doc__ or "").rstrip(".") if attack else "No monitor"
        delays = f"{h.median_s * 1e3:.1f} | {h.p99_s * 1e3:.1f} | {h.worst_s * 1e3:.0f}"
        rows.append(f"| {words} | {h.sent} | {h.lost} | {delays} |")
        sys.stderr.write(rows[-1] + "\n")
    poor = poor_computer()
    with memory_group() as group:
        memory = f"a memory group of {MEMORY_MB} MiB" if group else "memory without a limit (none may be set)"
    lines = [
        "# Hostile neighbours and a poor computer",
        "",
        "## Pages and sockets",
        "",
        "A recorder takes 100 frames a second. The page and the Foxglove port of `acquire monitor` on its",
        f"folder are attacked for {LASTS_S:g} s by another process on the same cores; then the recorder is",
        "killed. Required: no due frame lost. The delay is that from sending a frame to its time of",
        "receipt, from the beginning of the attack on. The cores are shared with other work, as the first",
        "row shows.",
        "",
        "| attack | frames sent | due ones lost | delay, median ms | 99 % | worst |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        "## Few descriptors, little memory, one core",
        "",
        f"`ulimit -n {DESCRIPTORS}`, {memory}, one core (shared), {SILENT_LINKS} silent",
        f"links and four that speak, two of them with {HEAVY_BYTES_S / 1e3:g} kB/s (20 times a field's) for",
        f"{LOAD_S:g} s. Required: what is dropped is reported, events of the camera are not dropped.",
        "",
        "| link | frames sent | lost |",
        "|---|---|---|",
        *(f"| {link} | {count} | {poor.lost[link]} |" for link, count in poor.sent.items()),
        "",
        f"Decoded events of the camera: {poor.events}.",
        f"Reported as dropped: {'; '.join(poor.alarms) or 'nothing'}.",
        f"Greatest memory {poor.memory_mb:.0f} MB, {poor.descriptors} descriptors, exit code {poor.code}.",
        "",
        "Made by `python -m tests.evidence.neighbours`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()

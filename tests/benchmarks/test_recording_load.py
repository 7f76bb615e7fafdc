"""Recording under load: five links at real rates and at fifty times as much, the recorder a process.

The duration is short by default; `PHOTOCAL_LOAD_S=600 make bench` records ten minutes at each speed.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import rtcm3, ubx
from drivers.mavlink.decode import encode
from drivers.mavlink.dialect import ardupilotmega

pytestmark = pytest.mark.benchmark(group="recording")

SECONDS = float(os.environ.get("PHOTOCAL_LOAD_S", "8"))
TICK_S = 0.01
_PROTOCOLS = {"vehicle": "mavlink", "rover": "ubx", "base": "ubx", "camera": "ubx", "caster": "rtcm3"}


def _rawx(second: float) -> bytes:
    signals = np.random.default_rng(1).bytes(32 * 30)
    head = struct.pack("<dHbBBB2x", 300_000 + second, 2300, 18, 30, 1, 1)
    return ubx.encode(0x0215, head + signals)


def second_of(link: str) -> list[tuple[float, bytes]]:
    """Return the frames of a second at real rates, with the moments at which they come."""
    dialect = ardupilotmega()

    def mavlink(name: str, **values: int) -> bytes:
        return encode(dialect, dialect.number(name), values, sequence=0, system=1, component=1)

    def often(rate: int, frame: bytes) -> list[tuple[float, bytes]]:
        return [(number / rate, frame) for number in range(rate)]

    frames = {
        "vehicle": [
            *often(50, mavlink("ATTITUDE", time_boot_ms=60_000)),
            *often(50, mavlink("GLOBAL_POSITION_INT", time_boot_ms=60_000, lat=-227_000_000)),
            *often(5, mavlink("GPS_RAW_INT", time_usec=60_000_000, fix_type=6, lat=-227_000_000)),
            *often(1, mavlink("SYSTEM_TIME", time_unix_usec=1_760_000_000_000_000, time_boot_ms=60_000)),
        ],
        "rover": [
            *often(10, _rawx(0)),
            *often(30, ubx.encode(0x0213, bytes(48))),
            *often(10, ubx.encode(0x0107, bytes(92))),
        ],
        "base": [*often(10, _rawx(0)), *often(4, rtcm3.encode(b"\x43\x50" + bytes(300)))],
        "camera": often(1, ubx.encode(0x0D03, bytes(28))),
        "caster": often(5, rtcm3.encode(b"\x43\x50" + bytes(300))),
    }
    return sorted(frames[link], key=lambda item: item[0])


class Senders:
    """Sends to the links of a recorder at a multiple of real rates."""

    def __init__(self, speed: int) -> None:
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._vehicle = probe.getsockname()
        self._servers = {n: socket.create_server(("127.0.0.1", 0)) for n in _PROTOCOLS if n != "vehicle"}
        self._lines: dict[str, socket.socket] = {}
        self._speed = speed
        self._plan = {name: second_of(name) for name in _PROTOCOLS}
        self.sent = dict.fromkeys(_PROTOCOLS, 0)
        # How late the machine wakes a program that sleeps: no recorder on it can be quicker.
        self.late_s: list[float] = []

    def configuration(self) -> str:
        """Return the configuration of the recorder."""
        urls = {n: f"tcp://127.0.0.1:{s.getsockname()[1]}" for n, s in self._servers.items()}
        urls["vehicle"] = f"udp://127.0.0.1:{self._vehicle[1]}"
        links = [
            f'[[link]]\nname = "{n}"\nprotocol = "{p}"\nurl = "{urls[n]}"\n' for n, p in _PROTOCOLS.items()
        ]
        return '[recording]\noutput = "logs"\nleast_free_mb = 0\n' + "".join(links)

    def connect(self) -> None:
        """Wait for the recorder."""
        self._lines = {name: server.accept()[0] for name, server in self._servers.items()}

    def send(self, for_s: float) -> None:
        """Send for some seconds."""
        begun = time.monotonic()
        done = 0.0
        while done < for_s:
            now = min(time.monotonic() - begun, for_s)
            for name in _PROTOCOLS:
                self._send(name, done * self._speed, now * self._speed)
            done = now
            before = time.monotonic()
            time.sleep(TICK_S)
            self.late_s.append(time.monotonic() - before - TICK_S)

    def _send(self, name: str, since: float, until: float) -> None:
        plan = self._plan[name]
        due = [
            frame
            for whole in range(int(since), int(until) + 1)
            for moment, frame in plan
            if since <= whole + moment < until
        ]
        if not due:
            return
        self.sent[name] += len(due)
        if name == "vehicle":
            for at in range(0, len(due), 20):
                self._udp.sendto(b"".join(due[at : at + 20]), self._vehicle)
        else:
            self._lines[name].sendall(b"".join(due))

    def close(self) -> None:
        """Close all ports."""
        for line in (self._udp, *self._servers.values(), *self._lines.values()):
            line.close()


@contextlib.contextmanager
def recorder(senders: Senders, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a recorder that measures itself."""
    path = folder / "flight.toml"
    path.write_text(senders.configuration())
    command = [sys.executable, "-m", "tests.benchmarks.recorder_under_watch", str(path)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        cwd=Path(__file__).parents[2],
    ) as process:  # fmt: skip
        yield process
        process.kill()


# The recording may be as long as asked for.
@pytest.mark.timeout(SECONDS + 240)
@pytest.mark.parametrize("speed", [1, 50])
def test_five_links(speed: int, tmp_path: Path, benchmark: Any, capsys: pytest.CaptureFixture[str]) -> None:
    senders = Senders(speed)
    figures: dict[str, Any] = {}

    def run() -> None:
        with recorder(senders, tmp_path) as process:
            senders.connect()
            time.sleep(0.5)
            senders.send(SECONDS)
            time.sleep(0.5)
            output, _ = process.communicate()
            figures.update(json.loads(output))

    benchmark.pedantic(run, rounds=1)
    senders.close()
    low, high, last = figures["memory_mb"]
    benchmark.extra_info.update(figures, sent=senders.sent)
    said = (
        f"\nrecording {speed}x real rates for {SECONDS:g} s: {sum(senders.sent.values())} frames sent, "
        f"{sum(senders.sent.values()) - sum(figures['frames'].values())} dropped; to the writer median "
        f"{figures['p50_ms']:.1f} ms, p99 {figures['p99_ms']:.1f} ms; on disk within "
        f"{figures['worst_disk_s']:.2f} s; "
        f"{100 * figures['core_share']:.0f} % of one core; memory {low:.0f}, at most {high:.0f}, at the end "
        f"{last:.0f} MB; load of the machine {figures['load']:.0f}, a plain sleep ends late by median "
        f"{1e3 * np.median(senders.late_s):.1f} ms, p99 {1e3 * np.quantile(senders.late_s, 0.99):.1f} ms\n"
    )
    with capsys.disabled():
        sys.stderr.write(said)
    assert figures["frames"] == senders.sent
    assert not figures["damage"]

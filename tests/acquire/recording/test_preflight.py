"""The preflight says what is good and what is not."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from acquire.simulate.hardware import on_pty, on_udp
from tests.acquire.devices import Autopilot, Receiver
from tests.acquire.live import free_port

Acquire = Callable[..., subprocess.CompletedProcess[str]]


def test_what_is_good_and_what_is_not(acquire: Acquire, tmp_path: Path) -> None:
    port = free_port()
    autopilot = Autopilot(time.time_ns() // 1000 - 3_600_000_000)
    for message, interval in ((30, 0.1), (24, 0.5), (2, 0.2)):
        autopilot.interval_s[message] = interval
        autopilot._due_s[message] = 0.0
    path = tmp_path / "flight.toml"
    with on_udp(autopilot, "127.0.0.1", port), on_pty(Receiver(9)) as line:
        path.write_text(
            '[recording]\noutput = "logs"\nleast_free_mb = 0\n'
            f'[[link]]\nname = "vehicle"\nprotocol = "mavlink"\nurl = "udp://127.0.0.1:{port}"\n'
            "[link.vehicle]\nrates_hz = {ATTITUDE = 5, RAW_IMU = 50}\n"
            f'[[link]]\nname = "rover"\nprotocol = "ubx"\nurl = "serial:{line}"\n'
            '[link.ublox]\nport = "usb"\nrate_ms = 400\n'
            '[[link]]\nname = "base"\nprotocol = "rtcm3"\nurl = "serial:/dev/not-there"\n'
        )
        done = acquire("check", path, "--seconds", 2, "--json")
    assert done.returncode == 10
    assert done.stderr.count("\n") == 1
    answer = json.loads(done.stdout)
    seen = {finding["subject"]: finding for finding in answer["findings"]}
    assert not answer["good"]
    good = {subject for subject, finding in seen.items() if finding["good"]}
    assert good == {
        "vehicle: frames", "vehicle: heartbeat", "vehicle: rate of ATTITUDE", "vehicle: fix",
        "rover: frames", "rover: fix", "rover: rate of NAV-PVT", "disk logs",
    }  # fmt: skip
    assert set(seen) - good == {
        "vehicle: rate of RAW_IMU", "vehicle: clock", "rover: clock", "rover: rate of RXM-RAWX", "base: port",
    }  # fmt: skip
    assert seen["rover: rate of RXM-RAWX"]["seen"] == "0.0 of 2.5 Hz"
    assert seen["vehicle: fix"]["seen"] == "rtk_fixed, 17 satellites"
    assert seen["rover: fix"]["seen"] == "rtk_fixed, 19 satellites"
    assert "+3600" in seen["vehicle: clock"]["seen"]
    assert not (tmp_path / "logs").exists()

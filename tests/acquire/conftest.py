"""Runs of the command line, and logs of the recorded data, imported once."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from drivers.mavlink.dialect import ardupilotmega
from tests.conftest import Once
from tests.programs import called
from tests.telemetry import telemetry_log

Acquire = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def acquire() -> Acquire:
    """Run `acquire` with arguments, see `tests.programs.called`."""
    return partial(called, "acquire")


@pytest.fixture(scope="session")
def demo_flight() -> bytes:
    """Bytes of the synthetic flight."""
    return telemetry_log(ardupilotmega())


@pytest.fixture(scope="session")
def logs(shared: Path, acquire: Acquire, once: Once) -> dict[str, Path]:
    """Flight logs of the recorded data."""
    data = shared / "data"
    m8p = data / "gnss-ubx-m8p-base-rover"
    sources: dict[str, list[object]] = {
        "dronekit": [data / "mavlink-tlog-dronekit/flight.tlog"],
        "cuav": [data / "mavlink-tlog-cuav-images/flight.tlog"],
        "m8p": [
            "--link", f"rover={m8p / 'rover-20181004-1237.ubx.gz'}",
            "--link", f"base={m8p / 'base-20181004-1236.ubx.gz'}",
        ],
        "moving": ["--link", f"rover={m8p / 'rover-20181009-1221.ubx.gz'}"],
        "f9p": ["--link", f"rover={data / 'gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx'}"],
    }  # fmt: skip

    def fill(folder: Path) -> None:
        for name, arguments in sources.items():
            done = acquire("import", *arguments, "-o", folder / f"{name}.mcap")
            assert done.returncode == 0, done.stderr

    folder = once("logs", fill)
    return {name: folder / f"{name}.mcap" for name in sources}

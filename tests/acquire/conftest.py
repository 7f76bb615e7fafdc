"""Runs of the command line, and logs of the recorded data, imported once."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from acquire.cli import main
from drivers.mavlink.dialect import ardupilotmega
from tests.conftest import Once
from tests.telemetry import telemetry_log

Acquire = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def acquire() -> Acquire:
    """Run `acquire` with arguments, as a person does, in this process: that is quicker than one of its own.

    Tests that kill or stop it, or look at what it imports, start processes of their own.
    """

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        out, err, code = io.StringIO(), io.StringIO(), 0
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        given, sys.argv = sys.argv, ["acquire", *map(str, arguments)]
        environment = dict(os.environ)
        try:
            with redirect_stdout(out), redirect_stderr(err):
                main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            sys.argv = given
            os.environ.clear()
            os.environ.update(environment)
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return subprocess.CompletedProcess(sys.argv, code, out.getvalue(), err.getvalue())

    return run


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

"""Programs of others take what we give: pymavlink our telemetry log, RTKLIB our streams."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink import mavutil

from acquire.importing.importer import import_recordings
from drivers import nmea, ubx
from tests.acquire.live import Process, free_port, is_bound, until
from tests.simulated import PLANS, fly

Acquire = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def flight(tmp_path: Path, demo_flight: bytes) -> Path:
    source, log = tmp_path / "flight.tlog", tmp_path / "flight.mcap"
    source.write_bytes(demo_flight)
    stream = tmp_path / "rover.ubx"
    date = nmea.encode("GPZDA,090000.00,01,05,2026,00,00")
    stream.write_bytes(date + b"".join(ubx.encode(0x0213, bytes([n]) * (20 + n)) for n in range(200)))
    import_recordings([("rover", stream)], [source], log, lambda _: None)
    return log


def test_an_exported_telemetry_log_is_the_imported_one(
    flight: Path, acquire: Acquire, tmp_path: Path, demo_flight: bytes
) -> None:
    made = tmp_path / "again.tlog"
    done = acquire("export", flight, "--link", "vehicle", "-o", made)
    assert done.returncode == 0, done.stderr
    assert made.read_bytes() == demo_flight


def test_pymavlink_reads_every_message_of_an_export(
    flight: Path, acquire: Acquire, tmp_path: Path, demo_flight: bytes
) -> None:
    made = tmp_path / "again.tlog"
    assert acquire("export", flight, "--link", "vehicle", "-o", made).returncode == 0
    log = mavutil.mavlink_connection(str(made), dialect="ardupilotmega")
    count, first = 0, None
    while (message := log.recv_match()) is not None:
        assert message.get_type() != "BAD_DATA"
        first = first or message._timestamp
        count += 1
    log.close()
    at = frames = 0
    while at < len(demo_flight):
        at += 8 + demo_flight[at + 9] + 12
        frames += 1
    assert count == frames
    assert first == int.from_bytes(demo_flight[:8], "big") / 1e6


def test_a_link_without_mavlink_is_no_telemetry_log(flight: Path, acquire: Acquire, tmp_path: Path) -> None:
    done = acquire("export", flight, "--link", "rover", "-o", tmp_path / "no.tlog")
    assert done.returncode == 4
    assert "no MAVLink" in done.stderr
    assert not (tmp_path / "no.tlog").exists()


@pytest.mark.skipif(shutil.which("str2str") is None, reason="RTKLIB's str2str is not installed (rtklib)")
def test_str2str_copies_our_tcp_stream_byte_for_byte(flight: Path, tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "acquire",
        "replay",
        str(flight),
        "--link",
        "rover",
        "--speed",
        "0",
    ]
    copy = tmp_path / "copy.ubx"
    expected = (tmp_path / "rover.ubx").read_bytes()
    with Process([*command, "--to", "tcp://127.0.0.1:0"]) as replay:
        port = replay.line(" to ").rpartition(":")[2]
        with Process(["str2str", "-in", f"tcpcli://127.0.0.1:{port}", "-out", f"file://{copy}"]):
            until(lambda: copy.exists() and copy.stat().st_size >= len(expected), "the copy")
    assert copy.read_bytes() == expected


def _mavproxy() -> str | None:
    """MAVProxy brings many packages: it is not ours to install; $MAVPROXY may name it."""
    return os.environ.get("MAVPROXY") or shutil.which("mavproxy.py")


def _records(log: bytes) -> list[bytes]:
    found, at = [], 0
    while at + 10 < len(log):
        end = at + 8 + log[at + 9] + (12 if log[at + 8] == 0xFD else 8)
        found.append(log[at + 8 : end])
        at = end
    return found


@pytest.fixture(params=["demonstration", "simulated survey"])
def telemetry(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, bytes]:
    """A flight log and the telemetry log that went into it."""
    if request.param == "demonstration":
        flight: Path = request.getfixturevalue("flight")
        return flight, (tmp_path / "flight.tlog").read_bytes()
    fly(tmp_path / "survey", PLANS / "small.toml", observing={"ties": 0})
    site = tmp_path / "survey" / "site"
    return site / "flight.mcap", (site / "vehicle.tlog").read_bytes()


@pytest.mark.skipif(_mavproxy() is None, reason="MAVProxy is not installed (mavproxy.py or $MAVPROXY)")
def test_mavproxy_sees_every_message_in_order(
    telemetry: tuple[Path, bytes], acquire: Acquire, tmp_path: Path
) -> None:
    log, telemetry_log = telemetry
    port = free_port()
    seen = tmp_path / "seen.tlog"
    peer = subprocess.Popen(
        [
            str(_mavproxy()), f"--master=udpin:127.0.0.1:{port}", "--daemon", "--non-interactive",
            f"--logfile={seen}", f"--state-basedir={tmp_path}", "--default-modules=log", "--streamrate=-1",
        ],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=tmp_path,
    )  # fmt: skip
    try:
        until(lambda: is_bound(port), "the port of MAVProxy")
        # Its log is written in blocks: the second time pushes out the first.
        for _ in range(2):
            done = acquire(
                "replay", log, "--link", "vehicle", "--to", f"udp://127.0.0.1:{port}", "--speed", 20
            )
            assert done.returncode == 0, done.stderr
        sent = _records(telemetry_log)
        ours = {frame[5] for frame in sent}

        def got() -> list[bytes]:
            return [frame for frame in _records(seen.read_bytes()) if len(frame) > 5 and frame[5] in ours]

        until(lambda: len(got()) > len(sent), "the log of MAVProxy")
    finally:
        peer.kill()
        peer.communicate()
    assert got()[: len(sent)] == sent

"""Programs of others take what we give: pymavlink our telemetry log, RTKLIB our streams."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink import mavutil

from acquire.importing.importer import import_recordings
from drivers import nmea
from drivers.ubx import wire as ubx

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
    command = [sys.executable, "-m", "acquire.cli", "replay", str(flight), "--link", "rover", "--speed", "0"]
    replay = subprocess.Popen(
        [*command, "--to", "tcp://127.0.0.1:0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert replay.stderr is not None
    port = replay.stderr.readline().strip().rpartition(":")[2]
    copy = tmp_path / "copy.ubx"
    peer = subprocess.Popen(
        ["str2str", "-in", f"tcpcli://127.0.0.1:{port}", "-out", f"file://{copy}"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    expected = (tmp_path / "rover.ubx").read_bytes()
    end = time.monotonic() + 30
    while time.monotonic() < end and (not copy.exists() or copy.stat().st_size < len(expected)):
        time.sleep(0.1)
    peer.terminate()
    peer.communicate(timeout=20)
    replay.kill()
    replay.communicate()
    assert copy.read_bytes() == expected

"""A recording that is killed in mid-flight and started again: both logs are one flight."""

from __future__ import annotations

import signal
import socket
import struct
from pathlib import Path

from drivers import ubx
from drivers.frames import StreamFramer, Wire
from drivers.ubx import decode as ubx_decode
from photocal.navigation.flight_log import FlightLog
from tests.acquire.live import Recorder, await_frame, free_port, is_bound, until


def epoch(number: int) -> bytes:
    """An RXM-RAWX epoch; its time of week is its number."""
    return ubx.encode(0x0215, struct.pack("<dHbBBB2x", float(number), 2300, 18, 1, 1, 1) + bytes(32))


def send(sender: socket.socket, path: Path, numbers: range) -> None:
    for number in numbers:
        sender.send(epoch(number))
    # Until the last one is safe in the file.
    await_frame(path, "rover", epoch(numbers[-1]))


def test_both_logs_are_one_flight(tmp_path: Path) -> None:
    port = free_port()
    configuration = tmp_path / "flight.toml"
    configuration.write_text(
        '[recording]\noutput = "logs"\nflush_s = 0.1\n'
        f'[[link]]\nname = "rover"\nprotocol = "ubx"\nurl = "udp://127.0.0.1:{port}"\n'
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        with Recorder(configuration) as first:
            until(lambda: is_bound(port), "the port of the rover")
            send(sender, first.path, range(100))
            first.end(signal.SIGKILL)
        with Recorder(configuration) as second:
            until(lambda: is_bound(port), "the port of the rover")
            send(sender, second.path, range(100, 200))
            second.figures()
    logs = tuple(sorted((tmp_path / "logs").iterdir()))
    assert len(logs) == 2
    assert any(f"{logs[0]} was not closed" in line for line in second.told)
    # What reads the logs for the trajectory sees one stream, the killed log unrepaired.
    frames = [
        frame for _, messages in FlightLog(logs).raw(Wire.UBX, link="rover") for frame in messages.payloads
    ]
    epochs = ubx_decode.decode_rawx(StreamFramer((Wire.UBX,)).feed(b"".join(frames)))
    assert epochs.fields["rcvTow"].tolist() == list(range(200))

"""A recording that is killed in mid-flight and started again: both logs are one flight."""

from __future__ import annotations

import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

from acquire.log.replay import raw_frames
from drivers.frames import Wire
from drivers.framing import StreamFramer
from drivers.ubx import decode as ubx_decode
from drivers.ubx import wire as ubx
from photocal.navigation.flight_log import messages_of


def epoch(number: int) -> bytes:
    """An RXM-RAWX epoch; its time of week is its number."""
    return ubx.encode(0x0215, struct.pack("<dHbBBB2x", float(number), 2300, 18, 1, 1, 1) + bytes(32))


def recorder(configuration: Path, port: int) -> tuple[subprocess.Popen[str], Path]:
    command = [sys.executable, "-m", "acquire.cli", "record", str(configuration)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    path = Path(process.stderr.readline().removeprefix("recording to ").strip())
    bound = f":{port:04X}"
    while not any(bound in line.split()[1] for line in Path("/proc/net/udp").read_text().splitlines()[1:]):
        time.sleep(0.02)
    return process, path


def send(sender: socket.socket, path: Path, numbers: range) -> None:
    for number in numbers:
        sender.send(epoch(number))
    # Until the last one is safe in the file.
    while not any(frame == epoch(numbers[-1]) for _, frame in raw_frames(path, "rover")):
        time.sleep(0.1)


def test_both_logs_are_one_flight(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    configuration = tmp_path / "flight.toml"
    configuration.write_text(
        '[recording]\noutput = "logs"\nflush_s = 0.1\n'
        f'[[link]]\nname = "rover"\nprotocol = "ubx"\nurl = "udp://127.0.0.1:{port}"\n'
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        first, path = recorder(configuration, port)
        send(sender, path, range(100))
        first.kill()
        first.communicate()
        second, path = recorder(configuration, port)
        send(sender, path, range(100, 200))
        second.send_signal(signal.SIGTERM)
        assert second.stderr is not None
        # What the reader of the first line holds already would be lost to communicate() alone.
        told = second.stderr.read()
        second.communicate(timeout=20)
    logs = tuple(sorted((tmp_path / "logs").iterdir()))
    assert len(logs) == 2
    assert f"{logs[0]} has no end" in told
    # What reads the logs for the trajectory sees one stream, the killed log unrepaired.
    frames = [
        frame
        for messages in messages_of(logs)
        if messages.channel.topic == "/rover/raw"
        for frame in messages.payloads
    ]
    epochs = ubx_decode.decode_rawx(StreamFramer((Wire.UBX,)).feed(b"".join(frames))).epochs
    assert epochs.fields["rcvTow"].tolist() == list(range(200))

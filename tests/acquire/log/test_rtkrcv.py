"""RTKLIB's rtkrcv counts the observations of a replayed receiver stream."""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.acquire.live import PATIENCE_S, Process

pytestmark = [
    pytest.mark.shared,
    pytest.mark.skipif(shutil.which("rtkrcv") is None, reason="RTKLIB's rtkrcv is not installed (rtklib)"),
]
SETTINGS = """pos1-posmode=single
pos1-navsys=1
inpstr1-type=tcpcli
inpstr1-path=127.0.0.1:{port}
inpstr1-format=ubx
inpstr2-type=off
inpstr3-type=off
outstr1-type=off
outstr2-type=off
logstr1-type=off
misc-svrcycle=10
misc-buffsize=1000000
"""


def converse(terminal: int, command: bytes, seconds: float) -> str:
    os.write(terminal, command)
    said, end = b"", time.monotonic() + seconds
    while time.monotonic() < end:
        ready, _, _ = select.select([terminal], [], [], 0.1)
        if ready:
            with contextlib.suppress(OSError):
                said += os.read(terminal, 65536)
    return said.decode("latin-1")


def epochs(data: bytes) -> int:
    """Count whole RXM-RAWX messages by a plain walk along the checksummed frames."""
    count, at = 0, 0
    while (at := data.find(b"\xb5\x62\x02\x15", at)) >= 0:
        end = at + 8 + int.from_bytes(data[at + 4 : at + 6], "little")
        first = second = 0
        for value in data[at + 2 : end - 2]:
            first = (first + value) & 0xFF
            second = (second + first) & 0xFF
        intact = end <= len(data) and (first, second) == (data[end - 2], data[end - 1])
        count += intact
        at = end if intact else at + 1
    return count


@pytest.mark.slow
def test_rtkrcv_counts_every_epoch(logs: dict[str, Path], shared: Path, tmp_path: Path) -> None:
    name = "data/gnss-ubx-m8p-base-rover/rover-20181004-1237.ubx.gz"
    expected = epochs(gzip.decompress((shared / name).read_bytes()))
    command = [sys.executable, "-m", "acquire", "replay", str(logs["m8p"]), "--link", "rover"]
    replay = Process([*command, "--speed", "0", "--to", "tcp://127.0.0.1:0"])
    port = replay.line(" to ").rpartition(":")[2]
    settings = tmp_path / "rtkrcv.conf"
    settings.write_text(SETTINGS.format(port=port))
    # Its console wants a terminal.
    ours, theirs = pytest.importorskip("pty", reason="Windows has no such terminals").openpty()
    peer = subprocess.Popen(
        ["rtkrcv", "-o", str(settings)],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        cwd=tmp_path,
        start_new_session=True,
        preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),
    )
    try:
        said, end = "", time.monotonic() + PATIENCE_S
        while "server start" not in said and time.monotonic() < end:
            # What is said before the console is ready is not heard.
            said += converse(ours, b"start\r", 1.5)
        counted = ""
        while counted != str(expected) and time.monotonic() < end:
            said += converse(ours, b"status\r", 1)
            found = re.findall(r"input data rover\s*: obs\((\d+)\).*err\((\d+)\)", said)
            counted = found[-1][0] if found and found[-1][1] == "0" else ""
    finally:
        peer.send_signal(signal.SIGKILL)
        peer.wait()
        replay.end(signal.SIGKILL)
        os.close(ours)
        os.close(theirs)
    assert counted == str(expected), said

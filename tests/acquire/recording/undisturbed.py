"""A good link beside one that is disturbed: what of it is due, and what of that is lost."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from acquire.importing.recovery import recover
from acquire.log.replay import raw_frames
from drivers import ubx
from photocal.base.errors import InputMalformedError
from tests.acquire.live import PATIENCE_S, free_port, is_bound, until

# What is older than this at a kill must be on the disk: a flush, the next one and room for a busy computer.
DUE_S = 1.2
EVERY_S = 0.01


def numbered(number: int) -> bytes:
    """Return a frame with its number."""
    return ubx.encode(0x0213, number.to_bytes(4, "little") + bytes(40))


class GoodLink:
    """Sends numbered frames to a port, a hundred a second, and knows when each was sent.

    Parameters
    ----------
    port : int
        UDP port of this computer.
    """

    def __init__(self, port: int) -> None:
        self.sent: list[tuple[float, bytes]] = []
        self._port = port
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self) -> Self:
        until(lambda: is_bound(self._port), "the port of the good link")
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """Send no more."""
        self._stop.set()
        self._thread.join()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.connect(("127.0.0.1", self._port))
            while not self._stop.is_set():
                frame = numbered(len(self.sent))
                with contextlib.suppress(ConnectionRefusedError):
                    line.send(frame)
                    self.sent.append((time.monotonic(), frame))
                time.sleep(EVERY_S)

    def lost(self, folder: Path, at_s: float) -> int:
        """Return how many frames that were due at a moment are in no log of a folder."""
        kept = kept_in(folder, "good")
        due = [frame for sent_s, frame in self.sent if at_s - sent_s > DUE_S]
        assert len(due) > 50, "nothing was due"
        return sum(frame not in kept for frame in due)


def kept_in(folder: Path, link: str) -> set[bytes]:
    """Return the frames of a link in all logs of a folder and of those in it, as recover gives them."""
    kept: set[bytes] = set()
    with tempfile.TemporaryDirectory() as name:
        for number, log in enumerate(folder.rglob("*.mcap")):
            fixed = Path(name) / f"{number}.mcap"
            # One that was only just begun has nothing to give.
            with contextlib.suppress(InputMalformedError):
                recover(log, fixed)
                kept |= {frame for _, frame in raw_frames(fixed, link)}
    return kept


def configured(folder: Path, *links: tuple[str, str, str, str]) -> tuple[Path, int]:
    """Write a configuration with a good link and others (name, protocol, url, further lines)."""
    port = free_port()
    every = [("good", "ubx", f"udp://127.0.0.1:{port}", "silent_s = 600"), *links]
    text = "".join(
        f'[[link]]\nname = "{name}"\nprotocol = "{protocol}"\nurl = "{url}"\n{more}\n'
        for name, protocol, url, more in every
    )
    path = folder / "flight.toml"
    path.write_text('[recording]\noutput = "logs"\nleast_free_mb = 0\n' + text)
    return path, port


@contextlib.contextmanager
def recording(configuration: Path, *more: str, **streams: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run `acquire record` with its streams as they are wanted; it is killed at the end."""
    command = [sys.executable, "-m", "acquire.cli", "record", str(configuration), *more]
    process = subprocess.Popen(command, **streams)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def stopped(process: subprocess.Popen[bytes], order: int = signal.SIGINT) -> float:
    """Send a signal, wait for the end and return how long it took, seconds."""
    began_s = time.monotonic()
    process.send_signal(order)
    process.wait(PATIENCE_S)
    return time.monotonic() - began_s

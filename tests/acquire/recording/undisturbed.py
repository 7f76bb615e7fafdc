"""A good link beside one that is disturbed: what of it is due, and what of that is lost."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

from acquire.importing.recovery import recover
from acquire.log.chunk import MAGIC
from acquire.log.replay import raw_frames
from drivers import ubx
from photocal.base.errors import InputMalformedError
from tests.acquire.live import PATIENCE_S, free_port, full_pipe, is_bound, until

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
    command = [sys.executable, "-m", "acquire", "record", str(configuration), *more]
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


def with_a_mute_link(folder: Path) -> tuple[Path, int]:
    """Configure a link that raises an alarm soon."""
    mute = f"udp://127.0.0.1:{free_port()}"
    return configured(folder, ("mute", "ubx", mute, "silent_s = 0.3"))


@contextlib.contextmanager
def paused_terminal() -> Iterator[int]:
    """Give a terminal on which somebody has pressed Ctrl-S."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    termios.tcflow(theirs, termios.TCOOFF)
    yield theirs
    for end in (ours, theirs):
        os.close(end)


@contextlib.contextmanager
def closed_pipe() -> Iterator[int]:
    """Give a pipe whose reader has gone, as that of `| head -1`."""
    ours, theirs = os.pipe()
    os.close(ours)
    yield theirs
    os.close(theirs)


@contextlib.contextmanager
def full_disk() -> Iterator[int]:
    """Give a file on a disk without room."""
    with Path("/dev/full").open("wb") as file:
        yield file.fileno()


Output = Callable[[], contextlib.AbstractContextManager[int]]
OUTPUTS: tuple[Output, ...] = (paused_terminal, full_pipe, closed_pipe, full_disk)
# What waits for an output waits each time; a machine that is busy with other tests is slow now and then.
STOP_S, ATTEMPTS = 0.5, 3


def stops_in_time(output: Output, order: int, place: Path) -> None:
    """Stop a recorder by a signal whose output takes nothing: all that was sent is in its log."""
    took_s: list[float] = []
    while len(took_s) < ATTEMPTS and min(took_s, default=STOP_S) >= STOP_S:
        folder = place / str(len(took_s))
        folder.mkdir()
        path, port = with_a_mute_link(folder)
        with output() as end, recording(path, "--json", stdout=end, stderr=end) as recorder:
            with GoodLink(port) as good:
                time.sleep(1.0)
                assert recorder.poll() is None
            took_s.append(stopped(recorder, order))
        (log,) = (folder / "logs").iterdir()
        assert log.read_bytes().endswith(MAGIC)
        assert {frame for _, frame in good.sent} == kept_in(folder, "good")
        assert recorder.returncode == 0
    assert min(took_s) < STOP_S, took_s

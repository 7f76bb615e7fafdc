"""Recorders and ports at work: tests wait for what has happened, never for a time."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from acquire.log.chunk import MAGIC
from acquire.log.replay import raw_frames

Found = TypeVar("Found")

# How long a busy machine may take; a quiet one needs none of it.
PATIENCE_S = 120.0
_POLL_S = 0.02
# Below those that the system gives away by itself (ip_local_port_range begins at 32768).
_PORTS = range(10_000, 32_000)


@contextlib.contextmanager
def full_pipe() -> Iterator[int]:
    """Give a pipe that is full, which nobody reads."""
    ours, theirs = os.pipe()
    os.set_blocking(theirs, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(theirs, b"x" * 512)
    os.set_blocking(theirs, True)
    yield theirs
    for end in (ours, theirs):
        os.close(end)


def until(look: Callable[[], Found], what: str) -> Found:
    """Wait until a look finds something, and return it."""
    end = time.monotonic() + PATIENCE_S
    while not (found := look()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(_POLL_S)
    return found


def free_port() -> int:
    """Return a port that is free for datagrams and streams, and that the system gives to nobody else."""
    while True:
        port = random.SystemRandom().choice(_PORTS)
        try:
            for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
                with socket.socket(socket.AF_INET, kind) as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return port


def is_bound(port: int) -> bool:
    """Tell whether somebody takes datagrams at a port (proc(5))."""
    lines = Path("/proc/net/udp").read_text().splitlines()[1:]
    return any(line.split()[1].endswith(f":{port:04X}") for line in lines)


class Process:
    """A running program whose lines on the standard error are kept from the first one on.

    They are read in a thread of their own: what a reader of single lines had buffered would be missing in
    what `communicate` returns. As a context it leaves no process behind.
    """

    def __init__(self, command: list[str], cwd: Path | None = None) -> None:
        self.told: list[str] = []
        self._output: list[str] = []
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd
        )
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self._readers = [
            threading.Thread(target=lines.extend, args=(stream,), daemon=True)
            for lines, stream in ((self._output, self.process.stdout), (self.told, self.process.stderr))
        ]
        for reader in self._readers:
            reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.ended()

    def line(self, words: str) -> str:
        """Wait for a line with some words and return it."""

        def look() -> str:
            ended = self.process.poll() is not None
            found = next((line for line in list(self.told) if words in line), "")
            assert found or not ended, f"it has ended without {words!r}: {self.told}"
            return found

        return until(look, words).strip()

    def end(self, order: int = signal.SIGTERM) -> str:
        """Send a signal, wait for the end and return what was printed."""
        self.process.send_signal(order)
        return self.ended()

    def ended(self) -> str:
        """Wait for the end and return what was printed."""
        self.process.wait(PATIENCE_S)
        for reader in self._readers:
            reader.join()
        for stream in (self.process.stdout, self.process.stderr):
            assert stream is not None
            stream.close()
        return "".join(self._output)


class Recorder(Process):
    """`acquire record` with a configuration."""

    def __init__(self, configuration: Path, *program: str) -> None:
        command = [
            *(program or (sys.executable, "-m", "acquire")),
            "record",
            str(configuration),
            "--json",
        ]
        super().__init__(command)
        self.path = Path(self.line("recording to ").removeprefix("recording to "))

    def figures(self) -> dict[str, Any]:
        """Stop it properly and return the figures that it prints."""
        printed = self.end()
        assert self.process.returncode == 0, self.told
        figures: dict[str, Any] = json.loads(printed)
        return figures


def frames_in(place: Path, link: str) -> list[bytes]:
    """Return the raw frames of a link that are in a log, or in those of a folder, by now."""
    logs = [place] if place.suffix == ".mcap" else sorted(place.glob("*.mcap"))
    # A log that has just been made is empty for a moment.
    return [frame for log in logs if log.stat().st_size >= len(MAGIC) for _, frame in raw_frames(log, link)]


def await_frame(place: Path, link: str, frame: bytes) -> None:
    """Wait until a frame of a link is in a log, or in one of a folder."""
    until(lambda: frame in frames_in(place, link), f"a frame of {link}")

"""A recording in this process whose ports follow a script."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from acquire.recording.configuration import RecordingConfiguration
from acquire.recording.recorder import Host, Recorded, record
from acquire.transports.sources import LinkLostError, Source
from tests.acquire.live import until


class Script(Source):
    """The twin of a port: gives what it is told to give, and keeps what was written."""

    def __init__(self, pieces: list[bytes | str]) -> None:
        super().__init__()
        self.written: list[bytes] = []
        self._pieces = pieces

    def open(self, _stop: threading.Event) -> None:
        pass

    def read(self, timeout_s: float) -> bytes:
        if not self._pieces:
            time.sleep(timeout_s)
            return b""
        piece = self._pieces.pop(0)
        if isinstance(piece, bytes):
            return piece
        if piece == "unplug":
            raise LinkLostError("unplugged")
        self.peer = piece
        return b""

    @property
    def exhausted(self) -> bool:
        """Whether all was given."""
        return not self._pieces

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def close(self) -> None:
        pass


def run(
    configuration: dict[str, Any],
    folder: Path,
    reached: Callable[[list[str]], bool],
    host: Host | None = None,
    sources: Any = None,
) -> tuple[Recorded, list[str]]:
    """Record until a condition on what was told holds."""
    told: list[str] = []
    stop = threading.Event()
    chosen = RecordingConfiguration.model_validate(configuration)
    with ThreadPoolExecutor(1) as pool:
        recording = pool.submit(record, chosen, folder, stop, told.append, host, sources)
        try:
            until(lambda: recording.done() or reached(told), "what the recording waits for")
        finally:
            stop.set()
        return recording.result(), told


def said(*words: str) -> Callable[[list[str]], bool]:
    """Return the condition that all words were told."""
    return lambda told: all(any(word in line for line in told) for word in words)


def configured(*links: dict[str, Any], **recording: Any) -> dict[str, Any]:
    """Return a configuration whose links may be silent for long."""
    patient = [{"silent_s": 600, **link} for link in links]
    return {"recording": {"output": "logs", "least_free_mb": 0, **recording}, "link": patient}


def messages(path: Path, topic: str) -> list[Any]:
    """Return the messages of a topic as the published reader gives them."""
    with path.open("rb") as stream:
        return [m.data for _, _, m in make_reader(stream).iter_messages(topics=[topic])]

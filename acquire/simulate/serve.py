"""Simulated devices on real ports: UDP and pseudo terminals."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
import tty
from collections.abc import Iterator
from typing import Protocol

_TICK_S = 0.005


class Device(Protocol):
    """A simulated device: what it sends by itself and what it answers."""

    def due(self, time_s: float) -> bytes:
        """Return what is sent of its own accord up to a moment, seconds after the start."""
        ...

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes of the host; return the answers."""
        ...


@contextlib.contextmanager
def on_udp(device: Device, host: str, port: int) -> Iterator[None]:
    """Let a device speak to a UDP port, each answer in a datagram of its own."""
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind(("127.0.0.1", 0))

    def send(data: bytes) -> None:
        with contextlib.suppress(OSError):
            line.sendto(data, (host, port))

    with line, _serving(device, line.fileno(), send):
        yield


@contextlib.contextmanager
def on_pty(device: Device) -> Iterator[str]:
    """Let a device speak on a pseudo terminal; yields the path of the port."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)

    def send(data: bytes) -> None:
        # A line without a listener fills up; a receiver would lose the bytes, too.
        with contextlib.suppress(OSError):
            os.write(ours, data)

    try:
        with _serving(device, ours, send):
            yield os.ttyname(theirs)
    finally:
        os.close(ours)
        os.close(theirs)


class _Send(Protocol):
    def __call__(self, data: bytes, /) -> None: ...


@contextlib.contextmanager
def _serving(device: Device, descriptor: int, send: _Send) -> Iterator[None]:
    stop = threading.Event()
    start = time.monotonic()

    def run() -> None:
        while not stop.is_set():
            ready, _, _ = select.select([descriptor], [], [], _TICK_S)
            now = time.monotonic() - start
            data = b""
            if ready:
                with contextlib.suppress(OSError):
                    data = os.read(descriptor, 65536)
            out = (device.receive(data, now) if data else b"") + device.due(now)
            if out:
                send(out)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(5)

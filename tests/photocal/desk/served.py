"""Servers of the window and of its places, as processes of their own."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# Starts a command at a port; gives its process once it serves.
Start = Callable[..., subprocess.Popen[str]]


def free_port() -> int:
    """Find a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def serving_at(port: int) -> Iterator[Start]:
    """Start commands one after another at a port; all are killed in the end."""
    running: list[subprocess.Popen[str]] = []

    def start(*arguments: object) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "photocal", *map(str, arguments), "--address", f"127.0.0.1:{port}"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        assert process.stdout is not None
        assert process.stdout.readline().startswith(f"open http://127.0.0.1:{port}/ ")
        return process

    try:
        yield start
    finally:
        for process in running:
            process.kill()
            process.communicate()

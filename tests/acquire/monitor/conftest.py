"""A browser, a field at work, and monitors of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.acquire.live import free_port

Monitor = Callable[..., tuple[subprocess.Popen[str], str]]


@pytest.fixture(scope="module")
def monitor() -> Iterator[Monitor]:
    """Start `acquire monitor` with arguments; returns the process and the first line that it prints."""
    running: list[subprocess.Popen[str]] = []

    def start(source: Path, *arguments: object) -> tuple[subprocess.Popen[str], str]:
        command = [sys.executable, "-m", "acquire", "monitor", str(source), *map(str, arguments)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        running.append(process)
        assert process.stdout is not None
        return process, process.stdout.readline().strip()

    yield start
    for process in running:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def port() -> int:
    return free_port()

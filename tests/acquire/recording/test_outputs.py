"""A stop waits for no terminal, pipe or disk that takes nothing of what the recorder says."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.acquire.recording.undisturbed import OUTPUTS, Output, stops_in_time


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("output", OUTPUTS)
def test_a_stop_waits_for_no_output(output: Output, order: int, tmp_path: Path) -> None:
    stops_in_time(output, order, tmp_path)

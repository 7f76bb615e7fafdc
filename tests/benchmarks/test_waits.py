"""Recorded flights from nothing: whether the remaining time that a run tells is right, and its peak memory.

Rows as those of `remaining_time`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.benchmarks.remaining_time import HEAD, row, told

pytestmark = [pytest.mark.shared, pytest.mark.timeout(3600)]
FLIGHTS = ("flight-caliterra-twelve", "flight-lewis-ten", "uav-brighton-beach/images", "kite-warsaw/images")


@pytest.mark.parametrize("flight", FLIGHTS)
def test_remaining_time(
    flight: str, shared: Path, tmp_path: Path, benchmark: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(shared / "data" / flight, tmp_path / "images")
    subprocess.run([sys.executable, "-m", "photocal", "new", str(tmp_path)], check=True, capture_output=True)
    lines, whole, peak = benchmark.pedantic(told, (tmp_path / "project.toml",), rounds=1)
    assert lines
    with capsys.disabled():
        print(f"\n{HEAD}\n{row(flight.split('/', maxsplit=1)[0], lines, whole, peak)}")

"""What analysis and check cost beside the adjustment of the same flight; nothing here asserts a time.

PHOTOCAL_BENCH_JUDGED names the flights by images and rays of an image (default "30:100 300:100 1000:100
32:2155"). Figures go to .benchmarks/judging.json.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import pytest

from tests.benchmarks.test_engine_speed import ROOT, keep, run

FLIGHTS = os.environ.get("PHOTOCAL_BENCH_JUDGED", "30:100 300:100 1000:100 32:2155").split()

pytestmark = pytest.mark.timeout(7200)


@pytest.mark.parametrize("flight", FLIGHTS)
def test_judging_beside_adjusting(flight: str, benchmark: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Processor time of the steps in one process, medians of three."""
    images, rays = flight.split(":")
    command = (sys.executable, "-m", "tests.benchmarks.judge_block", images, rays)
    figures = benchmark.pedantic(run, command, {"folder": ROOT}, rounds=1)
    benchmark.extra_info.update(figures)
    keep(flight, figures, "judging.json")
    adjust = figures["adjust_s"]
    with capsys.disabled():
        print(
            f"\n{figures['images']} images, {figures['rays']} rays: adjust {adjust:.3f} s, "
            f"analyse {figures['analyse_s'] / adjust:.1f} of it, check {figures['check_s'] / adjust:.1f}"
        )

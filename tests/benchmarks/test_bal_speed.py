"""Problems of BAL's form beside Ceres: time to the minimum and to the covariance of everything.

PHOTOCAL_BAL names the shapes or files (default: the small ones, "ladybug-49 ladybug-372"); PHOTOCAL_PEERS is
the Python that has pyceres and pycolmap. Figures go to .benchmarks/bal.json. Nothing here asserts a time.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import pytest

from tests.benchmarks.test_engine_speed import ROOT, keep, run

PROBLEMS = os.environ.get("PHOTOCAL_BAL", "ladybug-49 ladybug-372").split()

pytestmark = pytest.mark.timeout(7200)


@pytest.mark.parametrize("problem", PROBLEMS)
def test_bal(problem: str, benchmark: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Solve, then covariance; the same minimum as Ceres to 1e-6 of v'Pv, or a lower one."""
    command = (sys.executable, "-m", "tests.benchmarks.bal", problem, "--ceres")
    figures = benchmark.pedantic(run, command, {"folder": ROOT}, rounds=1)
    ours, theirs = figures["photocal"], figures.get("ceres", {})
    assert ours["redundancy_sum"] == pytest.approx(ours["redundancy"], rel=1e-9)
    size = f"{ours['images']} images, {ours['points']} points, {ours['rays']} rays"
    seconds = f"solution {ours['solve_s']:.2f} s, covariance of all {ours['covariance_s']:.2f} s"
    lines = [f"\n{problem}: {size}, {seconds}, peak {ours['peak_gib']:.2f} GiB"]
    if "vtpv" in theirs:
        limit = f"not within {theirs['covariance_limit_s']:.0f} s"
        own = f"{theirs['colmap_all_s']:.2f} s" if "colmap_all_s" in theirs else limit
        ratio = f"Ceres {theirs['solve_s']:.2f} s, {figures['solve_ratio']:.1f} times as long"
        excess = f"our v'Pv less theirs {figures['vtpv_excess']:+.1e} of it"
        lines.append(f"{ratio}; COLMAP's covariance of all {own}; {excess}")
        assert figures["vtpv_excess"] < 1e-6
    else:
        lines.append("Ceres not run: PHOTOCAL_PEERS names no Python that has pyceres and pycolmap")
    benchmark.extra_info.update(figures)
    keep(problem, figures, "bal.json")
    with capsys.disabled():
        print("\n".join(lines))

"""The engine and Ceres on the same synthetic blocks, one after the other; nothing here asserts a time.

PHOTOCAL_BENCH_SIZES names the blocks by their number of images (default "50 200 1000"; 5000 needs most
of 24 GiB and is not given to Ceres). PHOTOCAL_PEERS is the Python of an environment with pyceres and
pycolmap; without it only the engine runs. Figures go to .benchmarks/engine.json.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / ".benchmarks"
POINTS = {50: 20_000, 200: 100_000, 1000: 500_000, 5000: 2_500_000}
LARGEST_FOR_CERES = 1000
SIZES = [int(size) for size in os.environ.get("PHOTOCAL_BENCH_SIZES", "50 200 1000").split()]

pytestmark = [pytest.mark.shared, pytest.mark.timeout(7200)]


def run(*command: str | Path, folder: Path) -> dict[str, Any]:
    """Run a solver; its figures stand in its line RESULT."""
    made = subprocess.run(
        [str(part) for part in command], cwd=folder, capture_output=True, text=True, check=False
    )
    lines = [line for line in made.stdout.splitlines() if line.startswith("RESULT ")]
    assert made.returncode == 0, made.stderr[-2000:]
    assert lines, made.stdout[-2000:]
    figures: dict[str, Any] = json.loads(lines[-1].removeprefix("RESULT "))
    return figures


@pytest.fixture(scope="module")
def yardsticks(shared: Path) -> Path:
    """Folder with the scripts that make blocks and run the peers."""
    return shared / "bench"


@pytest.fixture(scope="module")
def peers() -> str | None:
    """Python with Ceres; None when there is none."""
    python = os.environ.get("PHOTOCAL_PEERS")
    if not python:
        return None
    probe = [python, "-c", "import pyceres, pycolmap"]
    return python if subprocess.run(probe, capture_output=True, check=False).returncode == 0 else None


def block(size: int, yardsticks: Path) -> Path:
    """The block of a size; kept from run to run."""
    path = RESULTS / f"block-{size}.npz"
    if not path.exists():
        RESULTS.mkdir(exist_ok=True)
        made = path.with_suffix(".partial.npz")
        command = [sys.executable, str(yardsticks / "make_block.py"), str(size), str(POINTS[size]), str(made)]
        subprocess.run(command, check=True, capture_output=True)
        made.replace(path)
    return path


def keep(size: int | str, figures: dict[str, Any], name: str = "engine.json") -> None:
    """Put the figures of one size beside those of the others."""
    path = RESULTS / name
    RESULTS.mkdir(exist_ok=True)
    known = json.loads(path.read_text()) if path.exists() else {}
    known[str(size)] = figures
    path.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n")


def told(size: int, ours: dict[str, Any]) -> str:
    """Our figures in words."""
    share = ours["covariance_s"] / ours["solve_s"]
    return (
        f"\n{size} images, {ours['rays']} rays: {ours['iterations']} iterations in {ours['solve_s']:.2f} s"
        f" ({ours['s_per_iteration']:.3f} s each), covariance {ours['covariance_s']:.2f} s"
        f" ({share:.2f} of the solution), peak {ours['peak_gib']:.2f} GiB"
    )


def compared(figures: dict[str, Any]) -> str:
    """Ratios in words."""
    theirs = figures["ceres"]
    return (
        f"Ceres {theirs['solve_s']:.2f} s, {figures['solve_ratio']:.1f} times as long;"
        f" its poses' covariance {theirs['colmap_cov_s']:.2f} s;"
        f" our v'Pv less theirs {figures['vtpv_excess']:+.1e} of it, peak {theirs['peak_gib']:.2f} GiB"
    )


@pytest.mark.parametrize("size", SIZES)
def test_engine_and_ceres(
    size: int,
    yardsticks: Path,
    peers: str | None,
    benchmark: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Solve, then covariance; the same minimum as Ceres to 1e-8 of v'Pv, or a lower one."""
    path = block(size, yardsticks)
    repeat = "3" if size <= 200 else "1"
    command = (sys.executable, "-m", "tests.benchmarks.adjust_block", path, "--repeat", repeat)
    ours = benchmark.pedantic(run, command, {"folder": ROOT}, rounds=1)
    figures: dict[str, Any] = {"photocal": ours}
    lines = [told(size, ours)]
    assert ours["redundancy_sum"] == pytest.approx(ours["redundancy"], rel=1e-9)
    if peers is None:
        lines.append("Ceres not run: PHOTOCAL_PEERS names no Python that has pyceres and pycolmap")
    elif size > LARGEST_FOR_CERES:
        lines.append(f"Ceres not run: more than {LARGEST_FOR_CERES} images")
    else:
        theirs = run(peers, yardsticks / "run_ceres.py", path, folder=yardsticks)
        excess = ours["vtpv"] / theirs["vtpv"] - 1
        figures |= {
            "ceres": theirs,
            "solve_ratio": theirs["solve_s"] / ours["solve_s"],
            "covariance_ratio": theirs["colmap_cov_s"] / ours["covariance_s"],
            "vtpv_excess": excess,
        }
        lines.append(compared(figures))
        assert excess < 1e-8
    benchmark.extra_info.update(figures)
    keep(size, figures)
    with capsys.disabled():
        print("\n".join(lines))

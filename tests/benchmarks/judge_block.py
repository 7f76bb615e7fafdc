"""What analysis and check of a flight cost beside its adjustment: one line of figures.

Processor time of each step, all threads together, in one process that has loaded everything before; medians.

Usage: python -m tests.benchmarks.judge_block IMAGES RAYS_PER_IMAGE [--stated F] [--repeat N] [--profile STEP]
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import photocal
from photocal.adjustment.ledger import ledger
from tests.evidence.judging import fly
from tests.independent.flights import Design, Errors

# Loads what is compiled, and every import.
SMALL = Design("small", images=12, per_image=60)


def steps(block: photocal.Block) -> dict[str, Callable[[], object]]:
    """What a person runs of a block, the adjustment first."""
    result = photocal.adjust(block)
    return {
        "adjust": lambda: photocal.adjust(block),
        "analyse": lambda: photocal.analyse(block, result),
        "check": lambda: photocal.check(block),
    }


def flown(design: Design, folder: Path, stated: float = 1.0) -> photocal.Block:
    """A clean flight of a design, whose positions state so many times their standard deviations."""
    block = photocal.read_block(fly(folder, design, Errors(), 0).folder)
    covariance = block.positions.covariance * stated**2
    return replace(block, positions=replace(block.positions, covariance=covariance))


def measure(block: photocal.Block, repeat: int) -> dict[str, object]:
    """Processor seconds of each step, and the adjustments that it made."""
    figures: dict[str, object] = {}
    for name, step in steps(block).items():
        seconds = []
        for _ in range(repeat):
            with ledger() as entries:
                began = time.process_time()
                step()
                seconds.append(time.process_time() - began)
        figures |= {f"{name}_s": statistics.median(seconds), f"{name}_adjustments": len(entries)}
    return figures


def main() -> None:
    """Measure the flight that the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("images", type=int)
    parser.add_argument("rays_per_image", type=int)
    parser.add_argument("--stated", type=float, default=1.0, help="sigmas of positions over the true ones")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--profile", choices=("adjust", "analyse", "check"))
    asked = parser.parse_args()
    design = Design("flight", images=asked.images, per_image=asked.rays_per_image, control=10)
    with tempfile.TemporaryDirectory() as scratch:
        for step in steps(flown(SMALL, Path(scratch) / "small")).values():
            step()
        block = flown(design, Path(scratch) / "flight", asked.stated)
    if asked.profile:
        step, profile = steps(block)[asked.profile], cProfile.Profile(time.process_time)
        profile.runcall(step)
        pstats.Stats(profile, stream=sys.stdout).sort_stats("cumulative").print_stats(70)
        return
    figures = {"images": asked.images, "rays": len(block.observations.image)} | measure(block, asked.repeat)
    print("RESULT " + json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()

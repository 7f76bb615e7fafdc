"""Study of growth: what an adjustment and its analysis cost as a block becomes larger.

Flights are simulated; time is that of the processors, for a machine may have other work, after a first small
analysis has loaded all that is compiled. Each block has a process of its own, for its peak memory. Writes
`docs/evidence/growth.md`.

Run: `make evidence`, or `python -m tests.evidence.growth`. For one block alone:
`python -m tests.evidence.growth adjust|analyse IMAGES RAYS` prints its figures.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.adjusted import fit
from photocal.analysis.left_out import Checks
from photocal.analysis.outcome import analyse_network
from tests.benchmarks.adjust_block import measure
from tests.photocal.analysis.aerial import Flight, fly

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "growth.md"
# Images and rays of each; the third has the shape of a recorded block, the fifth the rays of dense matching.
SIZES = ((60, 12_000), (240, 48_000), (581, 108_000), (1000, 200_000), (1000, 2_500_000))
# Adjusted only: 500 points and 2 500 rays for each image.
LARGE = (200, 1000, 5000, 10_000)
RAYS, SEEN = 2_500, 0.46
NO_CHECKS = Checks(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def flight(images: int, rays: int) -> Flight:
    """A flight whose points five images see, or, where there are few points, all images that could."""
    return Flight(images, rays, share=SEEN if rays >= RAYS * images else 1.0)


def analysed(images: int, rays: int) -> dict[str, Any]:
    """Adjust and analyse a flight of a size."""
    analyse_network(fly(Flight(30, 3_000), 1).network, NO_CHECKS, 0.1, 0.8)
    network = fly(flight(images, rays), 4).network
    began = time.process_time()
    fitted = fit(network)
    adjusted, clock = time.process_time(), time.perf_counter()
    outcome = analyse_network(network, NO_CHECKS, 0.1, 0.8, start=fitted.state)
    return {
        "images": images,
        "rays": len(network.rays.image),
        "adjustment": adjusted - began,
        "analysis": time.process_time() - adjusted,
        "clock": time.perf_counter() - clock,
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "findings": [one.code for one in outcome.findings],
    }


def adjusted(images: int, rays: int) -> dict[str, Any]:
    """Adjust a flight of a size, with the covariance of everything."""
    fit(fly(Flight(30, 3_000), 1).network)
    return measure(fly(flight(images, rays), 4).network, 1)


def apart(what: str, images: int, rays: int) -> dict[str, Any]:
    """Figures of a block that a process of its own adjusts or analyses."""
    command = [sys.executable, "-m", "tests.evidence.growth", what, str(images), str(rays)]
    made = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    print(made.stdout, end="", flush=True)
    figures: dict[str, Any] = json.loads(made.stdout)
    return figures


ANALYSED = "images|rays|adjustment (s)|a ray (us)|analysis (s)|ratio|by the clock (s)|peak (MiB)|findings"
ADJUSTED = "images|points|rays|steps|minimum (s)|a ray (us)|covariance (s)|by the clock (s)|peak (GiB)"
ANALYSES = """# Growth of adjustment and analysis with the block

Made by `python -m tests.evidence.growth`. Times are processor seconds, summed over
the cores, except those by the clock. The adjustment begins at approximate values and ends with the covariance
of all unknowns; the analysis begins at its result. `c-on-positions` is a note, not an error: c of these
flights depends on a common error of the heights of their positions. `false_alarms.md` shows this for other
flights by moving the positions.
"""
ADJUSTMENTS = """
Large blocks: time to the minimum, in processor seconds and by the clock; then that of the covariance of
cameras, poses and every point, and of the redundancy of every ray. Compared with Ceres: `make bench`.
"""


def analysed_row(one: dict[str, Any]) -> str:
    """A line of the first table."""
    own, more = one["adjustment"], one["analysis"]
    times = f"{own:.2f}|{1e6 * own / one['rays']:.1f}|{more:.2f}|{more / own:.1f}|{one['clock']:.0f}"
    return f"{one['images']}|{one['rays']}|{times}|{one['peak']:.0f}|{', '.join(one['findings']) or '-'}"


def adjusted_row(one: dict[str, Any]) -> str:
    """A line of the second table."""
    own, more = one["solve_cpu_s"], one["covariance_cpu_s"]
    times = f"{own:.1f}|{1e6 * own / one['rays']:.1f}|{more:.1f}|{one['solve_s']:.1f}"
    return f"{one['images']}|{one['points']}|{one['rays']}|{one['iterations']}|{times}|{one['peak_gib']:.2f}"


def table(head: str, rows: Iterable[str]) -> str:
    """A table of cells that lines divide."""
    lines = [head, "|".join("---" for _ in head.split("|")), *rows]
    return "".join("| " + line.replace("|", " | ") + " |\n" for line in lines)


def page(analyses: list[dict[str, Any]], adjustments: list[dict[str, Any]]) -> str:
    """Write the figures as two tables."""
    first, second = map(analysed_row, analyses), map(adjusted_row, adjustments)
    return "\n".join((ANALYSES, table(ANALYSED, first), ADJUSTMENTS.lstrip("\n"), table(ADJUSTED, second)))


def main() -> None:
    """Run the study."""
    analyses = [apart("analyse", *size) for size in SIZES]
    adjustments = [apart("adjust", images, RAYS * images) for images in LARGE]
    OUTPUT.write_text(page(analyses, adjustments), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        done = {"analyse": analysed, "adjust": adjusted}[sys.argv[1]]
        print(json.dumps(done(int(sys.argv[2]), int(sys.argv[3]))))
    else:
        main()

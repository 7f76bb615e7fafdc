"""Study of growth: what an adjustment and its analysis cost as a block becomes larger.

Flights are simulated; time is that of the processors, for a machine may have other work, after a first small
analysis has loaded all that is compiled. Writes `docs/evidence/growth.md`.

Run: `make evidence`, or `python -m tests.evidence.growth`.
"""

from __future__ import annotations

import resource
import time
from pathlib import Path

import numpy as np

from photocal.analysis.outcome import analyse_network
from photocal.analysis.systematic_errors.refit import Checks, fit
from tests.photocal.analysis.aerial import Flight, fly

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "growth.md"
# Images and rays of each; the third has the shape of a recorded block.
SIZES = ((60, 12_000), (240, 48_000), (581, 108_000), (1000, 200_000))
NO_CHECKS = Checks(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def row(images: int, rays: int) -> str:
    """Adjust and analyse a flight of a size."""
    network = fly(Flight(images, rays), 4).network
    began = time.process_time()
    fitted = fit(network)
    adjusted = time.process_time()
    outcome = analyse_network(network, NO_CHECKS, 0.1, 0.8, start=fitted.state)
    analysed = time.process_time()
    own, more = adjusted - began, analysed - adjusted
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    listed = ", ".join(one.code for one in outcome.findings) or "-"
    return (
        f"| {images} | {len(network.rays.image)} | {own:.2f} | {1e6 * own / len(network.rays.image):.1f} "
        f"| {more:.2f} | {more / own:.1f} | {peak:.0f} | {listed} |"
    )


def main() -> None:
    """Run the study."""
    small = fly(Flight(30, 3_000), 1).network
    analyse_network(small, NO_CHECKS, 0.1, 0.8)
    lines = [
        "# Growth of adjustment and analysis with the block",
        "",
        "Made by `python -m tests.evidence.growth`. Seconds are of the processors, all of them together. The",
        "adjustment begins at start values that are off, and ends with the covariance of everything; the",
        "analysis begins at its result.",
        "",
        "| images | rays | adjustment (s) | a ray (us) | analysis (s) | ratio | peak (MiB) | findings |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for images, rays in SIZES:
        lines.append(row(images, rays))
        print(lines[-1], flush=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()

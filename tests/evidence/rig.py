"""Long study: are cameras on one frame found, do their standard deviations hold, and what do they cost?

Writes `docs/evidence/rig.md`. Five heads, one looking down and four obliquely, crossed strips in gusts;
centres of projection decimetres apart, priors of 0.5 degrees, 1 cm and 2 ms; positions of 3 cm, 0.5 px noise.
Seconds are of the processors.

Run: `make evidence`, or `python -m tests.evidence.rig`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.adjustment.readout import with_lags
from photocal.adjustment.rig import OF_HEAD
from photocal.adjustment.solution import Solution
from photocal.block.network import assemble
from tests.photocal import rigs

DRAWS, EXPOSURES, POINTS = 100, 12, 400
FLIGHTS, LARGE, LARGE_POINTS = 7, 300, 18000
# How much later one head exposes than the others; how well the times of all are stated.
LATER_S, TIME_SIGMA_S = (0.0, 0.01, 0.15), 0.02
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "rig.md"


def main() -> None:
    """Run the study and write its page."""
    limit = stats.norm.isf(0.025)
    small = []
    for seed in range(DRAWS):
        flown, network = rigs.flight(
            np.random.default_rng(seed), exposures=EXPOSURES, points=POINTS, missing=0.05
        )
        small.append(rigs.standardised(flown, network, adjust(network))[1:])
        sys.stderr.write(f"\rdraw {seed + 1} of {DRAWS} ")
    inside = np.abs(np.array(small)) < limit
    each = ", ".join(f"{n} {100 * s:.0f}" for n, s in zip(OF_HEAD, inside.mean(axis=(0, 1)), strict=True))
    rows = []
    for seed in range(FLIGHTS):
        flown, network = rigs.flight(np.random.default_rng(1000 + seed))
        solution = adjust(network)
        errors = np.abs(rigs.standardised(flown, network, solution)[1:])
        sigma = sigmas(solution).mean(axis=0)
        turns, centres, later = sigma[:3].mean(), sigma[3:6].mean(), sigma[6]
        largest = [errors[:, :3].max(), errors[:, 3:6].max(), errors[:, 6].max()]
        cells = [f"{error:.1f}" for error in largest]
        cells += [f"{3600 * np.degrees(turns):.0f}", f"{1000 * centres:.1f}", f"{1000 * later:.2f}"]
        rows.append(f"| {seed + 1} | {' | '.join(cells)} | {solution.variance_factor:.3f} |")
        sys.stderr.write(f"\rflight {seed + 1} of {FLIGHTS} ")
    stated = [row for later in LATER_S for row in loosely_stated(later, limit)]
    _, network = rigs.flight(np.random.default_rng(7), exposures=LARGE, points=LARGE_POINTS)
    times = []
    for held in (network, rigs.without_rig(network)):
        begun = time.process_time()
        solution = adjust(held)
        times.append((time.process_time() - begun, len(solution.iterations)))
    coverage, images, rays = 100 * inside.mean(), len(network.image_names), len(network.rays.image)
    cost = [f"{t:.1f} s in {n} iterations" for t, n in times]
    lines = [
        "# Cameras on one frame",
        "",
        f"Five heads, one nadir and four oblique (45 degrees). Coverage of the 95 % intervals over {DRAWS}",
        f"flights of {EXPOSURES} exposures: {coverage:.1f} % of {inside.size} values ({each}).",
        "",
        "Flights of 60 exposures: largest errors in standard deviations (of 12, 12 and 4 values), then",
        "mean sigmas.",
        "",
        "| flight | turns | centres | times | turn, arcsec | centre, mm | time, ms | v'Pv/dof |",
        "|---|---|---|---|---|---|---|---|",
        *rows,
        "",
        f"Times stated within {1000 * TIME_SIGMA_S:g} ms, gusts of 0.5 m/s and 0.03 rad/s, {DRAWS} flights",
        f"of {EXPOSURES} exposures. One head exposes later (ms). The effect of gusts is computed for the",
        "stated times, or for the times found. Coverage of the 95 % intervals and largest error (standard",
        "deviations) of all values; mean sigmas of the heads that expose together, then of the later one.",
        "",
        "| later | times | coverage | largest | turn, arcsec | time, ms | its turn | its time | v'Pv/dof |",
        "|---|---|---|---|---|---|---|---|---|",
        *stated,
        "",
        f"{LARGE} exposures ({images} images, {rays} rays), adjustment with all statistics, processor",
        f"time: {cost[0]}; without the frame {cost[1]}.",
    ]
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\nwritten to {OUTPUT}\n")


def loosely_stated(later_s: float, limit: float) -> Iterator[str]:
    """Adjust flights with the lags that are stated, then with those that are found: a row each."""
    figures: dict[str, list[tuple[np.ndarray, np.ndarray, float]]] = {"stated": [], "found": []}
    for seed in range(DRAWS):
        rng = np.random.default_rng(2000 + seed)
        flown, network = rigs.flight(
            rng, exposures=EXPOSURES, points=POINTS, times=False, aft_later_s=later_s, missing=0.05
        )
        network = assemble(rigs.in_gusts(network, rng, TIME_SIGMA_S)).network
        solution = adjust(network)
        for lag, adjusted in (("stated", solution), ("found", with_lags(network, solution)[1])):
            errors, sigma = rigs.standardised(flown, network, adjusted)[1:], sigmas(adjusted)
            figures[lag].append((errors, sigma, adjusted.variance_factor))
        sys.stderr.write(f"\rdraw {seed + 1} of {DRAWS}, {later_s} s ")
    for lag, drawn in figures.items():
        errors, sigma, factor = (np.array(part) for part in zip(*drawn, strict=True))
        of_heads = []
        for heads in (slice(0, 3), slice(3, 4)):
            turn, time_s = sigma[:, heads, :3].mean(), sigma[:, heads, 6].mean()
            of_heads.append(f"{3600 * np.degrees(turn):.1f} | {1000 * time_s:.2f}")
        yield (
            f"| {1000 * later_s:g} | {lag} | {100 * (np.abs(errors) < limit).mean():.1f} | "
            f"{np.abs(errors).max():.1f} | {' | '.join(of_heads)} | {factor.mean():.3f} |"
        )


def sigmas(solution: Solution) -> np.ndarray:
    """Standard deviations of the heads' values but for the first."""
    return np.sqrt(np.diag(solution.common_covariance)[-7 * len(rigs.HEADS) :]).reshape(-1, 7)[1:]


if __name__ == "__main__":
    main()

"""Long study: does the processing find the truth of simulated flights, as surely as it says?

Writes `docs/evidence/closed-loop.md`. The demonstration's flight without pictures, 100 seeds: terrain, wind,
rig, survey and all noise are drawn anew; the camera stays. Once with antenna positions and attitudes that
carry the very noise that they state (level block), and once from what goes over the wires: raw GNSS, time
marks, telemetry (level observations). Every estimated quantity is compared with the truth by its own standard
deviation; the check points by their predicted covariance.

Run: `make evidence`, or `python -m tests.evidence.closed_loop [SEEDS [FLIGHTS_FROM_THE_WIRES]]`.
"""

from __future__ import annotations

import csv
import datetime as dt
import json
import os
import resource
import sys
import tempfile
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from acquire.simulate.world.configuration import Level
from photocal.adjustment.adjust import adjust
from photocal.adjustment.mounting import COMMON
from photocal.adjustment.solution import Solution
from photocal.analysis.georeferencing.comparison import differences
from photocal.analysis.georeferencing.methods import METHODS, Method, of_method
from photocal.base.progress import quiet
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.project import read_project
from photocal.block.results.adjusted import given_exposures, given_points
from photocal.geometry.camera import PARAMETERS
from photocal.run.campaign import run_project
from photocal.run.georeferencing import calibrated_on_the_job
from tests.simulated import fly, simulate

Floats = NDArray[np.float64]

SEEDS = 100
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "closed-loop.md"
WITHIN = float(stats.norm.ppf(0.975))
DAY = dt.date(2025, 6, 16)
_RIG = ("camera_to_antenna_m", "boresight_deg", "time_offset_s")
_TITLES: dict[Level, str] = {
    "block": "Positions with the noise that they state",
    "observations": "From raw GNSS data, time marks and telemetry",
}
_SAID: dict[Level, tuple[str, ...]] = {
    "block": (
        "Direct georeferencing is that of a second flight with camera and mounting of the first one, and",
        "their joint covariance.",
    ),
    "observations": (
        "Positions come from PPK of the raw GNSS data, with errors that neighbouring exposures share;",
        "attitudes come from the telemetry. Direct georeferencing uses the calibration of the same flight,",
        "as `photocal run` does.",
    ),
}
_POSE = ("omega", "phi", "kappa", "X0", "Y0", "Z0")


@dataclass(frozen=True)
class Loop:
    """One seed: errors over standard deviations by quantity, and d' C^-1 d of the check points by method."""

    standardised: dict[str, list[float]]
    distances: dict[Method, dict[str, float]]
    variance_factor: float


def loop(task: tuple[Level, int]) -> Loop:
    """Fly, process, compare with the truth."""
    level, seed = task
    with tempfile.TemporaryDirectory() as scratch:
        first = _fly(Path(scratch) / "first", level, seed, {})
        solution, found = _compared(first)
        local, carried = calibrated_on_the_job(first.block)
        other = local
        if level == "block":
            # The same rig on another day: its truth is given, to a micrometre.
            rig = {key: first.truth["rig"][key] for key in _RIG}
            second = _fly(Path(scratch) / "second", level, 10_000 + seed, {"rig": _held(rig)})
            if not np.allclose(second.truth["rig"]["boresight_deg"], rig["boresight_deg"], atol=1e-6):
                raise AssertionError("the second flight has another rig")
            other = calibrated_on_the_job(second.block)[0]
        distances: dict[Method, dict[str, float]] = {}
        for method in METHODS:
            block = other if method == "direct" else local
            check = differences(block, of_method(block, method, calibration=carried), "check")
            distances[method] = dict(zip(check.names, check.distance.tolist(), strict=True))
    return Loop(found, distances, solution.variance_factor)


@dataclass(frozen=True)
class Flown:
    """A flight as the adjustment gets it, and its truth: places of exposures and points by name."""

    block: Block
    truth: dict[str, Any]
    places: dict[str, dict[str, Floats]]


def _fly(folder: Path, level: Level, seed: int, instead: dict[str, Any]) -> Flown:
    if level == "block":
        block = read_block(simulate(folder, level=level, seed=seed, **instead) / "block")
        return Flown(block, _truth(folder), _places(folder / "truth", ("X", "Y", "Z"), ""))
    project = read_project(fly(folder, seed=seed, **instead))
    run_project(project, DAY, quiet, until="block")
    places = _places(folder / "truth", ("E", "N", "h"), "_grid")
    return Flown(read_block(project.output / "block"), _truth(folder), places)


def _truth(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
    return content


def _held(rig: dict[str, Any]) -> dict[str, Any]:
    sigma = {"camera_to_antenna_sigma_m": [1e-6] * 3, "boresight_sigma_deg": [1e-7] * 3}
    return {**rig, **sigma, "time_offset_sigma_s": 1e-9}


def _places(truth: Path, axes: tuple[str, ...], of_angles: str) -> dict[str, dict[str, Floats]]:
    """Places in the system of the block: its columns are named by axes and the ending of the angles."""
    found: dict[str, dict[str, Floats]] = {}
    angles = tuple(name + of_angles for name in ("omega", "phi", "kappa"))
    for name, key, columns in (("exposures", "image", angles + axes), ("points", "point", axes)):
        with (truth / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
            rows = csv.DictReader(stream)
            found[name] = {row[key]: np.array([float(row[c]) for c in columns]) for row in rows}
    return found


def _compared(flown: Flown) -> tuple[Solution, dict[str, list[float]]]:
    """Adjust a block; errors of everything estimated over its own standard deviation."""
    block, truth = flown.block, flown.truth
    assembly = assemble(block)
    solution = adjust(assembly.network)
    found: dict[str, list[float]] = defaultdict(list)
    sigma = np.sqrt(np.diag(solution.camera_covariance[0]))
    for k, name in enumerate(PARAMETERS):
        if sigma[k] > 0:
            found[name].append((solution.cameras[0, k] - truth["camera"]["mm"].get(name, 0.0)) / sigma[k])
    rig = truth["rig"]
    mounting = [*rig["camera_to_antenna_m"], *np.radians(rig["boresight_deg"]), rig["time_offset_s"]]
    own = np.sqrt(np.diag(solution.common_covariance))
    for k, value in enumerate(mounting):
        if own[k] > 0:
            found[COMMON[k]].append(float((solution.state.common[k] - value) / own[k]))
    exposures, covariance = given_exposures(assembly, solution)
    for name, pose, spread in zip(block.images.names, exposures, covariance, strict=True):
        true = flown.places["exposures"][name].copy()
        true[:3] = np.radians(true[:3])
        error = pose - true
        error[:3] = (error[:3] + np.pi) % (2 * np.pi) - np.pi
        for label, z in zip(_POSE, error / np.sqrt(np.diag(spread)), strict=True):
            found[label].append(float(z))
    xyz, spread = given_points(assembly, solution)
    sigmas = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    for k, j in enumerate(assembly.points):
        z = (xyz[k] - flown.places["points"][block.points.names[j]]) / sigmas[k]
        for axis, value in zip("XYZ", z.tolist(), strict=True):
            found[f"points {axis}"].append(value)
    return solution, dict(found)


def coverage(loops: list[Loop]) -> list[str]:
    """Table of the share of truths inside the 95 % intervals."""
    lines = [
        "| quantity | values | inside its 95 % interval | error of that share | mean of z² |",
        "|---|---|---|---|---|",
    ]
    pooled: list[Floats] = []
    for name in loops[0].standardised:
        by_seed = [np.array(one.standardised[name]) for one in loops]
        z = np.concatenate(by_seed)
        share = np.array([np.mean(np.abs(one) < WITHIN) for one in by_seed])
        # Values of one flight are correlated, flights are not.
        error = (
            np.sqrt(0.95 * 0.05 / len(z)) if len(z) == len(loops) else share.std(ddof=1) / np.sqrt(len(loops))
        )
        lines.append(f"| {name} | {len(z)} | {share.mean():.1%} | {error:.1%} | {np.mean(z**2):.3f} |")
        pooled.append(share)
    table = np.array(pooled)
    error = table.mean(axis=0).std(ddof=1) / np.sqrt(len(loops))
    lines.append(f"| **all quantities alike** | | **{table.mean():.1%}** | {error:.1%} | |")
    return lines


def check_points(loops: list[Loop]) -> list[str]:
    """Table of actual against predicted errors at the check points."""
    lines = [
        "| method | mean of d' C⁻¹ d / 3 | its error | expected | points outside 99 % of chi-squared |",
        "|---|---|---|---|---|",
    ]
    for method in METHODS:
        names = sorted(set.intersection(*(set(one.distances[method]) for one in loops)))
        table = np.array([[one.distances[method][name] for name in names] for one in loops])
        p = stats.chi2(3 * len(loops)).sf(table.sum(axis=0))
        outside = int(np.sum((p < 0.005) | (p > 0.995)))
        mean = table.mean(axis=1) / 3
        error = mean.std(ddof=1) / np.sqrt(len(loops))
        lines.append(f"| {method} | {mean.mean():.3f} | {error:.3f} | 1 | {outside} of {len(names)} |")
    return lines


def part(loops: list[Loop], level: Level) -> list[str]:
    """Tables of one level."""
    factors = np.array([one.variance_factor for one in loops])
    return [
        f"## {_TITLES[level]}: {len(loops)} flights",
        "",
        *_SAID[level],
        "",
        f"Variance factor: mean {factors.mean():.4f}, standard deviation {factors.std(ddof=1):.4f}.",
        "",
        *coverage(loops),
        "",
        "Check points, d computed minus surveyed, C its predicted covariance:",
        "",
        *check_points(loops),
        "",
    ]


def page(loops: dict[Level, list[Loop]], processor_s: float) -> list[str]:
    """All that is written."""
    return [
        "# The closed loop: what the processing finds against the simulated truth",
        "",
        "Flights of the plan `survey` without pictures, each with its own terrain, wind, rig, survey and",
        "noise. z is an estimate minus the truth, divided by the standard deviation of the estimate.",
        "Values of one flight are correlated: the error of a share is therefore derived from the scatter",
        "of the flights.",
        "",
        *(line for level, found in loops.items() for line in part(found, level)),
        f"Processor time: {processor_s / 60:.1f} minutes; two cores need half of that.",
    ]


def main(seeds: int = SEEDS, from_wires: int = SEEDS) -> None:
    """Fly all seeds and write the tables."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    counts: dict[Level, int] = {"block": seeds, "observations": from_wires}
    tasks = [(level, seed) for level, count in counts.items() for seed in range(1, count + 1)]
    loops: dict[Level, list[Loop]] = {}
    began = _processor_s()
    with ProcessPoolExecutor(2) as pool:
        for k, (task, one) in enumerate(zip(tasks, pool.map(loop, tasks), strict=True), start=1):
            loops.setdefault(task[0], []).append(one)
            sys.stderr.write(f"\rflight {k} of {len(tasks)}")
    lines = page(loops, _processor_s() - began)
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\n{OUTPUT.name} written\n")


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))

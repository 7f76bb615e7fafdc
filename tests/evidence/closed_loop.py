"""Long study: does the processing find the truth of simulated flights, as surely as it says?

Writes `docs/evidence/closed-loop.md`. 100 seeds of the demonstration's flight without pictures: terrain,
wind, rig, survey and all noise are drawn anew; the camera stays. Every estimated quantity is compared
with the truth by its own standard deviation; the check points by their predicted covariance, for direct
georeferencing with the calibration of another flight of the same rig.

Run: `make evidence`, or `python -m tests.evidence.closed_loop [SEEDS]`.
"""

from __future__ import annotations

import csv
import json
import os
import sys
import tempfile
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from acquire.simulate.world.configuration import read_configuration
from acquire.simulate.world.site import simulate_flight
from photocal.accuracy.georeferencing.calibrated import calibrate
from photocal.accuracy.georeferencing.differences import differences
from photocal.accuracy.georeferencing.methods import METHODS, Method, of_method
from photocal.accuracy.georeferencing.mounted import with_attitude_angles
from photocal.adjustment.adjust import adjust
from photocal.adjustment.mounting import COMMON, OF_FLIGHT, STRIPS
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.run import given_points
from photocal.geometry.camera import PARAMETERS

Floats = NDArray[np.float64]

SEEDS = 100
ROOT = Path(__file__).parents[2]
FLIGHT = ROOT / "configs" / "demo" / "simulated" / "flight.toml"
OUTPUT = ROOT / "docs" / "evidence" / "closed-loop.md"
WITHIN = float(stats.norm.ppf(0.975))
_POSE = ("omega", "phi", "kappa", "X0", "Y0", "Z0")


@dataclass(frozen=True)
class Loop:
    """One seed: errors over standard deviations by quantity, and d' C^-1 d of the check points by method."""

    standardised: dict[str, list[float]]
    distances: dict[Method, dict[str, float]]
    variance_factor: float


def loop(seed: int) -> Loop:
    """Fly, process, compare with the truth."""
    numba.set_num_threads(1)
    with tempfile.TemporaryDirectory() as scratch:
        first, truth = _fly(Path(scratch) / "first", seed, {})
        # The same rig on another day: its truth is given, to a micrometre.
        rig = {
            "camera_to_antenna_m": truth["rig"]["camera_to_antenna_m"],
            "boresight_deg": truth["rig"]["boresight_deg"],
            "time_offset_s": truth["rig"]["time_offset_s"],
        }
        second, again = _fly(Path(scratch) / "second", 10_000 + seed, {"rig": _held(rig)})
        if not np.allclose(again["rig"]["boresight_deg"], truth["rig"]["boresight_deg"], atol=1e-6):
            raise AssertionError("the second flight has another rig")
        places = _places(Path(scratch) / "first" / "truth")
        assembly = assemble(first)
        solution = adjust(assembly.network)
        found: dict[str, list[float]] = defaultdict(list)
        sigma = np.sqrt(np.diag(solution.camera_covariance[0]))
        for k, name in enumerate(PARAMETERS):
            if sigma[k] > 0:
                found[name].append((solution.cameras[0, k] - truth["camera"]["mm"].get(name, 0.0)) / sigma[k])
        mounting = np.array(
            [
                *truth["rig"]["camera_to_antenna_m"],
                *np.radians(truth["rig"]["boresight_deg"]),
                truth["rig"]["time_offset_s"],
                *[0.0] * (STRIPS - OF_FLIGHT.start),
            ]
        )
        own = np.sqrt(np.diag(solution.common_covariance))[:STRIPS]
        errors = (solution.state.common[:STRIPS] - mounting) / np.where(own > 0, own, np.inf)
        for name, error in zip(COMMON, errors, strict=True):
            found[name].append(float(error))
        _poses(first, solution.exposures, solution.exposure_covariance, assembly, places, found)
        xyz, covariance = given_points(assembly, solution)
        spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        for k, j in enumerate(assembly.points):
            true = places["points"][first.points.names[j]]
            for axis in range(3):
                found[f"points {'XYZ'[axis]}"].append(float((xyz[k, axis] - true[axis]) / spread[k, axis]))
        distances: dict[Method, dict[str, float]] = {}
        carried = calibrate(first).on_flight(second.mounting)
        for method in METHODS:
            block = second if method == "direct" else first
            check = differences(block, of_method(block, method, calibration=carried), "check")
            distances[method] = dict(zip(check.names, check.distance.tolist(), strict=True))
    return Loop(dict(found), distances, solution.variance_factor)


def _fly(folder: Path, seed: int, instead: dict[str, Any]) -> tuple[Block, dict[str, Any]]:
    given = read_configuration(FLIGHT, {"level": "block", "seed": seed, **instead})
    folder.mkdir()
    simulate_flight(given, folder, lambda _: None)
    truth = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
    return with_attitude_angles(read_block(folder / "site" / "block")), truth


def _held(rig: dict[str, Any]) -> dict[str, Any]:
    sigma = {"camera_to_antenna_sigma_m": [1e-6] * 3, "boresight_sigma_deg": [1e-7] * 3}
    return {**rig, **sigma, "time_offset_sigma_s": 1e-9}


def _places(truth: Path) -> dict[str, dict[str, Floats]]:
    found: dict[str, dict[str, Floats]] = {}
    for name, key, columns in (
        ("exposures", "image", ("omega", "phi", "kappa", "X", "Y", "Z")),
        ("points", "point", ("X", "Y", "Z")),
    ):
        with (truth / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
            rows = csv.DictReader(stream)
            found[name] = {row[key]: np.array([float(row[c]) for c in columns]) for row in rows}
    return found


def _poses(
    block: Block,
    exposures: Floats,
    covariance: Floats,
    assembly: Any,
    places: dict[str, dict[str, Floats]],
    found: dict[str, list[float]],
) -> None:
    values = exposures.copy()
    values[:, 3:] = assembly.frame.to_given(values[:, 3:])
    for name, value, own in zip(block.images.names, values, covariance, strict=True):
        true = places["exposures"][name].copy()
        true[:3] = np.radians(true[:3])
        error = value - true
        error[:3] = (error[:3] + np.pi) % (2 * np.pi) - np.pi
        for label, z in zip(_POSE, error / np.sqrt(np.diag(own)), strict=True):
            found[label].append(float(z))


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


def main(seeds: int = SEEDS) -> None:
    """Fly all seeds and write the tables."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    loops = []
    with ProcessPoolExecutor(2) as pool:
        for one in pool.map(loop, range(1, seeds + 1)):
            loops.append(one)
            sys.stderr.write(f"\rflight {len(loops)} of {seeds}")
    factors = np.array([one.variance_factor for one in loops])
    lines = [
        "# The closed loop: what the processing finds against the simulated truth",
        "",
        f"{seeds} flights of `configs/demo/simulated/flight.toml` without pictures, each with its own",
        "terrain, wind, rig, survey and noise. z is estimate less truth over the estimate's own standard",
        "deviation; values of one flight are correlated, so the error of a share comes from the flights.",
        "",
        f"Variance factor: mean {factors.mean():.4f}, standard deviation {factors.std(ddof=1):.4f}.",
        "",
        "## Estimated quantities",
        "",
        *coverage(loops),
        "",
        "## Check points",
        "",
        "d is surveyed less computed, C its predicted covariance. Direct georeferencing is that of a second",
        "flight with camera and mounting of the first one and their joint covariance.",
        "",
        *check_points(loops),
    ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write(f"\n{OUTPUT.name} written\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))

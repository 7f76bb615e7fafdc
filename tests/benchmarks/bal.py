"""Adjust a problem in BAL's form: time to the minimum, time to the covariance of everything, peak memory.

Usage: python -m tests.benchmarks.bal PROBLEM [--ceres] [--one-camera] [--seed N]

PROBLEM is a file of BAL (text, .bz2, .gz), or the name of a shape of `make_bal`, which is made first. With
--ceres the same problem is given to Ceres (SPARSE_SCHUR, two threads, the same model) and to the covariances
of COLMAP, by the Python that PHOTOCAL_PEERS names; these are cut off at ten times our own time for
everything, a minute at least.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.adjust import adjust, minimum_of
from photocal.adjustment.covariance import complete
from photocal.adjustment.factored import factorised
from photocal.adjustment.network import Network
from photocal.base.errors import IllPosedError
from photocal.block.network import assemble
from photocal.exchange import bal
from tests.benchmarks import make_bal

CUT = 10.0
LEAST_S = 60.0


def problem_of(name: str, seed: int, *, one_camera: bool) -> bal.BalProblem:
    """Read a problem from its file, or make one of a shape."""
    if name in make_bal.SHAPES:
        return make_bal.make(make_bal.SHAPES[name], seed, one_camera=one_camera)
    return bal.read_problem(Path(name))


def network_of(problem: bal.BalProblem, *, one_camera: bool) -> Network:
    """Network of a problem, each image with its own camera, or all with the first one."""
    block = bal.block_of(problem, "bal")
    if one_camera:
        images = replace(block.images, camera=np.zeros(len(problem.cameras), dtype=np.int64))
        block = replace(block, cameras=block.cameras[:1], images=images)
    return assemble(block).network


def without(problem: bal.BalProblem, names: tuple[str, ...]) -> bal.BalProblem:
    """A problem without some points, and without those that one image sees."""
    kept = np.bincount(problem.point, minlength=len(problem.points)) >= 2
    kept[[int(name) for name in names]] = False
    place, seen = np.cumsum(kept) - 1, kept[problem.point]
    rays = problem.image[seen], place[problem.point[seen]], problem.plane[seen]
    return bal.BalProblem(problem.cameras, problem.points[kept], *rays)


def measured(network: Network) -> dict[str, Any]:
    """Solve, and take the covariance of every camera, orientation and point; raises IllPosedError."""
    began, idle = time.perf_counter(), time.process_time()
    problem, minimum = minimum_of(network)
    solved, busy = time.perf_counter(), time.process_time()
    at = factorised(problem, minimum)
    del minimum
    solution = complete(at, ())
    ended, all_busy = time.perf_counter(), time.process_time()
    layout = problem.layout
    return {
        "images": len(network.image_names),
        "cameras": len(network.cameras),
        "points": len(network.point_names),
        "rays": len(network.rays.image),
        "solve_s": solved - began,
        "solve_cpu_s": busy - idle,
        "covariance_s": ended - solved,
        "covariance_cpu_s": all_busy - busy,
        "vtpv": solution.chi_squared,
        "redundancy": solution.degrees_of_freedom,
        "redundancy_sum": sum(group.redundancy for group in solution.groups),
        "matrix_gib": float(layout.envelope.offset[-1]) * 8 / 2**30,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "sigma_of_f_px": float(np.median(np.sqrt(solution.camera_covariance[:, 0, 0]))),
    }


def beside_ceres(problem: bal.BalProblem, limit_s: float, *, one_camera: bool) -> dict[str, Any]:
    """Figures of Ceres, as far as each comes within a time after the one before; empty without it."""
    python = os.environ.get("PHOTOCAL_PEERS")
    if not python:
        return {}
    owner = np.zeros(len(problem.cameras)) if one_camera else np.arange(len(problem.cameras))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "problem.npz")
        np.savez(path, **problem._asdict(), of_camera=owner.astype(np.int64))
        script, said = str(Path(__file__).with_name("bal_ceres.py")), Path(folder, "said.txt")
        figures: dict[str, Any] = {}
        with (
            said.open("w") as out,
            subprocess.Popen([python, script, str(path), "--covariance"], stdout=out) as running,
        ):
            ends = np.inf
            while running.poll() is None and time.monotonic() < ends:
                time.sleep(0.05)
                fresh = _told(said)
                if fresh != figures:
                    figures, ends = fresh, time.monotonic() + limit_s
            running.kill()
        return {**_told(said), "covariance_limit_s": limit_s}


def _told(said: Path) -> dict[str, Any]:
    """Figures of the last whole line RESULT."""
    lines = said.read_text().split("\n")[:-1]
    told = [line.removeprefix("RESULT ") for line in lines if line.startswith("RESULT ")]
    return dict(json.loads(told[-1])) if told else {}


def run(name: str, seed: int = 1, *, ceres: bool = False, one_camera: bool = False) -> dict[str, Any]:
    """Measure a problem; points that their rays do not determine are counted, and left out."""
    problem = problem_of(name, seed, one_camera=one_camera)
    network, lost = network_of(problem, one_camera=one_camera), 0
    while True:
        try:
            ours = measured(network)
            break
        except IllPosedError as refusal:
            if not refusal.points:
                raise
            fewer = without(problem, refusal.points)
            lost += len(problem.points) - len(fewer.points)
            problem, network = fewer, network_of(fewer, one_camera=one_camera)
    figures = {"problem": name, "points_left_out": lost, "photocal": ours}
    del network
    if ceres:
        limit = max(CUT * (ours["solve_s"] + ours["covariance_s"]), LEAST_S)
        theirs = beside_ceres(problem, limit, one_camera=one_camera)
        figures["ceres"] = theirs
        if "vtpv" in theirs:
            figures["vtpv_excess"] = ours["vtpv"] / theirs["vtpv"] - 1
            figures["solve_ratio"] = theirs["solve_s"] / ours["solve_s"]
            figures["solve_cpu_ratio"] = theirs["solve_cpu_s"] / ours["solve_cpu_s"]
    return figures


def main() -> None:
    """Measure the problem that the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("problem")
    parser.add_argument("--ceres", action="store_true")
    parser.add_argument("--one-camera", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    # Compiled kernels are loaded before the clock starts, as they are from the second adjustment on.
    small = make_bal.Shape(20, 1000, 4000, "street")
    adjust(network_of(make_bal.make(small, one_camera=arguments.one_camera), one_camera=arguments.one_camera))
    figures = run(arguments.problem, arguments.seed, ceres=arguments.ceres, one_camera=arguments.one_camera)
    print("RESULT " + json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()

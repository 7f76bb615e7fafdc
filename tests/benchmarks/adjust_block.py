"""Adjust one synthetic block (`make_block.py`) and print one line of figures, as its peers do.

Usage: python -m tests.benchmarks.adjust_block BLOCK.npz [--repeat N]
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.adjustment.adjust import adjust
from photocal.adjustment.covariance import complete
from photocal.adjustment.factored import factorised
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.adjustment.normal import prepare
from photocal.adjustment.solver import minimise
from photocal.adjustment.state import start_state
from photocal.geometry.camera import camera
from photocal.geometry.rotation import angles_from_matrix
from tests.photocal import networks

# Vision axes (y down, z forward) to ours (y up, z backwards).
FLIP = np.diag([1.0, -1.0, -1.0])
FREE = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")


def network_of(path: Path) -> Network:
    """Network of a block: pixels count from the corner of the upper-left one, f_x and f_y are free."""
    with np.load(path) as archive:
        block = dict(archive)
    width, height = (int(n) for n in block["image_size"])
    pixel = block["obs_xy"] - 0.5
    plane = np.column_stack([pixel[:, 0] - (width - 1) / 2, (height - 1) / 2 - pixel[:, 1]])
    order = np.argsort(block["obs_point"], kind="stable")
    turns = FLIP @ Rotation.from_quat(block["quat_start"]).as_matrix()
    own = camera(
        "c",
        "brown-ideal",
        "px",
        (width, height),
        (1.0, 1.0),
        {"c": float(block["camera_start"][0])},
        estimate=FREE,
        affinity="after",
    )
    images, points = len(turns), len(block["point_start"])
    of_exposure = np.full((images, 6), np.inf)
    of_exposure[:, 3:] = block["gnss_sigma"]
    of_point = np.full((points, 3), np.inf)
    of_point[block["gcp_index"]] = block["gcp_sigma"]
    values = block["point_start"].copy()
    values[block["gcp_index"]] = block["gcp_xyz"]
    held, weight = point_weights(of_point)
    sigma = np.full((len(order), 2), float(block["obs_sigma"]))
    return Network(
        (own,),
        ExteriorOrientations(
            np.zeros(images, np.int64), np.hstack([angles_from_matrix(turns), block["gnss"]]), of_exposure
        ),
        Points(values, held, weight),
        Rays(
            block["obs_image"][order].astype(np.int64),
            block["obs_point"][order].astype(np.int64),
            plane[order],
            sigma,
        ),
        tuple(map(str, range(images))),
        tuple(map(str, range(points))),
    )


def measure(network: Network, repeat: int) -> dict[str, object]:
    """Solve and take the covariance of everything, some times over; medians, of processor time the least."""
    solve, covariance, busy = [], [], []
    for _ in range(repeat):
        began, idle = time.perf_counter(), time.process_time()
        problem = prepare(network)
        minimum = minimise(problem, start_state(network))
        solved, busy_solving = time.perf_counter(), time.process_time() - idle
        at = factorised(problem, minimum)
        solution = complete(at, minimum.iterations)
        covariance.append(time.perf_counter() - solved)
        solve.append(solved - began)
        busy.append((busy_solving, time.process_time() - idle - busy_solving))
    steps = len(minimum.iterations)
    return {
        "solver": "photocal",
        "images": len(network.image_names),
        "points": len(network.point_names),
        "rays": len(network.rays.image),
        "solve_s": statistics.median(solve),
        "iterations": steps,
        # The normal equations are set up once more than there are steps.
        "s_per_iteration": statistics.median(solve) / (steps + 1),
        "covariance_s": statistics.median(covariance),
        # Of all processors together: what other work on the machine does not change.
        "solve_cpu_s": min(busy)[0],
        "covariance_cpu_s": min(busy)[1],
        "vtpv": solution.chi_squared,
        "redundancy": solution.degrees_of_freedom,
        "redundancy_sum": sum(group.redundancy for group in solution.groups),
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def main() -> None:
    """Measure the block that the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("block", type=Path)
    parser.add_argument("--repeat", type=int, default=1)
    arguments = parser.parse_args()
    # Compiled kernels are loaded before the clock starts, as they are from the second adjustment on.
    adjust(networks.observe(networks.convergent(), None))
    print("RESULT " + json.dumps(measure(network_of(arguments.block), arguments.repeat)), flush=True)


if __name__ == "__main__":
    main()

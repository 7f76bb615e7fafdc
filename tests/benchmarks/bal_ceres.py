"""Solve a problem of BAL with Ceres through COLMAP's compiled costs, and ask both for covariances.

Usage: PYTHON bal_ceres.py PROBLEM.npz [--threads 2] [--covariance], where it has pyceres and pycolmap.

PROBLEM.npz is what `python -m tests.benchmarks.bal` hands over: cameras, points, rays, of_camera. The model
RADIAL with its principal point held at (0, 0) is BAL's own; y is turned down and z forward. A line RESULT
stands after the solution, and another one after each covariance that comes to its end.
"""

from __future__ import annotations

import argparse
import json
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# What the project does not need, and has no types.
pyceres: Any = import_module("pyceres")
pycolmap: Any = import_module("pycolmap")

Floats = NDArray[np.float64]
FLIP = np.diag([1.0, -1.0, -1.0])


def matrix_of(vector: Floats) -> Floats:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def reconstruction(block: dict[str, NDArray[Any]]) -> Any:
    """COLMAP reconstruction with the start values and all rays."""
    rec = pycolmap.Reconstruction()
    cameras, owner = block["cameras"], block["of_camera"]
    for k in np.unique(owner):
        f, k1, k2 = cameras[np.flatnonzero(owner == k)[0], 6:]
        lens = pycolmap.Camera(
            camera_id=int(k) + 1, model="RADIAL", width=10_000, height=10_000, params=[f, 0.0, 0.0, k1, k2]
        )
        rec.add_camera_with_trivial_rig(lens)
    order = np.lexsort((block["point"], block["image"]))
    image, point, xy = block["image"][order], block["point"][order], block["plane"][order] * [1.0, -1.0]
    first = np.searchsorted(image, np.arange(len(cameras) + 1))
    for i, row in enumerate(cameras):
        turn, shift = FLIP @ matrix_of(row[:3]), FLIP @ row[3:6]
        own = pycolmap.Image(
            name=str(i),
            keypoints=xy[first[i] : first[i + 1]],
            camera_id=int(owner[i]) + 1,
            image_id=i + 1,
        )
        rec.add_image_with_trivial_frame(own, pycolmap.Rigid3d(pycolmap.Rotation3d(turn), shift))
    slot = np.arange(len(image)) - first[image]
    back = np.argsort(point, kind="stable")
    start = np.searchsorted(point[back], np.arange(len(block["points"]) + 1))
    image_id, slot = (image[back] + 1).tolist(), slot[back].tolist()
    for j, xyz in enumerate(block["points"]):
        track = pycolmap.Track()
        for k in range(start[j], start[j + 1]):
            track.add_element(image_id[k], slot[k])
        rec.add_point3D(xyz, track)
    return rec


def told(figures: dict[str, Any]) -> None:
    """Print figures, as far as they are known."""
    # Not of `getrusage`, which counts what this process was before it became this program.
    status = Path("/proc/self/status").read_text()
    figures["peak_gib"] = int(status.split("VmHWM:")[1].split()[0]) / 2**20
    print("RESULT " + json.dumps(figures), flush=True)


def main() -> None:
    """Solve the problem that the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("problem")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--covariance", action="store_true")
    arguments = parser.parse_args()
    with np.load(arguments.problem) as archive:
        block = dict(archive)
    rec = reconstruction(block)
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in rec.images:
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    wanted = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=True, refine_principal_point=False, refine_extra_params=True, print_summary=False
    )
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(wanted, config, rec)
    problem = adjuster.problem
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
    options.sparse_linear_algebra_library_type = pyceres.SparseLinearAlgebraLibraryType.SUITE_SPARSE
    options.num_threads = arguments.threads
    options.max_num_iterations = 100
    options.function_tolerance, options.gradient_tolerance = 1e-9, 1e-10
    options.parameter_tolerance = 1e-9
    summary = pyceres.SolverSummary()
    began, idle = time.perf_counter(), time.process_time()
    pyceres.solve(options, problem, summary)
    figures = {
        "solver": "Ceres SPARSE_SCHUR",
        "solve_s": time.perf_counter() - began,
        "solve_cpu_s": time.process_time() - idle,
        "iterations": summary.num_successful_steps + summary.num_unsuccessful_steps,
        "vtpv": 2 * summary.final_cost,
        "termination": str(summary.termination_type),
    }
    told(figures)
    if not arguments.covariance:
        return
    for name in ("POSES", "ALL"):
        which = pycolmap.BACovarianceOptions(params=getattr(pycolmap.BACovarianceOptionsParams, name))
        began = time.perf_counter()
        found = pycolmap.estimate_ba_covariance_from_problem(which, rec, problem)
        figures[f"colmap_{name.lower()}_s"] = time.perf_counter() - began
        figures[f"colmap_{name.lower()}_ok"] = found is not None
        told(figures)


if __name__ == "__main__":
    main()

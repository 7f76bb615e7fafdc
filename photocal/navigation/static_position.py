"""Positions of receivers that stood still, and the engine's positions as a trajectory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import IllPosedError
from photocal.navigation.engine import ProcessingOptions, Rtklib
from photocal.navigation.engine_output import EngineSolution
from photocal.navigation.precise_results import ObservationFile
from photocal.navigation.trajectory import Trajectory, geocentric

_STATUS = {1: "fixed", 2: "float"}
_DIFFERENTIAL, _PRECISE = 2, 6
# What differences do not remove of orbits, troposphere and ionosphere: a millimetre per kilometre at quiet
# times (Odijk 2002, chapter 3).
PER_METRE = 1e-6
# Antennas without calibration: phase centres agree to a millimetre or two at best.
_STATIC_FLOOR_M = np.array([0.001, 0.001, 0.002])


def precise_point(
    rover: ObservationFile, files: list[Path], options: ProcessingOptions, engine: Rtklib, folder: Path
) -> Trajectory:
    """Compute the position of a receiver that stood still by itself, with precise orbits and clocks."""
    if "2" not in rover.bands:
        raise IllPosedError(
            "a precise point needs two frequencies",
            where=rover.path.name,
            remedy="measure a baseline instead",
        )
    found = in_order(engine.solve("ppp-static", "forward", [rover.path, *files], options, None, folder))
    found = found.rows(found.quality == _PRECISE)
    if not len(found):
        raise IllPosedError(
            "the engine found no precise position",
            where=rover.path.name,
            remedy="check that the products cover the observations",
        )
    last = found.rows(np.array([len(found) - 1]))
    origin = np.array([last.lat_deg[0], last.lon_deg[0], last.height_m[0]])
    half = found.rows(np.arange(len(found) // 2, len(found)))
    way = half.offsets(origin)
    spread = np.maximum(np.sqrt(np.mean(way**2, axis=0)), 10 * _STATIC_FLOOR_M)
    settled = last.with_quality(last.quality, last.covariance_m2 + np.diag(spread**2))
    return trajectory_of(settled, 0.0, geocentric(*origin[:, None])[0])


def static_position(forward: EngineSolution, combined: EngineSolution) -> EngineSolution:
    """Return the last epoch of a static run, which contains all before it, with an honest covariance.

    The engine's sigmas of a long static run fall below a millimetre while its position still wanders with
    multipath: the root mean square of the way that the estimates of both directions lie from it is added.
    """
    last = forward.rows(np.array([len(forward) - 1]))
    origin = np.array([last.lat_deg[0], last.lon_deg[0], last.height_m[0]])
    steady = combined.rows(combined.quality == last.quality[0])
    apart = steady.offsets(origin)
    wander = np.sqrt(np.mean(apart**2, axis=0)) if len(apart) else np.zeros(3)
    spread = np.maximum(wander, _STATIC_FLOOR_M)
    return last.with_quality(last.quality, last.covariance_m2 + np.diag(spread**2))


def in_order(solution: EngineSolution) -> EngineSolution:
    """Return the epochs in the order of time, each once."""
    _, first = np.unique(solution.time.ns, return_index=True)
    return solution.rows(first)


def trajectory_of(
    solution: EngineSolution,
    velocity_sigma: float,
    base_m: Floats,
    velocity: Floats | None = None,
) -> Trajectory:
    """Return the engine's positions as a trajectory."""
    place = solution.xyz_m
    apart = PER_METRE * np.linalg.norm(place - base_m, axis=1)
    apart[solution.quality > _DIFFERENTIAL] = 0.0
    status = np.array([_STATUS.get(q, "single") for q in solution.quality.tolist()], "U6")
    return Trajectory(
        solution.time,
        solution.lat_deg,
        solution.lon_deg,
        solution.height_m,
        status,
        solution.covariance_m2 + apart[:, None, None] ** 2 * np.eye(3),
        np.full((len(solution), 3), np.nan) if velocity is None else velocity,
        velocity_sigma,
    )

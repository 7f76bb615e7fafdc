"""What a block of tie points says about its cameras, those parameters included that it holds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from drivers.errors import PhotocalError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.solution import Solution
from photocal.geometry.camera import PARAMETERS
from photocal.measurement.tie_adjustment import Adjusted

# A principal distance that leaves its start value by more than this is not what the lens has: errors of the
# model (rolling shutter, lens, positions) go into what the block does not determine.
CREDIBLE = 0.05


def camera_figures(adjusted: Adjusted) -> list[dict[str, Any]]:
    """Parameters of each camera, and what its principal distance becomes when it is released.

    It is released after the last gross error was taken out: before, errors would go into it.
    """
    solution, block = adjusted.solution, adjusted.block
    freed = _freed(adjusted)
    found = []
    for k, own in enumerate(block.cameras):
        estimated = dict(zip(PARAMETERS, own.estimated.tolist(), strict=True))
        sigma = np.sqrt(np.diag(solution.camera_covariance[k]))
        found.append(
            {
                "camera": own.id,
                "unit": own.unit,
                "parameters": {
                    n: float(v) for n, v in zip(PARAMETERS, solution.cameras[k], strict=True) if v
                },
                "sigma": {n: float(s) for n, s in zip(PARAMETERS, sigma, strict=True) if estimated[n]},
                "held": [n for n in (*PARAMETERS[:3], "K1") if not estimated[n]],
                "released": None if freed is None or estimated["c"] else _released(adjusted, freed, k),
            }
        )
    return found


def _freed(adjusted: Adjusted) -> Solution | None:
    estimated = np.array([name == "c" for name in PARAMETERS])
    cameras = tuple(
        replace(own, estimated=own.estimated | estimated) for own in adjusted.assembly.network.cameras
    )
    try:
        return adjust(replace(adjusted.assembly.network, cameras=cameras))
    except PhotocalError:
        return None


def _released(adjusted: Adjusted, freed: Solution, k: int) -> dict[str, Any]:
    held, c = adjusted.solution.cameras[k, 0], freed.cameras[k, 0]
    change = float(c / held - 1)
    return {
        "c": float(c),
        "sigma": float(np.sqrt(freed.camera_covariance[k, 0, 0])),
        "change": change,
        "relief": _relief(adjusted),
        "variance_factor": float(freed.variance_factor),
        "credible": abs(change) < CREDIBLE,
    }


def _relief(adjusted: Adjusted) -> float:
    """Extent of the points along the mean viewing direction over their mean distance."""
    state = adjusted.solution
    view = -adjusted.solution.state.rotation[:, 2].mean(axis=0)
    view /= np.linalg.norm(view)
    depth = (state.points - state.exposures[:, 3:].mean(axis=0)) @ view
    low, high = np.quantile(depth, [0.05, 0.95])
    return float((high - low) / abs(depth.mean()))

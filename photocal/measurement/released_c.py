"""What a block of tie points says of its principal distances, once the last gross error is out."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network
from photocal.adjustment.readout import readout_of, with_room
from photocal.adjustment.solution import Solution
from photocal.base.errors import PhotocalError
from photocal.base.policy import policy
from photocal.geometry.camera import PARAMETERS, Camera, among
from photocal.measurement.tie_adjustment import AdjustedTies

# A parameter of a camera, and the sigma with which it is observed, in its unit.
Also = tuple[str, float]
_POINT = ("x0", "y0")
# Left of the way to the minimum: a hundredth of a standard deviation.
_NEAR = 1e-4


def camera_figures(adjusted: AdjustedTies, freed: Solution | None) -> list[dict[str, Any]]:
    """Parameters of each camera, and what its principal distance becomes when it is released.

    It is released after the last gross error was taken out: before, errors would go into it.

    freed: of `with_released_c`.
    """
    solution, block = adjusted.solution, adjusted.block
    figures = []
    for k, camera in enumerate(block.cameras):
        sigma = np.sqrt(np.diag(solution.camera_covariance[k]))
        figures.append(
            {
                "camera": camera.id,
                "unit": camera.unit,
                "parameters": {
                    n: float(v) for n, v in zip(PARAMETERS, solution.cameras[k], strict=True) if v
                },
                "sigma": {n: float(s) for n, s in zip(PARAMETERS, sigma, strict=True) if n in camera.free},
                "held": [n for n in (*PARAMETERS[:3], "K1") if n not in camera.free],
                "released": None if freed is None or "c" in camera.free else _released(adjusted, freed, k),
            }
        )
    return figures


def with_released_c(
    adjusted: AdjustedTies, loosely: float = 1.0, also: Sequence[Also] = ()
) -> Solution | None:
    """Adjust with free principal distances; None where the block does not determine them.

    loosely: factor of the sigmas of positions and angles.
    also: parameters that are freed with c where a lens is estimated, each observed as it is with a sigma; of
        a lens that is held only the principal point, and a readout only of cameras whose shutter is unknown.
        Where one is found, gusts move the images in it.
    """
    # Where nobody knows the lens, nobody knows its principal point: held at the middle it takes c along, by
    # ten times what c would then be said to be uncertain by.
    network = adjusted.assembly.network
    flown = network.exposures.motion is not None
    cameras = tuple(_released_lens(camera, also, flown=flown) for camera in network.cameras)
    exposures = replace(network.exposures, sigma=loosely * network.exposures.sigma)
    network = replace(network, cameras=cameras, exposures=exposures)
    try:
        solution = adjust(network, None, adjusted.solution.state, near=_NEAR)
        rolling = _found_to_roll(adjusted.assembly.network, network, solution)
        if not rolling:
            return solution
        # What gusts move in it would be taken for c, by twice its standard deviation with 30 ms.
        return adjust(with_room(network, solution, rolling), None, solution.state, near=_NEAR)
    except PhotocalError:
        return None


def _found_to_roll(before: Network, network: Network, solution: Solution) -> list[int]:
    """Cameras that had no readout, and have a significant one."""
    opened = [
        k
        for k, (closed, camera) in enumerate(zip(before.cameras, network.cameras, strict=True))
        if camera.rolling and not closed.rolling
    ]
    return [k for k in opened if readout_of(network, solution, k).p_value < policy.significance]


def _released_lens(camera: Camera, also: Sequence[Also], *, flown: bool) -> Camera:
    if not camera.free:
        point = (name for name, _ in also if name in _POINT)
        return replace(camera, estimated=camera.estimated | among("c", *point))
    asked = flown and camera.shutter == "unknown"
    also = [(name, sigma) for name, sigma in also if name != "readout" or asked]
    prior = camera.prior_sigma.copy()
    for name, sigma in also:
        held = among(name) & ~camera.estimated
        prior[held] = np.minimum(prior[held], sigma)
    free = among("c", *_POINT, *(name for name, _ in also))
    return replace(camera, estimated=camera.estimated | free, prior_sigma=prior)


def told_by_rays(freed: Solution | None, loosely: Solution | None) -> Solution | None:
    """Of two adjustments that with loose positions, where these pull c by more than errors of each could.

    What positions have in common (a time offset, a lever arm, the air) stands in none of their sigmas. But
    for it the difference has the difference of both variances (Hausman 1978).
    """
    if freed is None or loosely is None:
        return freed
    # In sigmas of the difference.
    pulled = 3.0
    away = freed.cameras[:, 0] - loosely.cameras[:, 0]
    more = loosely.camera_covariance[:, 0, 0] - freed.camera_covariance[:, 0, 0]
    return loosely if (away**2 > pulled**2 * np.maximum(more, 0.0)).any() else freed


def _released(adjusted: AdjustedTies, freed: Solution, k: int) -> dict[str, Any]:
    solution = adjusted.solution
    change = float(freed.cameras[k, 0] / solution.cameras[k, 0] - 1)
    view = -solution.state.rotation[:, 2].mean(axis=0)
    view /= np.linalg.norm(view)
    depth = (solution.points - solution.exposures[:, 3:].mean(axis=0)) @ view
    low, high = np.quantile(depth, [0.05, 0.95])
    # A principal distance that leaves its start value by more than this is not what the lens has: errors of
    # the model (rolling shutter, lens, positions) go into what the block does not determine.
    credible = 0.05
    return {
        "c": float(freed.cameras[k, 0]),
        "sigma": float(np.sqrt(freed.camera_covariance[k, 0, 0])),
        "change": change,
        # Extent of the points along the mean viewing direction over their mean distance.
        "relief": float((high - low) / abs(depth.mean())),
        "variance_factor": float(freed.variance_factor),
        "credible": abs(change) < credible,
    }

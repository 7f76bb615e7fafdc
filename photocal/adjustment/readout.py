"""The readout of a rolling shutter: whether there is one, and the sigmas of gusts that belong to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network
from photocal.adjustment.normal import prepare, values_of
from photocal.adjustment.sensitivity import along
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration
from photocal.geometry.camera import PARAMETERS, Camera

Report = Callable[[Iteration], None]

READOUT = PARAMETERS.index("readout")
# The sigmas of gusts belong to the readout when it changes by less than this share.
SETTLED = 0.02
ROUNDS = 5
# A global shutter is called rolling in one of a thousand flights.
SIGNIFICANCE = 0.001


@dataclass(frozen=True)
class Readout:
    """What the rays say of a camera's readout.

    value, sigma: seconds.
    p_value: of a global shutter, two-sided, with sigma larger where the residuals are larger than stated.
    estimated: whether it is an unknown of the adjustment: given as one, or found significant.
    effect: root mean square of what it moves the rays by, in the unit of the camera.
    way: how far the camera usually flies during it, m.
    """

    camera: str
    value: float
    sigma: float
    p_value: float
    estimated: bool
    effect: float
    way: float


def with_readouts(
    network: Network, solution: Solution, report: Report | None = None
) -> tuple[Network, Solution, tuple[Readout, ...]]:
    """Test the readout where the shutter is unknown, and let the sigmas of gusts follow estimated readouts.

    A movement that departs from the given motion has that motion's sigma times the readout. With a readout
    of zero nothing departs, and the test of a global shutter is exact.
    """
    doubtful = [
        k for k, camera in enumerate(network.cameras) if camera.shutter == "unknown" and not camera.rolling
    ]
    tests = dict[int, Readout]()
    if doubtful and network.exposures.motion is not None:
        freed = _with(network, {k: _freed(network.cameras[k]) for k in doubtful})
        try:
            found = adjust(freed, report, solution.state)
        except (IllPosedError, NotConvergedError):
            return network, solution, ()
        tests = {k: readout_of(freed, found, k) for k in doubtful}
        rolling = {k: freed.cameras[k] for k, readout in tests.items() if readout.p_value < SIGNIFICANCE}
        tests = {k: replace(readout, estimated=k in rolling) for k, readout in tests.items()}
        if rolling:
            network = _with(network, rolling)
            solution = found if len(rolling) == len(doubtful) else adjust(network, report, found.state)
    estimated = [k for k, camera in enumerate(network.cameras) if camera.estimated[READOUT]]
    for _ in range(ROUNDS):
        # A prior observes the value that is given: that one stays.
        values = {
            k: float(solution.cameras[k, READOUT])
            for k in estimated
            if np.isinf(network.cameras[k].prior_sigma[READOUT])
        }
        if all(abs(v - network.cameras[k].values[READOUT]) <= SETTLED * abs(v) for k, v in values.items()):
            break
        network = _with(network, {k: _started(network.cameras[k], value) for k, value in values.items()})
        solution = adjust(network, report, solution.state)
    tests |= {k: readout_of(network, solution, k) for k in estimated}
    return network, solution, tuple(tests[k] for k in sorted(tests))


def readout_of(network: Network, solution: Solution, camera: int) -> Readout:
    """What an adjustment found of the readout of a camera that has one as unknown."""
    own, exposures = network.cameras[camera], network.exposures
    value = float(solution.cameras[camera, READOUT])
    sigma = float(np.sqrt(solution.camera_covariance[camera, READOUT, READOUT]))
    larger = max(1.0, float(np.sqrt(np.nan_to_num(solution.variance_factor))))
    problem = prepare(network)
    positions, columns = problem.layout.camera_columns[camera]
    step = np.zeros(problem.layout.size)
    step[columns[positions == READOUT]] = value
    change = np.zeros(network.rays.plane.shape)
    still = np.zeros_like(solution.points)
    along(problem.design, values_of(problem, solution.state), problem.structure, step, still, change)
    mine = exposures.camera == camera
    of_camera = change[mine[network.rays.image]]
    speed = (
        0.0
        if exposures.motion is None
        else float(np.median(np.linalg.norm(exposures.motion[mine, :3], axis=1)))
    )
    return Readout(
        own.id,
        value,
        sigma,
        float(2 * special.ndtr(-abs(value) / (sigma * larger))),
        True,
        float(np.sqrt(np.mean(np.sum(of_camera**2, axis=1)))) if len(of_camera) else 0.0,
        speed * abs(value),
    )


def _freed(camera: Camera) -> Camera:
    return replace(
        camera, estimated=camera.estimated | (np.array(PARAMETERS) == "readout"), shutter="rolling"
    )


def _started(camera: Camera, readout: float) -> Camera:
    return camera.with_values(np.where(np.array(PARAMETERS) == "readout", readout, camera.values))


def _with(network: Network, changed: dict[int, Camera]) -> Network:
    cameras = tuple(changed.get(k, camera) for k, camera in enumerate(network.cameras))
    return replace(network, cameras=cameras)

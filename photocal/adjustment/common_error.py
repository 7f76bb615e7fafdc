"""What an error that all observed heights of exposures share does to the cameras: no residual tells it."""

from dataclasses import replace

import numpy as np

from photocal.adjustment.factored import Factored, covariance_column
from photocal.adjustment.mounting import SHIFT
from photocal.adjustment.network import Network
from photocal.adjustment.normal import other_equations
from photocal.base.arrays import Floats

_UP = np.array([0.0, 0.0, 1.0])
# Groups of observations that a common error of positions changes.
_GROUPS = ("position", "exposure")


def c_by_common_height(at: Factored) -> Floats | None:
    """Give the change of each principal distance with an error common to all observed heights, per m.

    returns (cameras,): dx = N^-1 A' P e, e being 1 m in each observed height; None where a shift of the
        flight is an unknown: the covariance knows of the error then.
    """
    network = at.problem.network
    if network.mounting.sigma[SHIFT][2] != 0.0:
        return None
    changes = np.zeros(len(network.cameras))
    lower = at.others
    higher = other_equations(replace(at.problem, network=_raised(network)), at.state)
    right = np.zeros(at.problem.layout.size)
    for name in _GROUPS:
        if name in lower:
            rows = lower[name]
            pull = rows.weight * (rows.residual - higher[name].residual)
            np.add.at(right, rows.column, rows.coefficient * np.repeat(pull, np.diff(rows.start)))
    right[at.problem.held] = 0.0
    step = covariance_column(at, right, np.zeros_like(at.state.points))[0]
    for k, (parameters, columns) in enumerate(at.problem.layout.camera_columns):
        changes[k] = step[columns[parameters == 0]].sum()
    # A block without control moves as a whole: what is left of c is rounding.
    of_c = np.array([camera.values[0] for camera in network.cameras])
    # Share of c, per m, that is rounding.
    rounding = 1e-8
    return np.where(np.abs(changes) > rounding * of_c, changes, 0.0)


def _raised(network: Network) -> Network:
    """The network with all observed heights of exposures 1 m higher."""
    positions, exposures = network.positions, network.exposures
    values = exposures.values.copy()
    values[:, 5] += 1.0
    return replace(
        network,
        positions=replace(positions, values=positions.values + _UP),
        exposures=replace(exposures, values=values),
    )

"""A shift that all observed positions have in common against control: base station, geoid, antenna height."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.datum import full_solution
from photocal.adjustment.groups import FEWEST, tested
from photocal.adjustment.mounting import SHIFT, STRIPS
from photocal.adjustment.network import Network
from photocal.adjustment.normal import other_equations
from photocal.analysis.systematic_errors.refit import Fit

# Of a shift, what no other unknown takes up, squared: less is not determined.
LEFT = 1e-4
# From here on standard deviations are wrong.
SIGNIFICANCE = 0.001


@dataclass(frozen=True)
class PositionShift:
    """A common shift of the observed positions, as three more unknowns.

    shift, sigma: (3,), observed less what the rest of the network says, and standard deviations a priori, m;
        infinite where nothing but the positions tells it.
    fall: by how much the sum of squares falls with it.
    p_value: probability of that without a shift, in height or in plane (Bonferroni), judged by the scatter of
        the positions themselves.
    c_by_shift: (cameras, 3), change of each principal distance with it, per m.
    stated: (3,), medians of the stated standard deviations of a position, m.
    """

    shift: Floats
    sigma: Floats
    fall: float
    p_value: float
    c_by_shift: Floats
    stated: Floats


def position_shift(fit: Fit) -> PositionShift | None:
    """Estimate the shift from the normal equations as they stand; None where it is free already."""
    network, positions = fit.network, fit.network.positions
    if not len(positions.image) or np.any(network.mounting.sigma[SHIFT]) or _strips_free(network):
        return None
    at = fit.factored
    rows = other_equations(at.problem, at.state)["position"]
    # Rows are whitened position by position: so is the shift.
    fields = np.linalg.inv(np.linalg.cholesky(positions.covariance)).reshape(-1, 3)
    counts = np.diff(rows.start)
    still = np.zeros_like(at.state.points)
    information = fields.T @ fields
    whole = information.copy()
    c_by_shift = np.zeros((len(network.cameras), 3))
    for k in range(3):
        right = np.zeros(at.problem.layout.size)
        np.add.at(right, rows.column, rows.coefficient * np.repeat(rows.weight * fields[:, k], counts))
        step, _ = full_solution(at.problem, at.normal, right, still)
        moved = np.add.reduceat(rows.coefficient * step[rows.column], rows.start[:-1])
        information[:, k] -= fields.T @ (rows.weight * moved)
        for camera, (parameters, columns) in enumerate(at.problem.layout.camera_columns):
            c_by_shift[camera, k] = step[columns[parameters == 0]].sum()
    information = (information + information.T) / 2
    stated = np.median(np.sqrt(np.diagonal(positions.covariance, axis1=1, axis2=2)), axis=0)
    group = next(one for one in fit.solution.groups if one.name == "position")
    rest = group.redundancy - 3.0
    if np.linalg.eigvalsh(np.linalg.solve(whole, information))[0] < LEFT or rest < FEWEST:
        return PositionShift(np.zeros(3), np.full(3, np.inf), 0.0, 1.0, c_by_shift, stated)
    slope = fields.T @ (rows.weight * rows.residual)
    shift, covariance = -np.linalg.solve(information, slope), np.linalg.inv(information)
    fall = float(-slope @ shift)
    scale = max(1.0, (group.chi_squared - fall) / rest)
    p_value = _smaller_p(shift, scale * covariance, rest)
    # Standard deviations that are too small by a factor compete with it: they explain all residuals alike.
    factor = tested(group)
    wrong = factor.factor > 1.0 and factor.p_value < SIGNIFICANCE
    if wrong and factor.gain > fall - 2.0 * np.log(fit.solution.observations):
        p_value = 1.0
    return PositionShift(shift, np.sqrt(np.diag(covariance)), fall, p_value, c_by_shift, stated)


def _smaller_p(shift: Floats, covariance: Floats, freedom: float) -> float:
    """The smaller probability of height and plane, for both having been looked at."""
    from scipy import stats

    of_part = [
        float(stats.f.sf(shift[part] @ np.linalg.solve(covariance[part, part], shift[part]) / n, n, freedom))
        for part, n in ((slice(2, 3), 1), (slice(0, 2), 2))
    ]
    return min(1.0, 2.0 * min(of_part))


def _strips_free(network: Network) -> bool:
    return bool(np.any(network.mounting.sigma[STRIPS:]))


def with_free_shift(network: Network) -> Network:
    """Give the network the shift as an unknown."""
    sigma = network.mounting.sigma.copy()
    sigma[SHIFT] = np.inf
    return replace(network, mounting=replace(network.mounting, sigma=sigma))

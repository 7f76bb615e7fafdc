"""A shift that all observed positions, or those of a strip, have in common: base, geoid, ambiguities."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.envelope import solve
from photocal.adjustment.groups import FEWEST, tested
from photocal.adjustment.mounting import SHIFT, STRIPS
from photocal.adjustment.network import Network
from photocal.adjustment.normal import other_equations
from photocal.analysis.systematic_errors.refit import Fit

# Of a shift, what no other unknown takes up, squared: less is not determined.
LEFT = 1e-4
# Strips with fewer positions, or more strips than this, are not looked at one by one.
LEAST_OF_STRIP, MOST_STRIPS = 3, 60
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
    fields = _whitened(fit)
    normal = _further(fit, fields)
    information, slope = normal.information, normal.slope
    layout = fit.factored.problem.layout
    c_by_shift = np.array(
        [
            normal.steps[:, columns[parameters == 0]].sum(axis=1)
            for parameters, columns in layout.camera_columns
        ]
    )
    stated = np.median(np.sqrt(np.diagonal(positions.covariance, axis1=1, axis2=2)), axis=0)
    group = next(one for one in fit.solution.groups if one.name == "position")
    rest = group.redundancy - 3.0
    if np.linalg.eigvalsh(np.linalg.solve(fields.T @ fields, information))[0] < LEFT or rest < FEWEST:
        return PositionShift(np.zeros(3), np.full(3, np.inf), 0.0, 1.0, c_by_shift, stated)
    covariance: Floats = np.asarray(np.linalg.inv(information), dtype=np.float64)
    shift = -covariance @ slope
    fall = float(-slope @ shift)
    scale = max(1.0, (group.chi_squared - fall) / rest)
    p_value = _smaller_p(shift, scale * covariance, rest)
    # Standard deviations that are too small by a factor compete with it: they explain all residuals alike.
    factor = tested(group)
    wrong = factor.factor > 1.0 and factor.p_value < SIGNIFICANCE
    if wrong and factor.gain > fall - 2.0 * np.log(fit.solution.observations):
        p_value = 1.0
    return PositionShift(shift, np.sqrt(np.diag(covariance)), fall, p_value, c_by_shift, stated)


@dataclass(frozen=True)
class StripShift:
    """The positions of one strip against the rest, `PositionShift` of that strip alone; p for all strips."""

    first: str
    last: str
    positions: int
    shift: Floats
    sigma: Floats
    p_value: float


def strip_shifts(fit: Fit) -> tuple[StripShift, ...]:
    """Estimate a shift of the positions of each strip; nothing for one strip, or where they are free."""
    network, positions = fit.network, fit.network.positions
    strips, count = np.unique(positions.strip, return_counts=True)
    chosen = strips[count >= LEAST_OF_STRIP]
    if not 2 <= len(strips) <= MOST_STRIPS or _strips_free(network):
        return ()
    fields, found = _whitened(fit), list[StripShift]()
    group = next(one for one in fit.solution.groups if one.name == "position")
    if group.redundancy - 3.0 < FEWEST:
        return ()
    owns = [positions.strip == strip for strip in chosen.tolist()]
    masked = np.hstack([fields * np.repeat(own, 3)[:, None] for own in owns])
    normal = _further(fit, masked)
    for k, own in enumerate(owns):
        mine = slice(3 * k, 3 * k + 3)
        information, slope = normal.information[mine, mine], normal.slope[mine]
        if np.linalg.eigvalsh(np.linalg.solve(masked.T[mine] @ masked[:, mine], information))[0] < LEFT:
            continue
        covariance: Floats = np.asarray(np.linalg.inv(information), dtype=np.float64)
        shift = -covariance @ slope
        left = group.chi_squared + float(slope @ shift)
        scale = max(1.0, left / (group.redundancy - 3.0))
        p_value = len(chosen) * _smaller_p(shift, scale * covariance, group.redundancy - 3.0)
        names = [network.image_names[i] for i in positions.image[own]]
        sigma = np.sqrt(np.diag(covariance))
        found.append(StripShift(names[0], names[-1], len(names), shift, sigma, min(1.0, p_value)))
    return tuple(found)


@dataclass(frozen=True)
class _Further:
    """Normal equations of further unknowns of the positions, and how all others follow a unit of each."""

    information: Floats
    slope: Floats
    steps: Floats


def _whitened(fit: Fit) -> Floats:
    """Rows of observed positions are whitened position by position: so is a shift, (3 positions, 3)."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(fit.network.positions.covariance)).reshape(-1, 3))


def _further(fit: Fit, fields: Floats) -> _Further:
    """Set up the normal equations of shifts along fields of the whitened positions, all else eliminated."""
    at = fit.factored
    rows = other_equations(at.problem, at.state)["position"]
    # What exterior orientations and the mounting follow is the same for any points: these are eliminated.
    right = np.zeros((at.problem.layout.size, fields.shape[1]))
    pulls = rows.coefficient[:, None] * np.repeat(rows.weight[:, None] * fields, np.diff(rows.start), axis=0)
    np.add.at(right, rows.column, pulls)
    right[at.problem.held] = 0.0
    steps = solve(at.problem.layout.envelope, at.normal.matrix, right)
    information = fields.T @ fields - right.T @ steps
    return _Further((information + information.T) / 2, fields.T @ (rows.weight * rows.residual), steps.T)


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

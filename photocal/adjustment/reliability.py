"""Reliability: which errors the tests would find, and what those they miss would do.

Internal reliability is the smallest error of an observation that the test of its standardised residual
finds with a stated power (Baarda 1968); external reliability the effect of such an error on the unknowns
(Foerstner 1979).
"""

from dataclasses import dataclass

import numpy as np

from photocal.adjustment.envelope import selected_inverse
from photocal.adjustment.factored import Factored, covariance_column, factored
from photocal.adjustment.kernels.data import Cofactors
from photocal.adjustment.network import Network
from photocal.adjustment.normal import values_of
from photocal.adjustment.score import followed_by
from photocal.adjustment.sensitivity import point_effects
from photocal.adjustment.solution import Solution
from photocal.base.arrays import Floats
from photocal.base.chi_square import noncentrality
from photocal.base.policy import policy
from photocal.geometry.camera import PARAMETERS

# Below this redundancy number no other observation checks an observation.
UNCHECKED = 1e-9


@dataclass(frozen=True)
class Reliability:
    """Reliability of an adjusted network.

    noncentrality: delta0: the shift of a standardised residual that is found with the stated power.
    ray_bias (rays, 2): minimal detectable bias of each image coordinate, in the unit of the image plane;
        infinite where nothing checks it.
    ray_external (rays, 2): delta_bar: no function of the unknowns moves by more than this many of its
        standard deviations when a bias of that size stays.
    ray_on_c (rays, 2): change of the principal distance of the ray's camera by such a bias, in its unit.
    ray_on_point (rays, 2): length of the displacement of the ray's own point by such a bias, m.
    control_bias, control_external, control_on_c (points, 3): the same for the observed coordinates of points,
        m; NaN where there is none. `control_on_c` is the largest change of any camera's principal distance.
    """

    noncentrality: float
    ray_bias: Floats
    ray_external: Floats
    ray_on_c: Floats
    ray_on_point: Floats
    control_bias: Floats
    control_external: Floats
    control_on_c: Floats


def minimal_detectable_bias(sigma: Floats, redundancy: Floats, delta0: float) -> Floats:
    """Smallest error that is found: delta0 sigma / sqrt(r) (Baarda 1968); infinite where r is 0."""
    return np.asarray(delta0 * sigma / np.sqrt(_checked(redundancy)))


def external_reliability(redundancy: Floats, delta0: float) -> Floats:
    """Largest effect of an undetected error on any function of the unknowns, in its standard deviations.

    delta_bar = delta0 sqrt((1 - r) / r) (Foerstner 1979, eq. for the sensitivity of uncorrelated
    observations); infinite where r is 0.
    """
    r = _checked(redundancy)
    return np.asarray(np.where(r > 0, delta0 * np.sqrt(np.maximum(1 - redundancy, 0.0)) / np.sqrt(r), np.inf))


def _checked(redundancy: Floats) -> Floats:
    return np.where(redundancy > UNCHECKED, redundancy, 0.0)


def reliability(
    network: Network,
    solution: Solution,
    significance: float = policy.significance,
    power: float = policy.power,
) -> Reliability:
    """Internal and external reliability of all rays and control coordinates."""
    delta0 = noncentrality(significance, power)
    at = factored(network, solution.state)
    with np.errstate(divide="ignore", invalid="ignore"):
        bias = minimal_detectable_bias(network.rays.sigma, solution.redundancy, delta0)
        external = external_reliability(solution.redundancy, delta0)
        control, control_external = _control_reliability(network, solution, delta0)
        directions = [_direction_of_c(at, k) for k in range(len(network.cameras))]
        on_c = _on_c(at, directions) * bias
        effect = _on_own_points(at) * bias[..., None]
        control_on_c = np.full(control.shape, 0.0 if directions else np.nan)
        for _, points in directions:
            moved = np.einsum("na,nab->nb", points, network.points.weight) * control
            control_on_c = np.fmax(control_on_c, np.abs(moved))
    return Reliability(
        delta0,
        bias,
        external,
        on_c,
        np.linalg.norm(effect, axis=-1),
        control,
        control_external,
        np.where(np.isnan(control), np.nan, control_on_c),
    )


def _control_reliability(network: Network, solution: Solution, delta0: float) -> tuple[Floats, Floats]:
    """Minimal detectable bias and delta_bar of observed point coordinates with full weight matrices."""
    # With P the weights, a bias in coordinate i shifts the test by sqrt((P Qvv P)_ii) of it.
    weight = network.points.weight
    weights = np.diagonal(weight, axis1=1, axis2=2)
    adjusted = np.einsum("nab,nbc,ncd->nad", weight, solution.point_covariance, weight)
    through = np.diagonal(adjusted, axis1=1, axis2=2)
    observed = weights > 0
    checked = np.where(weights - through > UNCHECKED * weights, weights - through, 0.0)
    bias = np.where(observed, delta0 / np.sqrt(checked), np.nan)
    external = np.where(checked > 0, bias * np.sqrt(np.maximum(through, 0.0)), np.inf)
    return bias, np.where(observed, external, np.nan)


def _direction_of_c(at: Factored, camera: int) -> tuple[Floats, Floats]:
    """Column of the covariance that belongs to a principal distance: reduced part and points."""
    # Zero when it is held.
    layout = at.problem.layout
    active, columns = layout.camera_columns[camera]
    right, points = np.zeros(layout.size), np.zeros_like(at.state.points)
    right[columns[active == PARAMETERS.index("c")]] = 1.0
    return covariance_column(at, right, points) if right.any() else (right, points)


def _on_c(at: Factored, directions: list[tuple[Floats, Floats]]) -> Floats:
    """Change of the own camera's principal distance per unit of each image coordinate, (rays, 2)."""
    design = at.problem.design
    camera = at.problem.network.exposures.camera[design.ray_image]
    effect = np.zeros(design.weight.shape)
    for k, direction in enumerate(directions):
        effect = np.where((camera == k)[:, None], followed_by(at, *direction) * design.weight, effect)
    return effect


def _on_own_points(at: Factored) -> Floats:
    """Change of a ray's own point per unit of each image coordinate, shape (rays, 2, 3)."""
    problem, normal, state = at.problem, at.normal, at.state
    design, values = problem.design, values_of(problem, state)
    inverse = selected_inverse(problem.layout.envelope, normal.matrix)
    cofactors = Cofactors(problem.layout.envelope, inverse, normal.kept)
    effect = np.zeros((*design.weight.shape, 3))
    point_effects(design, values, cofactors, effect)
    datum = at.datum
    if datum is None:
        return effect
    # S-transformation to inner constraints: what all datum points moved on the average is taken back.
    common = followed_by(at, datum.spread.T, np.moveaxis(datum.point_spread, 2, 0)) * design.weight
    moves = (datum.point_moves @ datum.inverse)[problem.network.rays.point]
    return np.asarray(effect - np.einsum("nad,dnr->nra", moves, common))

"""Gross errors: a robust start, then data snooping with re-admission.

The start weighs rays down by their residual (Cauchy's function on a scale that follows the residuals'
median), so that gross errors do not bend the network. What then stands out is set aside, the rest
adjusted, and every ray tested by its standardised residual: the worst of each point is rejected, those
that fit again are taken back, until nothing changes (Baarda 1968; Pope 1976).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import special

from photocal.adjustment.covariance import complete
from photocal.adjustment.datum import with_datum
from photocal.adjustment.factored import factorised
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.network import Network
from photocal.adjustment.normal import Problem, normal_equations, other_equations, prepare, values_of
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration, minimise, moved_by, reduced_step
from photocal.adjustment.state import State, start_state
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import NotConvergedError
from photocal.base.policy import policy

Test = Literal["w", "tau"]


@dataclass(frozen=True)
class Snooping:
    """An adjustment without its gross errors.

    network: what was adjusted: the accepted rays and the points that they determine.
    accepted (rays,): rays of the original network that take part.
    points: points of the original network that take part.
    """

    network: Network
    solution: Solution
    accepted: Flags
    points: Integers
    rounds: int


def snoop(network: Network, test: Test = "w", report: Callable[[Iteration], None] | None = None) -> Snooping:
    """Adjust a network that may hold gross errors among its rays.

    test: test with the a priori standard deviations (Baarda's w) or with the a posteriori variance factor
        (Pope's tau).
    raises IllPosedError: when the accepted observations do not determine the unknowns.
    raises NotConvergedError: when the iteration or the rejections do not come to an end.
    """
    most_rounds, rounding = 30, 1e-14
    whole = prepare(network)
    state = robust_state(with_datum(whole, start_state(network)), start_state(network), report)
    fit = ray_fit(whole, state)
    level = significance_of(2 * len(fit))
    accepted = fit < np.sqrt(special.chdtri(2, level)) * _scale(fit)
    for rounds in range(1, most_rounds + 1):
        part, rays, points = subset(network, accepted)
        start = replace(state, points=state.points[points])
        problem = with_datum(prepare(part), start)
        minimum = minimise(problem, start, report)
        solution = complete(factorised(problem, minimum), minimum.iterations)
        moved = state.points.copy()
        moved[points] = solution.points
        state = replace(solution.state, points=moved)
        wrong = np.zeros(len(accepted), dtype=np.bool_)
        # Of exact coordinates rounding is left: what it looks like is no gross error.
        if test == "w" or not solution.variance_factor < rounding:
            wrong[rays[worst_of_points(part, solution, test)]] = True
        factor = np.sqrt(solution.variance_factor) if test == "tau" else 1.0
        fits = ray_fit(whole, state) < -special.ndtri(level / 2) * factor
        inside = np.zeros(len(network.points.values), dtype=np.bool_)
        inside[points] = True
        # Late in the search nothing is taken back, so that it ends.
        again = fits & ~accepted & inside[network.rays.point] & (rounds < most_rounds // 2)
        if not wrong.any() and not again.any():
            taking_part = np.zeros(len(accepted), dtype=np.bool_)
            taking_part[rays] = True
            return Snooping(part, solution, taking_part, points, rounds)
        accepted = (accepted & ~wrong) | again
    raise NotConvergedError(
        f"data snooping still finds gross errors after {most_rounds} rounds",
        "check the images with the largest residuals; whole images may be wrong",
    )


def robust_state(problem: Problem, state: State, report: Callable[[Iteration], None] | None = None) -> State:
    """State that gross errors do not bend, by damped iteratively reweighted least squares."""
    # The robust start ends when a step takes less than this share of what is left.
    settled_share = 1e-5
    fit, damping = ray_fit(problem, state), 0.0
    # Cauchy's function halves the weight of a ray at this multiple of the scale.
    half_weight = 3.0
    for number in range(1, 41):
        scale = half_weight * _scale(fit)
        factor = 1.0 / (1.0 + (fit / scale) ** 2)
        weight = problem.design.weight * factor[:, None]
        weighted = replace(problem, design=problem.design._replace(weight=weight))
        cost = _cost(problem, state, fit, scale)
        while True:
            normal = normal_equations(weighted, state, damping)
            step = reduced_step(weighted, normal, damping)
            if step is not None:
                moved, decrement = moved_by(weighted, state, normal, step)
                moved_fit = ray_fit(problem, moved)
                lower = _cost(problem, moved, moved_fit, scale)
                if lower <= cost * (1 + 1e-9):
                    break
            damping = max(1e-4, 10 * damping)
            if damping > 1e3:
                return state
        state, fit = moved, moved_fit
        if report:
            report(Iteration(number, normal.chi_squared, decrement, damping))
        # The weights follow the residuals, so that the last digits of this state mean nothing.
        settled = decrement < 1e-3 * np.sqrt(len(fit)) or lower > (1 - settled_share) * cost
        if damping <= 1e-3 and settled:
            break
        damping = damping / 10 if damping > 1e-6 else 0.0
    return state


def _cost(problem: Problem, state: State, fit: Floats, scale: float) -> float:
    """Cauchy's function of the rays, and v'Pv of all other observations."""
    points = problem.network.points
    away = state.points - points.values
    others = sum(equations.chi_squared() for equations in other_equations(problem, state).values())
    return float(
        scale**2 * np.log1p((fit / scale) ** 2).sum()
        + np.einsum("na,nab,nb", away, points.weight, away)
        + others
    )


def ray_fit(problem: Problem, state: State) -> Floats:
    """Length of each ray's residual in units of its standard deviations, shape (rays,).

    Infinite for points behind the camera.
    """
    rays = problem.network.rays
    residuals, depth = np.empty(rays.plane.shape), np.empty(len(rays.image))
    evaluate(problem.design, values_of(problem, state), residuals, depth)
    return np.where(depth > 0, np.linalg.norm(residuals / rays.sigma, axis=1), np.inf)


def worst_of_points(network: Network, solution: Solution, test: Test) -> Integers:
    """Rays whose standardised residual is rejected; of each point at most the worst."""
    w = np.abs(solution.standardised(network.rays.sigma))
    if test == "tau":
        w = w / np.sqrt(solution.variance_factor)
    worst = np.nanmax(np.nan_to_num(w), axis=1)
    order = np.lexsort((-worst, network.rays.point))
    _, first = np.unique(network.rays.point[order], return_index=True)
    leading = order[first]
    limit = critical_value(solution.degrees_of_freedom, test, significance_of(w.size))
    return np.asarray(leading[worst[leading] > limit])


def significance_of(tests: int) -> float:
    """Probability of rejecting one good observation when so many are tested."""
    return min(policy.significance, 1.0 / max(tests, 1))


def critical_value(degrees_of_freedom: int, test: Test, significance: float) -> float:
    """Critical value of a standardised residual, two-sided."""
    if test == "w" or degrees_of_freedom < 2:
        return float(-special.ndtri(significance / 2))
    t = -special.stdtrit(degrees_of_freedom - 1, significance / 2)
    return float(t * np.sqrt(degrees_of_freedom) / np.sqrt(degrees_of_freedom - 1 + t**2))


def subset(network: Network, accepted: Flags) -> tuple[Network, Integers, Integers]:
    """Network of some of the rays, without the points that are then no longer determined."""
    count = np.bincount(network.rays.point[accepted], minlength=len(network.points.values))
    known = network.points.held.all(axis=1) | (np.diagonal(network.points.weight, axis1=1, axis2=2) > 0).any(
        axis=1
    )
    needed = count >= np.where(known, 1, 2)
    needed[network.relations.points] = True
    points = np.flatnonzero(needed)
    rays = np.flatnonzero(accepted & needed[network.rays.point])
    place = np.full(len(needed), -1)
    place[points] = np.arange(len(points))
    datum = network.datum_points
    if datum is not None and len(datum):
        datum = place[datum][place[datum] >= 0]
    part = replace(
        network,
        points=network.points.rows(points),
        rays=replace(network.rays, point=place[network.rays.point]).rows(rays),
        point_names=tuple(network.point_names[j] for j in points),
        relations=network.relations.moved(place),
        lasers=network.lasers.of_points(place, needed),
        datum_points=datum,
    )
    return part, rays, points


def _scale(fit: Floats) -> float:
    """Scale of the residuals' lengths from their median, at least 1: the a priori sigmas."""
    # The median of the length of a pair of unit normal deviates is sqrt(2 ln 2).
    return max(1.0, float(np.median(fit) / np.sqrt(2 * np.log(2))))

"""Least squares adjustment of a network, from start values to statistics."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.covariance import complete
from photocal.adjustment.datum import with_datum
from photocal.adjustment.factored import factorised
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.ledger import enter
from photocal.adjustment.network import Network
from photocal.adjustment.normal import Problem, normal_equations, prepare, values_of
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import CONVERGED, Iteration, Minimum, chords, minimise, moved_by, reduced_step
from photocal.adjustment.state import State, start_state
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.geometry.distortion import slopes_of
from photocal.geometry.resection import intersect


def adjust(
    network: Network,
    report: Callable[[Iteration], None] | None = None,
    state: State | None = None,
    near: float = CONVERGED,
) -> Solution:
    """Adjust a network by weighted least squares (Gauss-Markov model with weighted constraints).

    state: to start from, in place of the network's values: of a solution of the same images and points.
    near: squared distance to the minimum, in units of the standard deviations, that may be left.
    raises IllPosedError: when the observations do not determine the unknowns.
    raises NotConvergedError: when the iteration does not end.
    """
    return with_statistics(*minimum_of(network, report, state, near)).solution


def adjusted_network(
    network: Network, report: Callable[[Iteration], None] | None = None, state: State | None = None
) -> AdjustedNetwork:
    """Adjust a network as `adjust`, and keep the factor of its normal equations for what is asked next."""
    return with_statistics(*minimum_of(network, report, state))


def with_statistics(problem: Problem, minimum: Minimum) -> AdjustedNetwork:
    """Complete a minimum by what can be believed of it."""
    at = factorised(problem, minimum)
    return AdjustedNetwork(problem.network, minimum.state, complete(at, minimum.iterations), at)


def minimum_of(
    network: Network,
    report: Callable[[Iteration], None] | None = None,
    state: State | None = None,
    near: float = CONVERGED,
) -> tuple[Problem, Minimum]:
    """Adjust a network without its statistics, as `adjust`.

    near: squared distance to the minimum, in units of the standard deviations, that may be left.
    """
    start = start_state(network)
    problem = with_datum(prepare(network), start)
    moving = network.exposures.motion_sigma is not None and start.deviations.size > 0
    better = None if state is not None else _where_rays_come_from(problem, start)
    if state is None and better is None and moving:
        state = _near(replace(network, exposures=replace(network.exposures, motion_sigma=None)), report)
    if state is not None and state.deviations.shape != start.deviations.shape:
        state = replace(state, deviations=start.deviations)
    if state is not None and moving and not len(problem.stiffened):
        minimum = _by_chords(problem, state, report, near)
        if minimum is not None:
            enter(len(network.image_names), len(network.rays.image), len(minimum.iterations))
            return problem, minimum
    return problem, minimise(problem, state or better or start, report, near)


def _where_rays_come_from(problem: Problem, start: State) -> State | None:
    """Start with the centres that given angles and points tell; None where these fit the rays hardly better.

    What orients a block writes its angles and its points: positions that it found to be metres off stay as
    they were observed, and rays from there would turn the whole block first.
    """
    network = problem.network
    exposures, rays, points = network.exposures, network.rays, network.points
    sigma = exposures.sigma[:, 3:]
    loose = np.asarray(((sigma > 0.0) & np.isfinite(sigma)).all(axis=1))
    if not loose.any():
        return None
    rays = rays.rows(loose[rays.image])
    slopes = slopes_of(network.cameras, exposures.camera[rays.image], rays.plane)
    rotation, from_points = start.rotation[rays.image], points.values[rays.point]
    # Mean squared sine between the rays of an image that tell where it was.
    least_across = 1e-4
    centre = intersect(
        rays.image, len(loose), from_points, rotation, slopes, np.ones(len(slopes)), least_across
    )
    moved = replace(start, centre=np.where(np.isfinite(centre), centre, start.centre))
    # Of a few heads or images that are far off, the sum of squares tells nothing but of them.
    (total, usual), (total_before, usual_before) = _misfit(problem, moved), _misfit(problem, start)
    # Angles and points that belong together leave so much less of a usual residual's square: others are no
    # better than positions.
    much_less = 0.1
    return moved if total < total_before and usual < much_less * usual_before else None


def _misfit(problem: Problem, state: State) -> tuple[float, float]:
    """Give v'Pv of the rays and its median for a coordinate; infinite where a point lies behind a camera."""
    residuals, depth = np.empty(problem.network.rays.plane.shape), np.empty(len(problem.network.rays.image))
    evaluate(problem.design, values_of(problem, state), residuals, depth)
    ahead = bool((depth > 0.0).all())
    squares = (residuals / problem.network.rays.sigma) ** 2
    return (float(np.sum(squares)), float(np.median(squares))) if ahead else (np.inf, np.inf)


def _near(network: Network, report: Callable[[Iteration], None] | None) -> State | None:
    """State near the minimum of a network whose images move as given; None where there is none.

    With movements as unknowns an iteration takes several times as long, and from here it takes few.
    """
    # Squared distance, in units of the standard deviations, at which the movements of images are freed.
    near_enough = 1.0
    start = start_state(network)
    try:
        return minimise(with_datum(prepare(network), start), start, report, near_enough).state
    except (IllPosedError, NotConvergedError):
        return None


def _by_chords(
    problem: Problem, state: State, report: Callable[[Iteration], None] | None, near: float
) -> Minimum | None:
    """Find the minimum near a state with one factor for all steps; None where it is not near enough."""
    normal = normal_equations(problem, state)
    step = reduced_step(problem, normal, 0.0)
    if step is None:
        return None
    moved, length = moved_by(problem, state, normal, step)
    found = chords(problem, normal, moved, near, length)
    if not found.reached or not found.chi_squared < normal.chi_squared:
        return None
    steps = (Iteration(1, found.chi_squared, length, 0.0),)
    if report:
        report(steps[0])
    return Minimum(found.state, normal_equations(problem, found.state, 0.0, normal.kept), steps)

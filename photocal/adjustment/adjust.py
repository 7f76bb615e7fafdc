"""Least squares adjustment of a network, from start values to statistics."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from photocal.adjustment.covariance import complete
from photocal.adjustment.datum import with_datum
from photocal.adjustment.factored import factorised
from photocal.adjustment.network import Network
from photocal.adjustment.normal import Problem, prepare
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration, Minimum, minimise
from photocal.adjustment.state import State, start_state


def adjust(
    network: Network, report: Callable[[Iteration], None] | None = None, state: State | None = None
) -> Solution:
    """Adjust a network by weighted least squares (Gauss-Markov model with weighted constraints).

    Parameters
    ----------
    state : State, optional
        To start from, in place of the network's values: of a solution of the same images and points.

    Raises
    ------
    IllPosedError
        When the observations do not determine the unknowns.
    NotConvergedError
        When the iteration does not end.
    """
    began = time.perf_counter()
    problem, minimum = minimum_of(network, report, state)
    solved = time.perf_counter()
    solution = complete(factorised(problem, minimum), minimum.iterations)
    timing = {"solve": solved - began, "covariance": time.perf_counter() - solved}
    return replace(solution, timing_s=timing)


def minimum_of(
    network: Network, report: Callable[[Iteration], None] | None = None, state: State | None = None
) -> tuple[Problem, Minimum]:
    """Adjust a network without its statistics, as `adjust`."""
    start = start_state(network)
    problem = with_datum(prepare(network), start)
    if state is not None and state.deviations.shape != start.deviations.shape:
        state = replace(state, deviations=start.deviations)
    return problem, minimise(problem, state or start, report)

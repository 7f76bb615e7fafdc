"""Least squares adjustment of a network, from start values to statistics."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from photocal.adjustment.covariance import complete
from photocal.adjustment.datum import with_datum
from photocal.adjustment.network import Network
from photocal.adjustment.normal import prepare
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration, minimise
from photocal.adjustment.state import start_state


def adjust(network: Network, report: Callable[[Iteration], None] | None = None) -> Solution:
    """Adjust a network by weighted least squares (Gauss-Markov model with weighted constraints).

    Parameters
    ----------
    report : callable, optional
        Called after each iteration.

    Returns
    -------
    Solution
        Values, covariances, residuals, redundancy numbers.

    Raises
    ------
    IllPosedError
        When the observations do not determine the unknowns.
    NotConvergedError
        When the iteration does not end.
    """
    state = start_state(network)
    began = time.perf_counter()
    problem = with_datum(prepare(network), state)
    minimum = minimise(problem, state, report)
    solved = time.perf_counter()
    solution = complete(problem, minimum)
    timing = {"solve": solved - began, "covariance": time.perf_counter() - solved}
    return replace(solution, timing_s=timing)

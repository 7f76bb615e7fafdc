"""Least squares adjustment of a network, from start values to statistics."""

from __future__ import annotations

from collections.abc import Callable

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
    network : Network
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
    problem = with_datum(prepare(network), state)
    return complete(problem, minimise(problem, state, report))

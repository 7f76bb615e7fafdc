"""The iteration: Gauss-Newton steps, damped after Levenberg and Marquardt where they would fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.errors import NotConvergedError
from photocal.adjustment.envelope import factorise, solve
from photocal.adjustment.kernels import back_substitute
from photocal.adjustment.normal import (
    Normal,
    Problem,
    diagonal_addresses,
    normal_equations,
    other_equations,
    values_of,
)
from photocal.adjustment.rank import explain_singular, weakest_pivot
from photocal.adjustment.state import State, moved_exposures

Floats = NDArray[np.float64]

# The squared length of the last step in units of the standard deviations (Newton decrement).
CONVERGED = 1e-6
ITERATIONS = 50
# Below this share of a diagonal element that remains after elimination, rounding decides.
SINGULAR_PIVOT = 1e-11


@dataclass(frozen=True)
class Iteration:
    """One line of the iteration's record.

    Attributes
    ----------
    number : int
    chi_squared : float
        Sum of v'Pv after the step.
    decrement : float
        Squared length of the step in units of the standard deviations.
    damping : float
        0 for a pure Gauss-Newton step.
    """

    number: int
    chi_squared: float
    decrement: float
    damping: float


@dataclass(frozen=True)
class Minimum:
    """Where the iteration ended.

    Attributes
    ----------
    state : State
    chi_squared : float
    iterations : tuple of Iteration
    """

    state: State
    chi_squared: float
    iterations: tuple[Iteration, ...]


def minimise(problem: Problem, state: State, report: Callable[[Iteration], None] | None = None) -> Minimum:
    """Find the state of least v'Pv.

    Parameters
    ----------
    problem : Problem
    state : State
        Start values of all unknowns.
    report : callable, optional
        Called after each iteration.

    Returns
    -------
    Minimum

    Raises
    ------
    IllPosedError
        When the observations do not determine the unknowns.
    NotConvergedError
        When the iteration does not end.
    """
    damping, decrement, steps = 0.0, np.inf, list[Iteration]()
    while len(steps) < ITERATIONS:
        normal = normal_equations(problem, state, damping)
        trial = _step(problem, state, normal, damping)
        if trial is None and damping == 0.0 and decrement < CONVERGED:
            explain_singular(problem, state)
        # At the minimum rounding may raise the sum of squares in its last digits.
        if trial is None or not (trial.chi_squared <= normal.chi_squared or trial.decrement < CONVERGED):
            damping = 10 * damping if damping else 1e-3
            if damping > 1e8:
                explain_singular(problem, state)
                raise NotConvergedError(
                    "no step reduces the sum of squares",
                    remedy="check the start values of images and points, their units and axes",
                )
            continue
        state, decrement = trial.state, trial.decrement
        steps.append(Iteration(len(steps) + 1, trial.chi_squared, decrement, damping))
        if report:
            report(steps[-1])
        if decrement < CONVERGED and damping == 0.0:
            return Minimum(state, trial.chi_squared, tuple(steps))
        damping = damping / 10 if damping > 1e-6 and decrement >= CONVERGED else 0.0
    explain_singular(problem, state)
    raise NotConvergedError(
        f"not converged after {ITERATIONS} iterations (last step {np.sqrt(decrement):.2g} sigma)",
        remedy="check the start values, and what the network leaves undetermined",
    )


@dataclass(frozen=True)
class _Trial:
    state: State
    chi_squared: float
    decrement: float


def _step(problem: Problem, state: State, normal: Normal, damping: float) -> _Trial | None:
    """Try one step; None when the normal equations cannot be solved."""
    diagonal = diagonal_addresses(problem)
    before = normal.matrix[diagonal]
    factor = normal.matrix
    if len(normal.singular) or factorise(problem.layout.envelope, factor) >= 0:
        return None
    if damping == 0.0 and weakest_pivot(factor[diagonal], before) < SINGULAR_PIVOT:
        return None
    step = solve(problem.layout.envelope, factor, -normal.gradient)
    step[problem.held] = 0.0
    cameras, rotation, centre = moved_exposures(problem.network, problem.layout, state, step)
    moved = State(cameras, rotation, centre, np.empty_like(state.points))
    threads = len(problem.design.pieces) - 1
    totals, decreases = np.zeros(threads), np.zeros(threads)
    back_substitute(
        problem.design,
        values_of(problem, state),
        problem.structure,
        damping,
        step,
        values_of(problem, moved),
        decreases,
        totals,
    )
    others = other_equations(problem, moved).values()
    chi_squared = float(totals.sum()) + sum(equations.chi_squared() for equations in others)
    decrement = float(decreases.sum() - normal.gradient @ step)
    return _Trial(moved, chi_squared, decrement)

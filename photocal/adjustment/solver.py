"""The iteration: Gauss-Newton steps, damped after Levenberg and Marquardt where they would fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Floats
from drivers.errors import NotConvergedError
from photocal.adjustment.datum import inner_state
from photocal.adjustment.envelope import factorise, solve
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.kernels.substitution import back_substitute
from photocal.adjustment.normal import (
    Normal,
    Problem,
    diagonal_addresses,
    normal_equations,
    values_of,
)
from photocal.adjustment.rank import (
    SINGULAR,
    SUSPECT,
    Limits,
    explain_singular,
    only_the_datum_is_weak,
    share_of_datum,
    weakest_pivot,
)
from photocal.adjustment.state import State, moved_exposures, round_the_middle
from photocal.adjustment.unknowns import unknowns

# Squared distance to the minimum, in units of the standard deviations, that is left of a solution.
CONVERGED = 1e-12
# Only between steps this short, in units of what may be left, is that rate known: the first steps shrink much
# faster than the last.
SHORT = 1e4
# A step this short that no longer lowers the sum of squares shows that rounding is reached.
ROUNDING = 1e-6
# After one this short the normal equations are those from before it.
NEGLIGIBLE = 1e-12
ITERATIONS = 50
# Where the iteration comes to no end, a step this short (sigmas) is none.
NEARLY = 0.01
# A step that moves the block as a whole, but for this little, is one of the datum alone.
WHOLE = 0.99
# A step that would gain no more than this share of v'Pv, and gains nothing, is too long for a valley that
# bends (a precise block that something imprecise holds in space): parts of it are tried before damping.
VALLEY, LEAST_SHARE = 0.01, 0.02
# Below this share of a diagonal element that remains after elimination, rounding decides.
SINGULAR_PIVOT = 1e-13


@dataclass(frozen=True)
class Iteration:
    """One line of the iteration's record.

    chi_squared: sum of v'Pv after the step.
    decrement: squared length of the step in units of the standard deviations.
    damping: 0 for a pure Gauss-Newton step.
    """

    number: int
    chi_squared: float
    decrement: float
    damping: float


@dataclass(frozen=True)
class Minimum:
    """Where the iteration ended.

    normal: normal equations there, without damping.
    factored: whether their matrix is the Cholesky factor already.
    """

    state: State
    normal: Normal
    iterations: tuple[Iteration, ...]
    factored: bool = False


def minimise(
    problem: Problem,
    state: State,
    report: Callable[[Iteration], None] | None = None,
    near: float = CONVERGED,
) -> Minimum:
    """Find the state of least v'Pv.

    near: squared distance to the minimum, in units of the standard deviations, that may be left.
    raises IllPosedError: when the observations do not determine the unknowns.
    raises NotConvergedError: when the iteration does not end.
    """
    damping, decrement, share, steps = 0.0, np.inf, 1.0, list[Iteration]()
    start = state
    normal = normal_equations(problem, state)
    while len(steps) < ITERATIONS:
        step = reduced_step(problem, normal, damping)
        if step is None and damping == 0.0 and decrement < ROUNDING:
            explain_singular(problem, state)
        along_a_valley = False
        if step is not None:
            moved, step_decrement = moved_by(problem, state, normal, share * step)
            # Steps shrink at a steady rate: the next one tells how far the minimum still is.
            shrinking = min(1.0, step_decrement / decrement) if steps else 1.0
            left, whole = step_decrement * shrinking, damping == 0.0 and share == 1.0
            last = whole and step_decrement < SHORT * near and left < near
            if last and step_decrement < NEGLIGIBLE and not len(problem.stiffened):
                # Over so short a step the normal equations do not change by what shows in any figure.
                normal = replace(normal, chi_squared=normal.chi_squared - step_decrement)
                steps.append(Iteration(len(steps) + 1, normal.chi_squared, step_decrement, damping))
                if report:
                    report(steps[-1])
                return Minimum(moved, normal, tuple(steps), factored=True)
            calmer = damping / 10 if damping > 1e-6 and step_decrement >= ROUNDING else 0.0
            trial = normal_equations(problem, moved, calmer, normal.kept)
            lower = trial.chi_squared < normal.chi_squared
            if lower or (step_decrement < ROUNDING and share == 1.0):
                state, normal, decrement = moved, trial, step_decrement
                steps.append(Iteration(len(steps) + 1, normal.chi_squared, decrement, damping))
                if report:
                    report(steps[-1])
                if last or (whole and not lower):
                    return _released(problem, Minimum(state, normal, tuple(steps)), start)
                damping, share = calmer, min(1.0, 4 * share)
                continue
            along_a_valley = ROUNDING < step_decrement < VALLEY * normal.chi_squared
        if along_a_valley and share > LEAST_SHARE:
            share /= 4
        else:
            damping, share = 10 * damping if damping else 1e-3, 1.0
        if damping > 1e8:
            return _released(problem, _ended(problem, state, steps, SINGULAR), start)
        normal = normal_equations(problem, state, damping, normal.kept)
    return _released(problem, _ended(problem, state, steps, SUSPECT), start)


def _ended(problem: Problem, state: State, steps: list[Iteration], limits: Limits) -> Minimum:
    """Where the iteration did not come to its end: the minimum for all purposes, or why it is none."""
    normal = normal_equations(problem, state)
    if not np.isfinite(normal.chi_squared):
        _explain_behind(problem, state)
    size = np.sqrt(np.maximum(normal.matrix[diagonal_addresses(problem)], 0.0))
    step = reduced_step(problem, normal, 0.0)
    decrement = np.inf if step is None else moved_by(problem, state, normal, step)[1]
    if decrement < NEARLY**2:
        return Minimum(state, normal_equations(problem, state), tuple(steps))
    drifts = step is not None and share_of_datum(problem, state, step, size) > WHOLE
    # A datum that is held, if loosely, is to blame only where what is left of the way is the datum's own.
    if limits == SINGULAR or drifts or not only_the_datum_is_weak(problem, state):
        explain_singular(problem, state, limits)
    moving = ""
    if step is not None:
        named = unknowns(problem)
        load = np.abs(step) * size * np.array([one is not None for one in named])
        some = [one.name for k in np.argsort(-load)[:3] if (one := named[k]) is not None and load[k] > 0]
        moving = f": {', '.join(some)} would still move" if some else ""
    raise NotConvergedError(
        f"not converged after {len(steps)} iterations (last step {np.sqrt(decrement):.2g} sigma){moving}",
        remedy="check the start values of images and points, their units and axes, for gross errors, and "
        "whether other observations should hold what moves",
    )


def _explain_behind(problem: Problem, state: State) -> None:
    """Name the points that lie behind cameras that see them."""
    rays = problem.network.rays
    residuals, depth = np.empty(rays.plane.shape), np.empty(len(rays.image))
    evaluate(problem.design, values_of(problem, state), residuals, depth)
    behind = np.flatnonzero(~(depth > 0.0))
    points, images = problem.network.point_names, problem.network.image_names
    some = ", ".join(f"{points[rays.point[r]]} of {images[rays.image[r]]}" for r in behind[:3])
    raise NotConvergedError(
        f"{len(behind)} ray(s) come from a point behind the camera ({some}), and no step brings it before it",
        remedy="correct the start values of these images or points, or leave them out to be computed",
    )


def _released(problem: Problem, minimum: Minimum, start: State) -> Minimum:
    """Move a free network onto its start values."""
    if not len(problem.stiffened):
        return minimum
    state = inner_state(problem, minimum.normal, minimum.state, start)
    normal = normal_equations(problem, state, 0.0, minimum.normal.kept)
    return Minimum(state, normal, minimum.iterations)


def reduced_step(problem: Problem, normal: Normal, damping: float) -> Floats | None:
    """Solve the reduced system, in place of its matrix; None when it is singular."""
    diagonal = diagonal_addresses(problem)
    before = normal.matrix[diagonal]
    if len(normal.singular) or factorise(problem.layout.envelope, normal.matrix) >= 0:
        return None
    if damping == 0.0 and weakest_pivot(normal.matrix[diagonal], before) < SINGULAR_PIVOT:
        return None
    step = solve(problem.layout.envelope, normal.matrix, -normal.gradient)
    step[problem.held] = 0.0
    return step


def moved_by(problem: Problem, state: State, normal: Normal, step: Floats) -> tuple[State, float]:
    """State after a step and the step's squared length in units of the standard deviations."""
    moved = moved_exposures(problem.network, problem.layout, state, step)
    points = state.points.copy()
    decreases = np.zeros(len(problem.design.pieces) - 1)
    back_substitute(problem.design, problem.structure, step, normal.kept, points, decreases)
    points[problem.layout.kept_points] += step[problem.layout.point_columns]
    moved = round_the_middle(problem.network, state, replace(moved, points=points))
    return moved, float(decreases.sum() - normal.gradient @ step)

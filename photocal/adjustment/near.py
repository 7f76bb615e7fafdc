"""Minima near one that is known: a parameter held elsewhere, images left out.

The normal equations of the known minimum are factorised once, or changed only where images are left out.
Steps with that factor (chord steps) end where an adjustment anew ends; their lengths tell how far that is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Flags, Floats
from drivers.errors import NotConvergedError
from photocal.adjustment.datum import full_solution
from photocal.adjustment.equations import Equations, add_equations
from photocal.adjustment.factored import Factored, factored
from photocal.adjustment.kernels.data import Design, Eliminated
from photocal.adjustment.kernels.elimination import accumulate
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.normal import (
    Normal,
    Problem,
    diagonal_addresses,
    other_equations,
    values_of,
)
from photocal.adjustment.sensitivity import across
from photocal.adjustment.solver import ROUNDING, moved_by, reduced_step
from photocal.adjustment.state import State, moved_exposures

STEPS = 12


@dataclass(frozen=True)
class Near:
    """A minimum near a known one.

    left: bound of the squared distance to it that is left, in units of the standard deviations.
    """

    state: State
    chi_squared: float
    left: float


def gradient(problem: Problem, state: State, equations: list[Equations]) -> tuple[float, Floats, Floats]:
    """Sum of v'Pv, and half its derivatives to the unknowns of the reduced system and to the points."""
    design, structure, layout = problem.design, problem.structure, problem.layout
    residuals, depth = np.empty_like(design.plane), np.empty(len(design.plane))
    values = values_of(problem, state)
    evaluate(design, values, residuals, depth)
    if not np.all(depth[design.weight[:, 0] > 0.0] > 0.0):
        raise NotConvergedError("a point came to lie behind a camera", remedy="look at the start values")
    reduced, points = np.zeros((len(design.pieces) - 1, layout.size)), np.zeros_like(state.points)
    across(design, values, structure, residuals, reduced, points)
    off = state.points - design.prior_points
    pull = np.einsum("nab,nb->na", design.prior_weight, off)
    points += pull * design.point_free
    total = reduced.sum(axis=0)
    total[layout.point_columns] += points[layout.kept_points]
    chi_squared = float(np.sum(design.weight * residuals**2) + np.sum(off * pull))
    for rows in equations:
        pulls = np.repeat(rows.weight * rows.residual, np.diff(rows.start))
        np.add.at(total, rows.column, rows.coefficient * pulls)
        chi_squared += rows.chi_squared()
    total[problem.held] = 0.0
    return chi_squared, total, points


def chords(
    problem: Problem,
    normal: Normal,
    state: State,
    near: float,
    equations: Callable[[State], list[Equations]],
    hold: tuple[int, Floats, Floats] | None = None,
) -> Near:
    """Step to a minimum with a factor that is given."""
    before = np.inf
    for _ in range(STEPS):
        chi_squared, reduced, points = gradient(problem, state, equations(state))
        step, moved = full_solution(problem, normal, -reduced, -points)
        if hold is not None:
            column, along, along_points = hold
            share = step[column] / along[column]
            step, moved = step - share * along, moved - share * along_points
        # Points that stay in the reduced system stand in both parts.
        points[problem.layout.kept_points] = 0.0
        length = -float(reduced @ step + np.sum(points * moved))
        if not (length < before / 2 or length < ROUNDING):
            break
        state = _moved(problem, state, step, moved)
        # Steps shrink at a steady rate: the next one tells how far the minimum still is.
        left = length * min(1.0, length / before) if np.isfinite(before) else length
        if left < near:
            return Near(state, chi_squared - length, max(left, 0.0))
        before = length
    raise NotConvergedError(
        "the minimum is not near", remedy="adjust the changed network from its start values"
    )


def with_held(at: Factored, column: int, change: float, near: float) -> Near:
    """Hold an unknown of the reduced system a change away from its estimate, and let all others follow.

    Where that is too far for the factor, the equations are set up again at the place that it led to.
    """

    def equations(state: State) -> list[Equations]:
        return list(other_equations(at.problem, state).values())

    along = _column(at, column)
    share = change / along[0][column]
    start = _moved(at.problem, at.state, share * along[0], share * along[1])
    try:
        return chords(at.problem, at.normal, start, near, equations, (column, *along))
    except NotConvergedError:
        there = factored(at.problem.network, start)
        return chords(there.problem, there.normal, start, near, equations, (column, *_column(there, column)))


def _column(at: Factored, column: int) -> tuple[Floats, Floats]:
    """Column of the inverse that belongs to an unknown of the reduced system."""
    right = np.zeros(at.problem.layout.size)
    right[column] = 1.0
    return full_solution(at.problem, at.normal, right, np.zeros_like(at.state.points))


def _moved(problem: Problem, state: State, step: Floats, points: Floats) -> State:
    exposures = moved_exposures(problem.network, problem.layout, state, step)
    return replace(exposures, points=state.points + points)


class Removals:
    """Leaves images out of an adjusted network, one set after the other.

    The reduced normal equations lose what the points that these images see have given to them, and get it
    again without their rays: an exact downdate, at the cost of a few points.
    """

    def __init__(self, problem: Problem, state: State) -> None:
        self._problem, self._state = problem, state
        design = problem.design
        self._matrix, self._gradient, self._kept, singular = _rays(problem, design, state.points, state)
        self._determined = not singular.any()
        weighted = np.diagonal(design.prior_weight, axis1=1, axis2=2) > 0
        self._known = (weighted | (design.point_free == 0.0)).any(axis=1)

    def without(self, out: Flags, near: float) -> Near | None:
        """Minimum without images; None where an adjustment anew must tell."""
        problem, state = self._problem, self._state
        columns = np.zeros(problem.layout.size, dtype=np.bool_)
        columns[problem.layout.image_columns[out]] = True
        own = problem.layout.own_columns[out]
        columns[own[own >= 0]] = True
        if not self._determined or columns[problem.stiffened].any():
            return None
        design, normal, singular = self._downdated(out)
        if singular:
            return None
        held = problem.held | columns
        changed = replace(problem, design=design, held=held)

        def equations(state: State) -> list[Equations]:
            return [_untouched(rows, columns) for rows in other_equations(problem, state).values()]

        for rows in equations(state):
            add_equations(*rows, problem.structure, normal.matrix, normal.gradient)
        diagonal = diagonal_addresses(problem)
        normal.matrix[diagonal[held]] = 1.0
        normal.matrix[diagonal[problem.stiffened]] *= 2.0
        step = reduced_step(changed, normal, 0.0)
        if step is None:
            return None
        moved, _ = moved_by(changed, state, normal, step)
        try:
            return chords(changed, normal, moved, near, equations)
        except NotConvergedError:
            return None

    def _downdated(self, out: Flags) -> tuple[Design, Normal, bool]:
        """Rays and normal equations without images, and whether a point is then not determined."""
        problem, state = self._problem, self._state
        network, design = problem.network, problem.design
        dropped = out[network.rays.image]
        count = np.bincount(network.rays.point[~dropped], minlength=len(state.points))
        affected = np.zeros(len(state.points), dtype=np.bool_)
        affected[network.rays.point[dropped]] = True
        lost = affected & (count < np.where(self._known, 1, 2))
        weight = design.weight.copy()
        weight[dropped | lost[network.rays.point]] = 0.0
        mine, points = affected[network.rays.point], np.flatnonzero(affected)
        part = design._replace(
            pieces=np.array([0, len(points)]),
            ray_start=np.concatenate([[0], np.cumsum(np.diff(design.ray_start)[points])]),
            ray_image=design.ray_image[mine],
            plane=design.plane[mine],
            weight=design.weight[mine],
            point_column=design.point_column[points],
            point_free=design.point_free[points],
            prior_points=design.prior_points[points],
            prior_weight=design.prior_weight[points],
        )
        matrix, gradient, _, _ = _rays(problem, part, state.points[points], state)
        less = part._replace(weight=weight[mine])
        less_matrix, less_gradient, kept, singular = _rays(problem, less, state.points[points], state)
        merged = Eliminated(*(array.copy() for array in self._kept))
        merged.mixed[mine] = kept.mixed
        for whole, own in zip(merged[1:], kept[1:], strict=True):
            whole[points] = own
        normal = Normal(
            self._matrix - matrix + less_matrix,
            self._gradient - gradient + less_gradient,
            0.0,
            np.zeros(0, dtype=np.int64),
            merged,
        )
        return design._replace(weight=weight), normal, bool((singular & ~lost[points]).any())


def _rays(
    problem: Problem, design: Design, points: Floats, state: State
) -> tuple[Floats, Floats, Eliminated, Flags]:
    """Reduced normal equations of rays and weighted points alone."""
    structure, where = problem.structure, problem.layout
    threads, count = len(design.pieces) - 1, len(points)
    kept = Eliminated(
        np.zeros((len(design.ray_image), 3, where.width)),
        np.zeros((count, 3, structure.lens)),
        np.zeros((count, 3, 3)),
        np.zeros((count, 3)),
    )
    matrices = np.zeros((threads, int(structure.offset[-1])))
    gradients, totals = np.zeros((threads, where.size)), np.zeros(threads)
    singular = np.zeros(count, dtype=np.bool_)
    values = values_of(problem, state)._replace(points=np.ascontiguousarray(points))
    accumulate(design, values, structure, 0.0, matrices, gradients, totals, kept, singular)
    return matrices.sum(axis=0), gradients.sum(axis=0), kept, singular


def _untouched(rows: Equations, columns: Flags) -> Equations:
    """Observations without those of unknowns that are left out."""
    touched = np.zeros(len(rows.weight), dtype=np.bool_)
    row = np.repeat(np.arange(len(rows.weight)), np.diff(rows.start))
    np.logical_or.at(touched, row, columns[rows.column])
    return rows._replace(weight=np.where(touched, 0.0, rows.weight))

"""Minima near one that is known: a parameter held elsewhere, images left out.

The normal equations of the known minimum are factorised once, or changed only where images are left out.
Steps with that factor (chord steps) end where an adjustment anew ends; their lengths tell how far that is.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from drivers.arrays import Flags, Floats
from drivers.errors import NotConvergedError
from photocal.adjustment.datum import full_solution
from photocal.adjustment.equations import Equations, add_equations
from photocal.adjustment.factored import Factored, factored
from photocal.adjustment.kernels.data import Design
from photocal.adjustment.normal import (
    Normal,
    Problem,
    add_rays,
    diagonal_addresses,
    eliminated,
    other_equations,
    pieces_of,
    values_of,
)
from photocal.adjustment.solver import Near, chords, moved_along, moved_by, reduced_step
from photocal.adjustment.state import State


def with_held(at: Factored, column: int, change: float, near: float) -> Near:
    """Hold a camera's parameter, by its column, a change away from its estimate, and let all others follow.

    Where that is too far for the factor, the equations are set up again at the place that it led to.
    """

    def equations(state: State) -> list[Equations]:
        return list(other_equations(at.problem, state).values())

    along = at.camera_column(column)
    share = change / along[0][column]
    start, length = moved_along(at.problem, at.state, share * along[0], share * along[1]), share * change
    try:
        return chords(at.problem, at.normal, start, near, equations, length, (column, *along))
    except NotConvergedError:
        there = factored(at.problem.network, start)
        hold = (column, *_column(there, column))
        return chords(there.problem, there.normal, start, near, equations, length, hold)


def _column(at: Factored, column: int) -> tuple[Floats, Floats]:
    """Column of the inverse that belongs to an unknown of the reduced system."""
    right = np.zeros(at.problem.layout.size)
    right[column] = 1.0
    return full_solution(at.problem, at.normal, right, np.zeros_like(at.state.points))


class Removals:
    """Leaves images out of an adjusted network, one set after the other.

    The reduced normal equations lose what the points that these images see have given to them, and get it
    again without their rays: an exact downdate, at the cost of a few points.
    """

    def __init__(self, problem: Problem, state: State) -> None:
        self._problem, self._state = problem, state
        design = problem.design
        self._kept = eliminated(problem, len(design.ray_image), len(state.points))
        self._matrix, values = problem.layout.envelope.zeros(), values_of(problem, state)
        self._gradient, _, singular = add_rays(problem, design, values, self._kept, self._matrix)
        self._determined = not singular.any()
        weighted = np.diagonal(design.prior_weight, axis1=1, axis2=2) > 0
        self._known = (weighted | (design.point_free == 0.0)).any(axis=1)

    def without(self, out: Flags, near: float) -> Near | None:
        """Minimum without images; None where an adjustment anew must tell.

        Where one step does not come near, the equations are set up again at the place that it led to.
        """
        found, moved = self.stepped(out, near)
        if found is None and moved is not None:
            found, _ = Removals(self._problem, moved).stepped(out, near)
        return found

    def stepped(self, out: Flags, near: float) -> tuple[Near | None, State | None]:
        """Minimum without images, if it is near; and where the first step leads, if there is one."""
        problem, state = self._problem, self._state
        columns = np.zeros(problem.layout.size, dtype=np.bool_)
        columns[problem.layout.image_columns[out]] = True
        own = problem.layout.own_columns[out]
        columns[own[own >= 0]] = True
        if not self._determined or columns[problem.stiffened].any():
            return None, None
        with self._downdated(out) as (design, normal, singular):
            if singular:
                return None, None
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
                return None, None
            moved, length = moved_by(changed, state, normal, step)
            try:
                return chords(changed, normal, moved, near, equations, length), moved
            except NotConvergedError:
                return None, moved

    @contextmanager
    def _downdated(self, out: Flags) -> Iterator[tuple[Design, Normal, bool]]:
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
        ray_start = np.concatenate([[0], np.cumsum(np.diff(design.ray_start)[points])])
        order, pieces, spans, reach = pieces_of(problem.layout, ray_start, design.ray_image[mine])
        part = design._replace(
            order=order,
            pieces=pieces,
            spans=spans,
            reach=reach,
            ray_start=ray_start,
            ray_image=design.ray_image[mine],
            plane=design.plane[mine],
            weight=design.weight[mine],
            point_column=design.point_column[points],
            point_free=design.point_free[points],
            prior_points=design.prior_points[points],
            prior_weight=design.prior_weight[points],
        )
        values = values_of(problem, state)._replace(points=np.ascontiguousarray(state.points[points]))
        kept = eliminated(problem, len(part.ray_image), len(points))
        matrix = self._matrix.copy()
        less, _, _ = add_rays(problem, part, values, kept, matrix, -1.0)
        part = part._replace(weight=weight[mine])
        more, _, singular = add_rays(problem, part, values, kept, matrix)
        gradient = self._gradient + less + more
        normal = Normal(matrix, gradient, 0.0, np.zeros(0, dtype=np.int64), self._kept)
        places = (mine, points, points, points)
        before = [whole[place] for whole, place in zip(self._kept, places, strict=True)]
        try:
            for whole, place, own in zip(self._kept, places, kept, strict=True):
                whole[place] = own
            yield design._replace(weight=weight), normal, bool((singular & ~lost[points]).any())
        finally:
            for whole, place, own in zip(self._kept, places, before, strict=True):
                whole[place] = own


def _untouched(rows: Equations, columns: Flags) -> Equations:
    """Observations without those of unknowns that are left out."""
    touched = np.zeros(len(rows.weight), dtype=np.bool_)
    row = np.repeat(np.arange(len(rows.weight)), np.diff(rows.start))
    np.logical_or.at(touched, row, columns[rows.column])
    return rows._replace(weight=np.where(touched, 0.0, rows.weight))

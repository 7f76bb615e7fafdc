"""Minima near one that is known: a parameter held elsewhere, images left out.

The normal equations of the known minimum are factorised once, or changed only where images are left out.
Steps with that factor (chord steps) end where an adjustment anew ends; their lengths tell how far that is.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from photocal.adjustment.adjusted import determined
from photocal.adjustment.datum import datum_columns, full_solution
from photocal.adjustment.envelope import clear, factorise, product, solve
from photocal.adjustment.equations import Equations, add_equations
from photocal.adjustment.factored import Factored, factored
from photocal.adjustment.kernels.data import Design, Reduced, point_room
from photocal.adjustment.kernels.removal import Removed, remove_images
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.normal import (
    Normal,
    Problem,
    diagonal_addresses,
    eliminated,
    other_equations,
    values_of,
)
from photocal.adjustment.rank import weakest_pivot
from photocal.adjustment.score import Score, score
from photocal.adjustment.solver import SINGULAR_PIVOT, Near, chords, moved_along, moved_by
from photocal.adjustment.state import State
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError

# Set-ups of the equations on the way to a parameter that is held.
_AGAIN = 3


def with_held(at: Factored, column: int, change: float, near: float) -> Near:
    """Hold a camera's parameter, by its column, a change away from its estimate, and let all others follow.

    Where that is too far for the factor, the equations are set up again at the place that it led to.
    """
    along = at.camera_column(column)
    share = change / along[0][column]
    start, length = moved_along(at.problem, at.state, share * along[0], share * along[1]), share * change
    found = chords(at.problem, at.normal, start, near, length, (column, *along))
    for _ in range(_AGAIN):
        if found.reached or not np.isfinite(found.chi_squared):
            break
        there = factored(at.problem.network, found.state)
        # The column of the inverse that belongs to the unknown.
        right = np.zeros(there.problem.layout.size)
        right[column] = 1.0
        hold = (column, *full_solution(there.problem, there.normal, right, np.zeros_like(start.points)))
        found = chords(there.problem, there.normal, found.state, near, found.left, hold)
    return found


class _Rest(NamedTuple):
    """A network without some images, one step from the whole minimum.

    normal: its matrix is the factor.
    length: of the step, squared, in units of the standard deviations.
    equations: gives the observations beside the rays.
    """

    problem: Problem
    normal: Normal
    moved: State
    length: float
    equations: Callable[[State], list[Equations]]


class Removals:
    """Leaves images out of an adjusted network, one set after the other.

    The reduced normal equations lose what the points that these images see have given to them, and get it
    again without their rays: an exact downdate, at the cost of a few points.
    """

    def __init__(self, at: Factored) -> None:
        self._problem, self._state, self._datum = at.problem, at.state, at.datum
        problem, normal = at.problem, at.normal
        self._kept, self._gradient, self._factor = normal.kept, normal.gradient.copy(), normal.matrix
        self._values = values_of(problem, at.state)
        # What the rays give: the whole system without all else.
        self._matrix = product(problem.layout.envelope, normal.matrix)
        self._matrix[diagonal_addresses(problem)[problem.stiffened]] /= 2.0
        for rows in at.others.values():
            less = rows._replace(weight=-rows.weight)
            add_equations(*less, problem.layout.envelope, self._matrix, self._gradient)
        # No ray touches these: nothing is to be left of them, not even rounding.
        common = np.zeros(problem.layout.size, dtype=np.bool_)
        common[problem.layout.common_columns[problem.layout.common_columns >= 0]] = True
        clear(problem.layout.envelope, self._matrix, common)
        self._gradient[common] = 0.0
        self._room = np.empty_like(self._matrix)

    def without(self, out: Flags, near: float) -> Near | None:
        """Minimum without images, or the way there as `chords`; None when the rest is not determined.

        Where the factor does not come near, the equations are set up again at the place that it led to.
        """
        found = self.stepped(out, near)
        if found is None or found.reached or not np.isfinite(found.chi_squared):
            return found
        again = None
        with suppress(IllPosedError):
            again = Removals(factored(self._problem.network, found.state)).stepped(out, near)
        return again if again is not None and again.chi_squared <= found.chi_squared else found

    def stepped(self, out: Flags, near: float) -> Near | None:
        """Where steps with one factor lead without images; None when the rest is not determined."""
        with self._rest(out) as rest:
            if rest is None:
                return None
            return chords(rest.problem, rest.normal, rest.moved, near, rest.length, equations=rest.equations)

    def scored(self, out: Flags, fields: Floats, near: float) -> Score | None:
        """Normal equations of further unknowns without images, where steps with one factor lead.

        fields (t, rays, 2): change of the computed image coordinates by a unit of each.
        returns: None when the rest is not determined.
        """
        with self._rest(out) as rest:
            if rest is None:
                return None
            problem, normal, moved, length, equations = rest
            moved = chords(problem, normal, moved, near, length, equations=equations).state
            residuals = np.empty(problem.network.rays.plane.shape)
            evaluate(problem.design, values_of(problem, moved), residuals, np.empty(len(residuals)))
            return score(Factored(problem, self._state, normal, None), residuals, fields)

    @contextmanager
    def _rest(self, out: Flags) -> Iterator[_Rest | None]:
        """What is left without images, factorised, and its first step; None when it is not determined."""
        problem, state = self._problem, self._state
        columns = np.zeros(problem.layout.size, dtype=np.bool_)
        columns[problem.layout.image_columns[out]] = True
        own_columns = problem.layout.own_columns[out]
        columns[own_columns[own_columns >= 0]] = True
        camera = problem.network.exposures.camera[out]
        for k in camera[problem.layout.with_image[camera]]:
            columns[problem.layout.camera_columns[k][1]] = True
        stiffened = self._stiffened(columns)
        with self._downdated(out) as (design, normal, singular, touched):
            changed = replace(problem, design=design, held=problem.held | columns, stiffened=stiffened)

            def equations(state: State) -> list[Equations]:
                """Other equations than of rays, but for those of the columns that are held."""
                return [_untouched(rows, columns) for rows in other_equations(problem, state).values()]

            if singular or not self._factorised(changed, normal, touched, columns):
                yield None
                return
            step = solve(problem.layout.envelope, normal.matrix, -normal.gradient)
            step[changed.held] = 0.0
            yield _Rest(changed, normal, *moved_by(changed, state, normal, step), equations)

    def _stiffened(self, columns: Flags) -> Integers:
        """Columns that carry the datum of a free network without some of its columns."""
        if self._datum is None or not columns[self._problem.stiffened].any():
            return self._problem.stiffened
        resistance = self._matrix[diagonal_addresses(self._problem)]
        return datum_columns(np.where(columns[:, None], 0.0, self._datum.moves), resistance)

    def _factorised(self, changed: Problem, normal: Normal, touched: Flags, columns: Flags) -> bool:
        """Complete the equations without some columns and factorise them; False when they are singular."""
        envelope = changed.layout.envelope
        clear(envelope, normal.matrix, columns)
        touched |= columns
        for rows in other_equations(self._problem, self._state).values():
            touched[rows.column[np.repeat(_touched(rows, columns), np.diff(rows.start))]] = True
            add_equations(*_untouched(rows, columns), envelope, normal.matrix, normal.gradient)
        diagonal = diagonal_addresses(self._problem)
        normal.matrix[diagonal[changed.held]] = 1.0
        normal.matrix[diagonal[changed.stiffened]] *= 2.0
        before = normal.matrix[diagonal]
        if factorise(envelope, normal.matrix, self._factor, int(np.argmax(touched))) >= 0:
            return False
        return bool(weakest_pivot(normal.matrix[diagonal], before) >= SINGULAR_PIVOT)

    @contextmanager
    def _downdated(self, out: Flags) -> Iterator[tuple[Design, Normal, bool, Flags]]:
        """Rays and normal equations without images; whether a point is not determined; columns touched."""
        problem, kept = self._problem, self._kept
        point, design = problem.network.rays.point, problem.design
        stays = ~out[design.ray_image]
        count = np.bincount(point[stays], minlength=len(problem.network.point_names))
        affected = np.bincount(point, minlength=len(count)) > count
        lost = affected & ~determined(problem.network, stays)
        stays &= ~lost[point]
        points = np.flatnonzero(affected)
        left = eliminated(problem, 0, len(points))
        np.copyto(self._room, self._matrix)
        gradient = self._gradient.copy()
        reduced = Reduced(problem.layout.envelope, self._room, gradient)
        removed = Removed(out, stays, points, lost)
        room = point_room(problem.layout.width, max(problem.layout.width, problem.layout.envelope.lens))
        remove_images(design, self._values, reduced, removed, kept, left, room)
        before = [whole[points] for whole in kept[1:]]
        try:
            for whole, part in zip(kept[1:], left[1:], strict=True):
                whole[points] = part
            design = design._replace(weight=np.where(stays[:, None], design.weight, 0.0))
            nothing = np.zeros(0, dtype=np.int64)
            touched = np.zeros(problem.layout.size, dtype=np.bool_)
            touched[design.image_column[design.ray_image[affected[point]]]] = True
            yield design, Normal(self._room, gradient, 0.0, nothing, kept), bool(left.singular.any()), touched
        finally:
            for whole, part in zip(kept[1:], before, strict=True):
                whole[points] = part


def _touched(rows: Equations, columns: Flags) -> Flags:
    """Which observations have an unknown among some columns."""
    row = np.repeat(np.arange(len(rows.weight)), np.diff(rows.start))
    return np.asarray(np.bincount(row, columns[rows.column], len(rows.weight)) > 0)


def _untouched(rows: Equations, columns: Flags) -> Equations:
    """Observations without those of unknowns that are left out."""
    return rows._replace(weight=np.where(_touched(rows, columns), 0.0, rows.weight))

"""The normal equations of an adjusted network, factorised: what single columns of the covariance need."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from photocal.adjustment.datum import Correction, correction, full_solution, wholly_open, with_datum
from photocal.adjustment.envelope import border_inverse, factorise, selected_inverse, solve
from photocal.adjustment.equations import Equations
from photocal.adjustment.network import Network
from photocal.adjustment.normal import Normal, Problem, normal_equations, other_equations, prepare
from photocal.adjustment.rank import explain_singular
from photocal.adjustment.solver import Minimum
from photocal.adjustment.state import State
from photocal.base.arrays import Floats, Integers

# Elements of all cameras' columns of the inverse, to which they are found together.
ALL_COLUMNS = 200_000_000


@dataclass(frozen=True)
class Factored:
    """Normal equations at the adjusted state.

    normal: its matrix is the Cholesky factor.
    datum: of a free network: what leads to inner constraints.
    """

    problem: Problem
    state: State
    normal: Normal
    datum: Correction | None

    @cached_property
    def others(self) -> dict[str, Equations]:
        """Observations beside the rays and the points, by group."""
        return other_equations(self.problem, self.state)

    @cached_property
    def inverse(self) -> Floats:
        """Selected inverse of the reduced system."""
        return selected_inverse(self.problem.layout.envelope, self.normal.matrix)

    @property
    def inverse_of_shared(self) -> Floats:
        """The same for cameras and what is common: of the border alone where they all stand there."""
        layout = self.problem.layout
        if layout.with_image.any():
            return self.inverse
        return border_inverse(layout.envelope, self.normal.matrix)

    def joint(self, columns: Integers) -> Floats:
        """Covariance of some unknowns with each other, (k, k), also of images that share no point."""
        layout = self.problem.layout
        if (columns >= layout.envelope.band).all():
            corner = layout.envelope.panels(border_inverse(layout.envelope, self.normal.matrix))[-1]
            border = columns - layout.envelope.band
            return np.asarray(corner[np.ix_(border, border)])
        right = np.zeros((layout.size, len(columns)))
        right[columns, np.arange(len(columns))] = 1.0
        return solve(layout.envelope, self.normal.matrix, right)[columns]

    @cached_property
    def _of_cameras(self) -> tuple[Floats, Floats]:
        """Columns of the inverse of all cameras' parameters: (k, size), (k, points, 3)."""
        _, _, columns = self.problem.layout.camera_parameters
        return self._inverse_columns(columns)

    def _inverse_columns(self, columns: Integers) -> tuple[Floats, Floats]:
        right = np.zeros((len(columns), self.problem.layout.size))
        right[np.arange(len(columns)), columns] = 1.0
        points = np.zeros((len(columns), *self.state.points.shape))
        return full_solution(self.problem, self.normal, right, points)

    def camera_column(self, column: int) -> tuple[Floats, Floats]:
        """Column of the inverse that belongs to a camera's parameter, in the datum of the equations."""
        layout = self.problem.layout
        _, _, columns = layout.camera_parameters
        # Of thousands of cameras no memory holds all of them at once.
        alone = len(columns) * (layout.size + self.state.points.size) > ALL_COLUMNS
        steps, moved = self._inverse_columns(np.array([column])) if alone else self._of_cameras
        k = 0 if alone else int(np.flatnonzero(columns == column)[0])
        return steps[k], moved[k]


def factored(network: Network, state: State) -> Factored:
    """Set up and factorise the normal equations at an adjusted state.

    raises IllPosedError: when they are singular.
    """
    problem = with_datum(prepare(network), state)
    return factorised(problem, Minimum(state, normal_equations(problem, state), ()))


def factorised(problem: Problem, minimum: Minimum) -> Factored:
    """Factorise the normal equations of a minimum in their place.

    raises IllPosedError: when they are singular.
    """
    state = minimum.state
    normal = minimum.normal or normal_equations(problem, state, room=minimum.room)
    # Only a network part of whose datum is open needs both, the matrix and its factor.
    partly = len(problem.stiffened) and not wholly_open(problem)
    bare = replace(normal, matrix=normal.matrix.copy()) if partly else normal
    if not minimum.factored and factorise(problem.layout.envelope, normal.matrix) >= 0:
        explain_singular(problem, state)
    datum = correction(problem, normal, bare, state) if len(problem.stiffened) else None
    return Factored(problem, state, normal, datum)


def covariance_column(at: Factored, reduced: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Covariance of all unknowns with a linear function of them, or with several along the first axis."""
    return _in_datum(at, reduced, points, *full_solution(at.problem, at.normal, reduced, points))


def camera_covariance_column(at: Factored, column: int) -> tuple[Floats, Floats]:
    """Covariance of all unknowns with a camera's parameter."""
    reduced = np.zeros(at.problem.layout.size)
    reduced[column] = 1.0
    return _in_datum(at, reduced, np.zeros_like(at.state.points), *at.camera_column(column))


def camera_covariance_columns(at: Factored, columns: Integers) -> tuple[Floats, Floats]:
    """Covariances of all unknowns with parameters of cameras: (k, size) and of points (k, points, 3)."""
    each = [camera_covariance_column(at, int(column)) for column in columns]
    steps, moved = zip(*each, strict=True)
    return np.array(steps), np.array(moved)


def _in_datum(
    at: Factored, reduced: Floats, points: Floats, step: Floats, moved: Floats
) -> tuple[Floats, Floats]:
    """Give a solution of the normal equations the inner constraints of a free network."""
    if at.datum is None:
        return step, moved
    datum = at.datum
    # Columns of S Q S' with S = I - A (G'A)^-1 G' (Baarda 1973).
    along = (reduced @ datum.moves + np.einsum("nak,...na->...k", datum.point_moves, points)) @ datum.inverse
    on_datum = reduced @ datum.spread + np.einsum("nak,...na->...k", datum.point_spread, points)
    back = (on_datum - along @ datum.cofactor) @ datum.inverse.T
    step = step - along @ datum.spread.T - back @ datum.moves.T
    for places, share in ((datum.point_spread, along), (datum.point_moves, back)):
        moved = moved - np.einsum("nak,...k->...na", places, share)
    return step, moved

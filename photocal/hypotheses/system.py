"""One small system of equations for everything that may be wrong: what images share, and what may be added.

Images and points are eliminated once, at the minimum of the given network, with all values free that a
hypothesis may free. What is left tells in closed form what an adjustment becomes when some of them are freed
or errors of rays, positions and control points are added (Rao 1948): fall of v'Pv, estimates, covariances.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.condensed import Condensed, Observed, condensed, observed
from photocal.adjustment.covariance import Shared
from photocal.adjustment.datum import full_solution
from photocal.adjustment.envelope import solve
from photocal.adjustment.factored import Factored
from photocal.adjustment.score import pulled
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.geometry.camera import Camera


@dataclass(frozen=True)
class Added:
    """Unknowns beside those of a network, by what a unit of each changes.

    rays (t, rays, 2): of the computed image coordinates.
    positions (p, 3 positions): of the computed antenna positions, whitened.
    control (k, 2): a point and an axis whose given coordinate is wrong.
    """

    rays: Floats
    positions: Floats
    control: Integers

    @property
    def count(self) -> int:
        """How many they are; rays first, then positions, then control."""
        return len(self.rays) + len(self.positions) + len(self.control)


@dataclass(frozen=True)
class Beyond:
    """Equations of unknowns that may be added, all else eliminated.

    matrix (e, e), right (e,): as of `System`.
    chi_squared, degrees_of_freedom: without them.
    """

    matrix: Floats
    right: Floats
    chi_squared: float
    degrees_of_freedom: int

    def freed(self, added: Sequence[int]) -> tuple[float, int]:
        """Give v'Pv and degrees of freedom with some of them.

        raises IllPosedError: when they cannot be separated.
        """
        at = list(added)
        fall = float(self.right[at] @ _solved(self.matrix[np.ix_(at, at)], self.right[at]))
        return self.chi_squared - fall, self.degrees_of_freedom - len(at)

    def moved(self, added: Sequence[int], amounts: Sequence[float]) -> "Beyond":
        """Give the same beside known amounts of some of them."""
        at, by = list(added), np.array(amounts)
        pull = self.matrix[:, at] @ by
        chi_squared = self.chi_squared + float(by @ pull[at] - 2.0 * by @ self.right[at])
        return replace(self, right=self.right - pull, chi_squared=chi_squared)


@dataclass(frozen=True)
class System:
    """The equations of what images share (`shared`), and of what is added behind it.

    matrix (k + e, k + e), right (k + e,): of steps from the state; zero is the state.
    lengths (e,): of what each added unknown changes, weighted and squared, whatever follows.
    there: what the values of what is shared bring to them, as everything that may be freed is free.
    """

    shared: Condensed
    matrix: Floats
    right: Floats
    lengths: Floats
    there: Observed

    @property
    def border(self) -> int:
        """Where what is added begins."""
        return len(self.shared.right)

    def equations(
        self, here: Observed, added: Sequence[int] | Integers
    ) -> tuple[Floats, Floats, Integers, float, int]:
        """Equations with what other values of what is shared bring, and some of what is added.

        returns: matrix and right side of the unknowns, their places, v'Pv and degrees of freedom with all
            unknowns at the state.
        """
        there = self.there
        shared = np.flatnonzero(here.unknown)
        extra = self.border + np.asarray(added, dtype=np.int64)
        chosen, own = np.concatenate([shared, extra]), slice(0, len(shared))
        matrix, right = self.matrix[chosen[:, None], chosen], self.right[chosen]
        matrix[own, own] += (here.weight - there.weight)[shared[:, None], shared]
        right[own] += (there.pull - here.pull)[shared]
        return (
            matrix,
            right,
            chosen,
            self.shared.chi_squared - there.chi_squared + here.chi_squared,
            self.shared.degrees_of_freedom + here.redundancy - there.redundancy - len(extra),
        )

    def beyond(self, here: Observed, added: Sequence[int] | Integers) -> Beyond:
        """Equations of what may be added when all that is shared, and some of what is added, is eliminated.

        raises IllPosedError: when the equations of these are singular.
        """
        matrix, right, chosen, chi_squared, freedom = self.equations(here, added)
        across = self.matrix[chosen, self.border :]
        follow = _solved(matrix, np.column_stack([across, right]))
        step = follow[:, -1]
        return Beyond(
            self.matrix[self.border :, self.border :] - across.T @ follow[:, :-1],
            self.right[self.border :] - across.T @ step,
            chi_squared - float(right @ step),
            freedom,
        )

    def solved(self, here: Observed, added: Sequence[int] | Integers = ()) -> tuple[Shared, Floats, Floats]:
        """Give the minimum: what is shared, and what was added with its covariance.

        raises IllPosedError: when the equations are singular.
        """
        matrix, right, chosen, chi_squared, freedom = self.equations(here, added)
        covariance = _solved(matrix, np.eye(len(matrix)))
        step = np.zeros(len(self.right))
        spread = np.zeros_like(self.matrix)
        step[chosen] = covariance @ right
        spread[np.ix_(chosen, chosen)] = covariance
        chi_squared -= float(right @ step[chosen])
        border = self.border
        extra = border + np.asarray(added, dtype=np.int64)
        of_shared = self.shared.stepped(step[:border], spread[:border, :border], chi_squared, freedom)
        return of_shared, step[extra], spread[np.ix_(extra, extra)]


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solve small equations; raises IllPosedError when they are singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise IllPosedError("the observations do not determine what is common to all images") from None


def system(at: Factored, residuals: Floats, added: Added) -> System:
    """Set up the equations at the minimum of a network, everything that may be freed being free in `at`.

    residuals (rays, 2): there, computed minus measured.
    """
    whole = condensed(at)
    there = observed(whole, whole.cameras, whole.mounting)
    if not added.count:
        return System(whole, whole.matrix, whole.right, np.zeros(0), there)
    band = at.problem.layout.envelope.band
    steps, own, slope, lengths = _further(at, residuals, added)
    follow = steps[:, band:]
    across = whole.matrix @ follow.T
    corner = own + follow @ across
    matrix = np.block([[whole.matrix, across], [across.T, (corner + corner.T) / 2]])
    return System(whole, matrix, np.concatenate([whole.right, -slope]), lengths, there)


def _further(at: Factored, residuals: Floats, added: Added) -> tuple[Floats, Floats, Floats, Floats]:
    """How the reduced system follows a unit of what is added; its normal equations, all else eliminated.

    returns: also slopes of v'Pv, and the diagonal of these equations before the elimination.
    """
    problem, state = at.problem, at.state
    layout, points = problem.layout, problem.network.points
    t, p, k = len(added.rays), len(added.positions), len(added.control)
    none = np.zeros((0, *state.points.shape))
    weight = problem.design.weight
    flat = added.rays.reshape(t, -1)
    reduced_r, points_r = pulled(at, added.rays) if t else (np.zeros((0, layout.size)), none)
    steps_r, moved_r = full_solution(problem, at.normal, reduced_r, points_r) if t else (reduced_r, none)
    # Points that stay in the reduced system stand in both parts.
    points_r[:, layout.kept_points] = 0.0
    reduced_p, slope_p = _of_positions(at, added.positions)
    steps_p = (
        np.ascontiguousarray(solve(layout.envelope, at.normal.matrix, reduced_p.T).T) if p else reduced_p
    )
    point, axis = added.control.T
    rows = points.weight[point, axis]
    steps_c, moved_c = _of_control(at, point, rows)
    own = np.zeros((t + p + k, t + p + k))
    ray, position, control = slice(0, t), slice(t, t + p), slice(t + p, t + p + k)
    whole, slope_r = _gathered(flat, weight.ravel(), residuals.ravel())
    own[ray, ray] = whole - reduced_r @ steps_r.T
    own[ray, ray] -= points_r.reshape(t, -1) @ moved_r.reshape(t, -1).T
    own[position, position] = added.positions @ added.positions.T - reduced_p @ steps_p.T
    own[position, ray] = -reduced_p @ steps_r.T
    own[ray, position] = own[position, ray].T
    # What a control point gives is its weight times how the point follows.
    own[control, ray] = -np.einsum("ka,rka->kr", rows, moved_r[:, point])
    own[ray, control] = own[control, ray].T
    own[position, control] = -reduced_p @ steps_c.T
    own[control, position] = own[position, control].T
    same = (point[:, None] == point[None, :]) * rows[:, axis]
    own[control, control] = same - np.einsum("ka,ika->ki", rows, moved_c)
    off = (state.points - points.values)[point]
    slope = np.concatenate([slope_r, slope_p, np.einsum("ka,ka->k", rows, off)])
    lengths = [np.diag(whole), np.sum(added.positions**2, axis=1), rows[np.arange(k), axis]]
    return np.vstack([steps_r, steps_p, steps_c]), (own + own.T) / 2, slope, np.concatenate(lengths)


def _gathered(fields: Floats, weight: Floats, residuals: Floats) -> tuple[Floats, Floats]:
    """Normal equations (t, t) of fields of the image coordinates, and their slopes (t,)."""
    # Of all coordinates at once the weighted fields are as large as the fields themselves.
    most = 1 << 19
    matrix, slope = np.zeros((len(fields), len(fields))), np.zeros(len(fields))
    for first in range(0, fields.shape[1], most):
        some = slice(first, first + most)
        weighted = fields[:, some] * weight[some]
        matrix += weighted @ fields[:, some].T
        slope += weighted @ residuals[some]
    return matrix, slope


def _of_positions(at: Factored, fields: Floats) -> tuple[Floats, Floats]:
    """Right-hand sides of the reduced system for fields of the whitened positions, and slopes of v'Pv."""
    right = np.zeros((at.problem.layout.size, len(fields)))
    if not len(fields):
        return right.T, np.zeros(0)
    rows = at.others["position"]
    pulls = rows.coefficient[:, None] * np.repeat(
        rows.weight[:, None] * fields.T, np.diff(rows.start), axis=0
    )
    np.add.at(right, rows.column, pulls)
    right[at.problem.held] = 0.0
    return right.T, fields @ (rows.weight * rows.residual)


def _of_control(at: Factored, point: Integers, rows: Floats) -> tuple[Floats, Floats]:
    """How all unknowns follow errors of control: reduced part (k, size), these points (k, k, 3).

    Of all points only these few have a part in it: they are eliminated by themselves.
    """
    layout, design, kept = at.problem.layout, at.problem.design, at.normal.kept
    border = layout.envelope.band + np.arange(layout.envelope.lens)
    reduced, touched = np.zeros((len(point), layout.size)), {}
    for j in np.unique(point):
        own, of_point = slice(design.ray_start[j], design.ray_start[j + 1]), np.flatnonzero(point == j)
        images = design.image_column[design.ray_image[own], None] + np.arange(layout.width)
        mixed = np.hstack([np.moveaxis(kept.mixed[own], 1, 0).reshape(3, -1), kept.mixed_border[j]])
        columns, stays = np.concatenate([images.ravel(), border]), design.point_column[j]
        touched[j] = of_point, columns, mixed, layout.envelope.band + stays + np.arange(3 * (stays >= 0))
        np.subtract.at(reduced, (of_point[:, None], columns), rows[of_point] @ kept.inverse[j] @ mixed)
        if stays >= 0:
            reduced[of_point[:, None], touched[j][-1]] += rows[of_point]
    reduced[:, at.problem.held] = 0.0
    steps = np.ascontiguousarray(solve(layout.envelope, at.normal.matrix, reduced.T).T)
    moved = np.zeros((len(point), len(point), 3))
    for j, (of_point, columns, mixed, stays) in touched.items():
        pull = np.where((point == j)[:, None], rows, 0.0) - steps[:, columns] @ mixed.T
        moved[:, of_point] = (steps[:, stays] if len(stays) else pull @ kept.inverse[j])[:, None]
    return steps, moved


def loosened(camera: Camera, parameters: dict[int, float]) -> Camera:
    """A camera with parameters as unknowns, weakly observed as they are given."""
    estimated, sigma = camera.estimated.copy(), camera.prior_sigma.copy()
    for k, prior in parameters.items():
        estimated[k], sigma[k] = True, prior
    return replace(camera, estimated=estimated, prior_sigma=sigma)

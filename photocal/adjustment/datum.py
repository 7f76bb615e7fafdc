"""The datum of a free network: minimum constraints to solve, inner constraints to report.

A network whose observations leave position, orientation or scale open is solved with as many columns
held lightly as it has defects: any such choice gives the same residuals and the same shape. The result
is then moved onto the start values, and the covariance transformed, so that the chosen points move least
(inner constraints, Blaha 1971; S-transformation, Baarda 1973).
"""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from scipy.linalg import qr
from scipy.spatial.transform import Rotation

from photocal.adjustment.envelope import multiply, solve
from photocal.adjustment.kernels.substitution import back_substitute, reduce_right
from photocal.adjustment.network import Network
from photocal.adjustment.normal import (
    Normal,
    Problem,
    diagonal_addresses,
    normal_equations,
    placing_equations,
)
from photocal.adjustment.state import State
from photocal.base.arrays import Floats, Integers

# Elements of a datum.
SIMILARITY = 7
# Steps of the whole block: so many at most, by differences over so many sigmas, as if each were resisted by
# this much at least, until no more than this is gained, or this share of what is worth a step.
NEWTON, SMALL, FLATTEST, CONVERGED, LITTLE = 10, 0.01, 1e-6, 1e-14, 0.01


@dataclass(frozen=True)
class Correction:
    """What turns the covariance of a minimally constrained solution into that of inner constraints.

    moves, spread (layout.size, d): for the reduced system: null vectors A, and Q G, G their part at the datum
        points.
    point_moves, point_spread (points, 3, d): the same for the points.
    inverse (d, d): (G'A)^-1.
    cofactor (d, d): G'QG.
    """

    moves: Floats
    spread: Floats
    point_moves: Floats
    point_spread: Floats
    inverse: Floats
    cofactor: Floats

    def applied(self, covariance: Floats, moves: Floats, spread: Floats) -> Floats:
        """Transform covariance blocks, shape (n, m, m), with their rows of A and Q G, shape (n, m, d)."""
        a = moves @ self.inverse
        mixed = a @ np.swapaxes(spread, 1, 2)
        of_datum = a @ self.cofactor @ np.swapaxes(a, 1, 2)
        return np.asarray(covariance - mixed - np.swapaxes(mixed, 1, 2) + of_datum)


def similarity_moves(problem: Problem, state: State, about: Floats | None = None) -> tuple[Floats, Floats]:
    """Changes of all unknowns under small similarity transformations of the object space.

    about (3,): the place that does not move; the middle of the centres where it is not given.
    """
    middle = state.centre.mean(axis=0) if about is None else about
    points = _displacements(state.points - middle)
    points[problem.network.points.held] = 0.0
    return _reduced_moves(problem, state, middle), points


def _reduced_moves(problem: Problem, state: State, about: Floats | None = None) -> Floats:
    """Those of the unknowns that stay in the reduced system; `about` as in `similarity_moves`."""
    middle = state.centre.mean(axis=0) if about is None else about
    columns, layout = problem.layout.image_columns, problem.layout
    kept = _displacements(state.points[layout.kept_points] - middle)
    kept[problem.network.points.held[layout.kept_points]] = 0.0
    reduced = np.zeros((layout.size, 7))
    reduced[columns[:, 3:]] = _displacements(state.centre - middle)
    # The object space turns by e, so the camera axes turn by -M e.
    reduced[columns[:, :3], 3:6] = -state.rotation
    reduced[layout.point_columns] = kept
    reduced[problem.held] = 0.0
    return reduced


def _displacements(relative: Floats) -> Floats:
    """Displacement of places, shape (n, 3), per unit of each of the seven transformations, (n, 3, 7)."""
    moves = np.zeros((len(relative), 3, 7))
    moves[:, :, :3] = np.eye(3)
    # Of a turn about each axis: its cross product with the place.
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        moves[:, b, 3 + a] = -relative[:, c]
        moves[:, c, 3 + a] = relative[:, b]
    moves[:, :, 6] = relative
    return moves


def open_combinations(problem: Problem, normal: Normal, moves: Floats) -> Floats:
    """Combinations of the seven transformations that no observation sees, shape (7, d)."""
    return open_of(*resisted(problem, normal, moves))


def resisted(problem: Problem, normal: Normal, moves: Floats) -> tuple[Floats, Floats]:
    """How the unknowns resist the seven transformations each alone, (7,), and all together, (7, 7)."""
    form = moves.T @ multiply(problem.layout.envelope, normal.matrix, moves)
    return _resistance(problem, normal) @ moves**2, form


def open_of(alone: Floats, form: Floats) -> Floats:
    """Combinations that no observation sees, (7, d), from what `resisted` gives."""
    # Share of its own diagonal that a similarity transformation may change v'Pv by and still be free.
    open_share = 1e-9
    length = np.sqrt(alone)
    movable = length > 0
    length[~movable] = 1.0
    form = form / np.outer(length, length)
    # What nothing can move is not open.
    form[~movable, ~movable] += 1.0
    eigenvalues, vectors = np.linalg.eigh((form + form.T) / 2)
    return np.asarray(vectors[:, eigenvalues < open_share] / length[:, None])


def _resistance(problem: Problem, normal: Normal) -> Floats:
    """What resists each unknown of the reduced system.

    Of an image at its own points, or with all of them along one ray, only rounding is left, of either sign.
    """
    return np.maximum(normal.matrix[diagonal_addresses(problem)], 0.0)


def with_datum(problem: Problem, state: State) -> Problem:
    """Hold lightly as many columns as a free network has defects."""
    if problem.network.datum_points is None:
        return problem
    moves = _reduced_moves(problem, state)
    if _rays_alone(problem.network):
        resistance = _resistance_of_rays(problem, state)
        if np.isfinite(resistance).all():
            return replace(problem, stiffened=datum_columns(moves, resistance))
    normal = normal_equations(problem, state)
    if not np.isfinite(normal.matrix).all():
        # Of points in a camera's own plane nothing can be judged: the solver says which.
        return problem
    null = moves @ open_combinations(problem, normal, moves)
    if not null.shape[1]:
        return problem
    return replace(problem, stiffened=datum_columns(null, _resistance(problem, normal)))


def _rays_alone(network: Network) -> bool:
    """Whether nothing but rays was observed: all seven transformations are open then.

    A lens that varies with the distance, or a known motion, sees the scale.
    """
    others = [network.relations.kind, network.positions.image, network.attitudes.image]
    others += [network.lasers.image, network.rig.first]
    exposures, points = network.exposures, network.points
    free = np.isinf(exposures.sigma).all() and not points.held.any() and not points.weight.any()
    scaled = exposures.motion is not None or any(camera.focus_m for camera in network.cameras)
    return bool(free) and not scaled and not any(map(len, others))


def _resistance_of_rays(problem: Problem, state: State) -> Floats:
    """About what resists each unknown of the reduced system where the points do not follow."""
    rays, exposures, layout = problem.network.rays, problem.network.exposures, problem.layout
    away = state.points[rays.point] - state.centre[rays.image]
    deep = -np.einsum("ni,ni->n", state.rotation[rays.image, 2], away)
    weight = (state.cameras[exposures.camera, 0][rays.image] / rays.sigma[:, 0]) ** 2
    count = len(exposures.camera)
    result = np.zeros(layout.size)
    result[layout.image_columns[:, :3]] = np.bincount(rays.image, weight, count)[:, None]
    with np.errstate(divide="ignore"):
        result[layout.image_columns[:, 3:]] = np.bincount(rays.image, weight / deep**2, count)[:, None]
    return result


def datum_columns(null: Floats, resistance: Floats) -> Integers:
    """Columns that carry a datum best: as many as combinations that no observation sees, (size, d)."""
    _, _, order = qr((null * np.sqrt(np.maximum(resistance, 0.0))[:, None]).T, mode="economic", pivoting=True)
    return np.asarray(np.sort(order[: null.shape[1]]).astype(np.int64))


def inner_state(problem: Problem, normal: Normal | None, state: State, start: State) -> State:
    """Move a free network by a similarity so that its datum points come closest to their start values.

    normal: may be None where all of the datum is open.
    """
    named = problem.network.datum_points
    chosen = slice(None) if named is None or not len(named) else named
    open_ones = _open_ones(problem, normal, _reduced_moves(problem, state))
    for _ in range(50):
        _, points = similarity_moves(problem, state)
        datum_moves = (points[chosen] @ open_ones).reshape(-1, open_ones.shape[1])
        away = (start.points - state.points)[chosen].ravel()
        # So well determined are they that squares lose nothing that a step more would not bring back.
        size = np.linalg.norm(datum_moves, axis=0)
        square = (datum_moves.T @ datum_moves) / np.outer(size, size)
        change = np.linalg.lstsq(square, datum_moves.T @ away / size, rcond=None)[0] / size
        state = transformed(state, open_ones @ change)
        if np.abs(datum_moves @ change).max() < 1e-12 * np.ptp(state.points):
            break
    return state


def wholly_open(problem: Problem) -> bool:
    """Whether the whole datum is open, so that nobody need ask the normal equations which part is."""
    return len(problem.stiffened) == SIMILARITY


def _open_ones(problem: Problem, normal: Normal | None, moves: Floats) -> Floats:
    """Open combinations, without the stiffening that would close them."""
    if wholly_open(problem) or normal is None:
        return np.diag(1.0 / np.linalg.norm(moves, axis=0))
    diagonal = diagonal_addresses(problem)[problem.stiffened]
    bare = normal.matrix.copy()
    bare[diagonal] /= 2.0
    return open_combinations(problem, replace(normal, matrix=bare), moves)


def at_rest(problem: Problem, state: State, worth: float) -> State | None:
    """Move the block as a whole, which no ray resists, to where all other observations have least v'Pv.

    Where positions are off by much of the block's own width v'Pv is curved by more than normal equations
    know: Newton's steps go by its second derivatives to the seven transformations.

    worth: gain of v'Pv from which on it is done.
    returns: None where less is to be gained, or everything is held.
    """
    network = problem.network
    if (network.exposures.sigma == 0).any() or network.points.held.any() or len(problem.stiffened):
        return None
    # Nobody asks for points without observations of their own before the block comes to rest.
    asked = problem.layout.kept_points, network.relations.kind, network.lasers.image
    weighted, changes = np.flatnonzero(problem.design.prior_weight.any(axis=(1, 2))), list[Floats]()
    whole = state
    if not any(map(len, (weighted, *asked))):
        state = replace(state, points=state.points[:0])
    chi_squared, slope, curvature = _others_moved(problem, state, weighted)
    size = np.sqrt(np.diagonal(curvature))
    unit = np.divide(1.0, size, out=np.zeros(7), where=size > 0.0)
    if _newton(curvature, slope, unit)[1] < worth:
        return None
    for _ in range(NEWTON):
        # An unknown of its own for each transformation that something resists, of a sigma each.
        steps = [np.where(np.arange(7) == k, SMALL * unit, 0.0) for k in range(7)]
        ahead = [_others_moved(problem, transformed(state, step), weighted)[1] for step in steps]
        curved = np.divide(
            np.array(ahead) - slope, SMALL * unit[:, None], where=unit[:, None] > 0.0, out=np.zeros((7, 7))
        )
        change, gain = _newton((curved + curved.T) / 2, slope, unit)
        while gain > CONVERGED:
            moved = transformed(state, change)
            lower, *there = _others_moved(problem, moved, weighted)
            if lower < chi_squared:
                break
            change, gain = change / 4, gain / 4
        else:
            break
        changes.append(change)
        state, chi_squared, slope, curvature = moved, lower, *there
        # The next step of the whole adjustment goes on from here.
        if _newton(curvature, slope, unit)[1] < LITTLE * worth:
            break
    return reduce(transformed, changes, whole)


def _newton(curvature: Floats, slope: Floats, unit: Floats) -> tuple[Floats, float]:
    """Step down a slope, also where the ground is curved downwards, and what it would gain."""
    values, vectors = np.linalg.eigh(unit[:, None] * curvature * unit)
    along = vectors.T @ (unit * slope)
    step = -along / np.maximum(np.abs(values), FLATTEST)
    return unit * (vectors @ step), float(-along @ step)


def _others_moved(problem: Problem, state: State, weighted: Integers) -> tuple[float, Floats, Floats]:
    """Give v'Pv of all but the rays, with its slope and curvature under small similarity transformations.

    weighted: points with observations of their own.
    """
    design, reduced = problem.design, _reduced_moves(problem, state)
    points = _displacements(state.points[weighted] - state.centre.mean(axis=0))
    off, weight = state.points[weighted] - design.prior_points[weighted], design.prior_weight[weighted]
    pull = np.einsum("nab,nb->na", weight, off)
    chi_squared, slope = float(np.sum(off * pull)), np.einsum("nak,na->k", points, pull)
    curvature = np.einsum("nak,nab,nbl->kl", points, weight, points)
    for rows in placing_equations(problem, state).values():
        moved = reduced[rows.column]
        if moved.any():
            moves = np.add.reduceat(rows.coefficient[:, None] * moved, rows.start[:-1])
            chi_squared += rows.chi_squared()
            slope += moves.T @ (rows.weight * rows.residual)
            curvature += moves.T @ (rows.weight[:, None] * moves)
    return chi_squared, slope, curvature


def transformed(state: State, change: Floats, about: Floats | None = None) -> State:
    """Apply a similarity: translation, rotation vector and scale, about a place, see `similarity_moves`."""
    middle = state.centre.mean(axis=0) if about is None else about
    turn = Rotation.from_rotvec(change[3:6]).as_matrix()
    matrix, shift = (1.0 + change[6]) * turn, middle + change[:3]
    return replace(
        state,
        rotation=state.rotation @ turn.T,
        centre=(state.centre - middle) @ matrix.T + shift,
        points=(state.points - middle) @ matrix.T + shift,
    )


def _datum_points(network: Network) -> Integers:
    chosen = network.datum_points
    return np.arange(len(network.points.values)) if chosen is None or not len(chosen) else chosen


def correction(problem: Problem, normal: Normal, bare_normal: Normal, state: State) -> Correction:
    """What the S-transformation to inner constraints needs."""
    reduced, points = similarity_moves(problem, state)
    open_ones = _open_ones(problem, bare_normal, reduced)
    reduced, points = reduced @ open_ones, points @ open_ones
    chosen, count = _datum_points(problem.network), open_ones.shape[1]
    right = np.zeros_like(points)
    right[chosen] = points[chosen]
    of_kept = np.zeros_like(reduced.T)
    of_kept[:, problem.layout.point_columns] = np.moveaxis(right[problem.layout.kept_points], 2, 0)
    steps, moved = full_solution(problem, normal, of_kept, np.moveaxis(right, 2, 0))
    spread, point_spread = steps.T, np.moveaxis(moved, 0, 2)
    # Columns of held unknowns and unknowns that are kept stand in both parts; G counts each point once.
    constraint, cofactor = (
        np.reshape(right, (-1, count)).T @ np.reshape(side, (-1, count)) for side in (points, point_spread)
    )
    inverse = np.asarray(np.linalg.inv(constraint), dtype=np.float64)
    return Correction(reduced, spread, points, point_spread, inverse, cofactor)


def full_solution(
    problem: Problem, normal: Normal, reduced_right: Floats, point_right: Floats
) -> tuple[Floats, Floats]:
    """Solve the full normal equations for one right-hand side, or for several along the first axis."""
    layout, design, envelope = problem.layout, problem.design, problem.layout.envelope
    right = np.ascontiguousarray(point_right).reshape(-1, len(design.point_free), 3)
    reduced = np.array(reduced_right).reshape(len(right), -1)
    if right.any():
        taken = np.zeros((len(design.pieces) - 1, *reduced.shape))
        reduce_right(design, envelope, right, normal.kept, taken)
        reduced += taken.sum(axis=0)
    reduced[:, problem.held] = 0.0
    steps = np.ascontiguousarray(solve(envelope, normal.matrix, reduced.T).T)
    points = np.zeros_like(right)
    back_substitute(design, envelope, steps, normal.kept, -right, points)
    points[:, layout.kept_points] = steps[:, layout.point_columns]
    return steps.reshape(np.shape(reduced_right)), points.reshape(np.shape(point_right))

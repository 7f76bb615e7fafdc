"""Covariance of everything and redundancy numbers, from the selected inverse of the reduced system."""

from dataclasses import dataclass

import numpy as np

from photocal.adjustment.equations import Equations
from photocal.adjustment.factored import Factored
from photocal.adjustment.kernels.data import Cofactors, Structure
from photocal.adjustment.kernels.ray import element_address
from photocal.adjustment.kernels.statistics import statistics
from photocal.adjustment.network import own_parameters
from photocal.adjustment.normal import Problem, values_of
from photocal.adjustment.rank import require_cameras, require_determined
from photocal.adjustment.solution import Group, PhotoVariant, Solution
from photocal.adjustment.solver import Iteration
from photocal.adjustment.state import State, lenses, turn_basis
from photocal.base.arrays import Floats, Integers
from photocal.base.compiled import compiled
from photocal.geometry.camera import OWN, PARAMETERS
from photocal.geometry.rotation import angles_from_matrix, turn_per_angle


def complete(at: Factored, iterations: tuple[Iteration, ...]) -> Solution:
    """Give the minimum its statistics."""
    problem, state, normal = at.problem, at.state, at.normal
    network, structure = problem.network, problem.layout.envelope
    inverse = at.inverse
    point_covariance = np.zeros((len(state.points), 3, 3))
    residuals, redundancy = np.zeros((2, *network.rays.plane.shape))
    values = values_of(problem, state)
    cofactors = Cofactors(structure, inverse, normal.kept)
    statistics(problem.design, values, cofactors, point_covariance, residuals, redundancy)
    of_rays = float(np.einsum("ra,ra,ra->", problem.design.weight, residuals, residuals))
    rays = Group("image", residuals.size, of_rays, float(redundancy.sum()))
    groups = [rays, _control_group(problem, state.points, point_covariance)]
    laser_residuals, laser_redundancy = np.zeros((2, len(network.lasers.image)))
    for name, equations in at.others.items():
        # Observations of the reduced system's unknowns.
        variance = equation_covariance(equations, structure, inverse, 1)[:, 0, 0]
        checked = len(variance) - float(np.sum(equations.weight * variance))
        groups.append(Group(name, len(variance), equations.chi_squared(), checked))
        if name == "laser":
            laser_residuals, laser_redundancy = equations.residual, 1.0 - equations.weight * variance
    observations = sum(group.observations for group in groups)
    camera_covariance = _camera_covariance(problem, inverse)
    image_covariance = blocks(problem.layout.image_columns, structure, inverse)
    datum, columns = at.datum, problem.layout.image_columns
    if datum is not None:
        image_covariance = datum.applied(image_covariance, datum.moves[columns], datum.spread[columns])
        point_covariance = datum.applied(point_covariance, datum.point_moves, datum.point_spread)
    require_determined(problem, state, point_covariance, camera_covariance)
    angles = angles_from_matrix(state.rotation)
    return Solution(
        iterations,
        normal.chi_squared,
        observations,
        _unknowns(problem),
        len(problem.stiffened),
        tuple(group for group in groups if group.observations),
        state.cameras,
        camera_covariance,
        np.hstack([angles, state.centre]),
        _exposure_covariance(problem, state, image_covariance, angles),
        state.points,
        point_covariance,
        residuals,
        redundancy,
        _common_covariance(problem, inverse),
        _photo_variant(problem, state, inverse),
        state,
        laser_residuals,
        laser_redundancy,
    )


@dataclass(frozen=True)
class Shared:
    """What all images share at a minimum: cameras, mounting and heads of rigs, with their covariances.

    cameras, camera_covariance, common, common_covariance: as in `Solution` and `State`.
    """

    chi_squared: float
    degrees_of_freedom: int
    cameras: Floats
    camera_covariance: Floats
    common: Floats
    common_covariance: Floats


def shared(at: Factored) -> Shared:
    """Give what all images share, and cameras of single ones, its covariances: nothing else gets statistics.

    raises IllPosedError: when a principal distance is not determined.
    """
    problem, state = at.problem, at.state
    inverse = at.inverse_of_shared
    cameras = _camera_covariance(problem, inverse)
    require_cameras(problem, state, cameras)
    return Shared(
        at.normal.chi_squared,
        degrees_of_freedom(at),
        state.cameras,
        cameras,
        state.common,
        _common_covariance(problem, inverse),
    )


def degrees_of_freedom(at: Factored) -> int:
    """Count observations and conditions of the datum, less unknowns."""
    network = at.problem.network
    control = int(np.sum(network.points.observed))
    others = sum(len(rows.weight) for rows in at.others.values())
    return network.rays.plane.size + control + others + len(at.problem.stiffened) - _unknowns(at.problem)


def _unknowns(problem: Problem) -> int:
    eliminated = problem.design.point_column < 0
    return int(np.sum(~problem.held) + np.sum(~problem.network.points.held[eliminated]))


def _control_group(problem: Problem, points: Floats, covariance: Floats) -> Group:
    """Coordinates of points as observations."""
    given = problem.network.points
    known = given.known
    weight, deviation = given.weight[known], points[known] - given.values[known]
    count = int(np.sum(given.observed))
    chi_squared = float(np.einsum("na,nab,nb->", deviation, weight, deviation))
    return Group(
        "control", count, chi_squared, count - float(np.einsum("nab,nba->", weight, covariance[known]))
    )


def equation_covariance(equations: Equations, structure: Structure, inverse: Floats, together: int) -> Floats:
    """Covariance of adjusted observations a x, of so many that follow each other, shape (n, t, t)."""
    result = np.zeros((len(equations.weight) // together, together, together))
    add_covariance(equations.start, equations.column, equations.coefficient, structure, inverse, result)
    return result


@compiled
def add_covariance(
    start: Integers,
    column: Integers,
    coefficient: Floats,
    structure: Structure,
    inverse: Floats,
    result: Floats,
) -> None:
    """Add a Q a' of the selected inverse for every two rows of each group."""
    together = result.shape[1]
    for group in range(len(result)):
        for i in range(together):
            for j in range(together):
                row, other = together * group + i, together * group + j
                for a in range(start[row], start[row + 1]):
                    for b in range(start[other], start[other + 1]):
                        high, low = max(column[a], column[b]), min(column[a], column[b])
                        q = inverse[element_address(structure, high, low)]
                        result[group, i, j] += coefficient[a] * q * coefficient[b]


@compiled
def copy_blocks(columns: Integers, structure: Structure, inverse: Floats, result: Floats) -> None:
    """Copy diagonal blocks of the selected inverse."""
    for k in range(columns.shape[0]):
        for a in range(columns.shape[1]):
            for b in range(columns.shape[1]):
                high, low = max(columns[k, a], columns[k, b]), min(columns[k, a], columns[k, b])
                result[k, a, b] = inverse[element_address(structure, high, low)]


def blocks(columns: Integers, structure: Structure, inverse: Floats) -> Floats:
    """Diagonal blocks of the selected inverse, shape (n, m, m), for columns of shape (n, m)."""
    result = np.empty((*columns.shape, columns.shape[1]))
    copy_blocks(columns, structure, inverse, result)
    return result


def _camera_covariance(problem: Problem, inverse: Floats) -> Floats:
    covariance = np.zeros((len(problem.network.cameras), len(PARAMETERS), len(PARAMETERS)))
    counts = np.array([len(active) for active, _ in problem.layout.camera_columns], dtype=np.int64)
    # Cameras with as many parameters at once: one by one thousands would take seconds.
    for count in np.unique(counts[counts > 0]):
        cameras = np.flatnonzero(counts == count)
        active, columns = (
            np.array(each) for each in zip(*(problem.layout.camera_columns[k] for k in cameras), strict=True)
        )
        found = blocks(columns, problem.layout.envelope, inverse)
        covariance[cameras[:, None, None], active[:, :, None], active[:, None, :]] = found
    return covariance


def _common_covariance(problem: Problem, inverse: Floats) -> Floats:
    columns = problem.layout.common_columns
    unknown = np.flatnonzero(columns >= 0)
    covariance = np.zeros((len(columns), len(columns)))
    if len(unknown):
        covariance[np.ix_(unknown, unknown)] = blocks(
            columns[unknown][None], problem.layout.envelope, inverse
        )[0]
    return covariance


def _photo_variant(problem: Problem, state: State, inverse: Floats) -> PhotoVariant:
    """Values of the images' own parameters: that of the camera or the given movement, and the deviation."""
    network, parameters = problem.network, own_parameters(problem.network)
    image, place = np.nonzero(parameters >= 0)
    camera, parameter = network.exposures.camera[image], parameters[image, place]
    column = problem.layout.own_columns[image, place]
    deviation = blocks(column[:, None], problem.layout.envelope, inverse)[:, 0, 0]
    common = np.full((len(network.cameras), len(OWN)), -1)
    for k, (active, columns) in enumerate(problem.layout.camera_columns):
        common[k, active] = columns
    shared = common[camera, parameter]
    variance = deviation.copy()
    both = shared >= 0
    pairs = blocks(np.column_stack([column[both], shared[both]]), problem.layout.envelope, inverse)
    variance[both] = pairs.sum(axis=(1, 2))
    return PhotoVariant(
        image,
        parameter,
        lenses(network, state)[image, parameter] if len(image) else np.zeros(0),
        np.sqrt(variance),
        state.deviations[image, place],
        np.sqrt(deviation),
    )


def _exposure_covariance(problem: Problem, state: State, pose_covariance: Floats, angles: Floats) -> Floats:
    """Covariance of the angles and coordinates from that of the rotation unknowns and coordinates."""
    free = problem.network.exposures.sigma != 0
    pose_covariance = pose_covariance * free[:, :, None] * free[:, None, :]
    jacobian = np.broadcast_to(np.eye(6), pose_covariance.shape).copy()
    jacobian[:, :3, :3] = np.linalg.solve(turn_per_angle(angles), turn_basis(problem.network, state))
    covariance = jacobian @ pose_covariance @ np.swapaxes(jacobian, 1, 2)
    # Rounding leaves traces where the transformation crosses a held angle.
    return np.asarray(covariance * free[:, :, None] * free[:, None, :])

"""Normal equations whose points are eliminated as they pass, against those of the whole design matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment import normal
from photocal.adjustment.kernels.data import Structure
from photocal.adjustment.kernels.ray import element_address
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.kernels.substitution import back_substitute, reduce_right
from photocal.adjustment.network import Network
from photocal.adjustment.normal import Problem, prepare, values_of
from photocal.adjustment.sensitivity import along
from photocal.adjustment.state import State, start_state
from photocal.base.arrays import Flags, Floats
from photocal.geometry.camera import PARAMETERS
from tests.photocal import networks

ALL = ("c", "x0", "y0", "K1", "K2", "P1", "P2", "B1", "B2")
INF = np.inf


def whole(problem: Problem, state: State) -> tuple[Floats, Floats, float]:
    """Normal equations of rays and weighted points, with all points behind the reduced unknowns; v'Pv."""
    design, size, points = problem.design, problem.layout.size, len(state.points)
    values, structure = values_of(problem, state), problem.layout.envelope
    directions = np.eye(size + 3 * points)
    change = np.zeros((len(directions), *design.plane.shape))
    of_points = directions[:, size:].reshape(-1, points, 3)
    along(design, values, structure, directions[:, :size].copy(), of_points.copy(), change)
    rows = change.reshape(len(directions), -1)
    residuals, depth = np.zeros_like(design.plane), np.zeros(len(design.plane))
    evaluate(design, values, residuals, depth)
    weighted = rows * design.weight.ravel()
    matrix, gradient = weighted @ rows.T, weighted @ residuals.ravel()
    total = float(np.sum(design.weight * residuals**2))
    for j in range(points):
        own = slice(size + 3 * j, size + 3 * j + 3)
        off, free = state.points[j] - design.prior_points[j], design.point_free[j]
        matrix[own, own] += design.prior_weight[j] * np.outer(free, free) + np.diag(1.0 - free)
        gradient[own] += design.prior_weight[j] @ off * free
        total += float(off @ design.prior_weight[j] @ off)
    return matrix, gradient, total


def eliminated(
    problem: Problem, damping: float, matrix: Floats, right: Floats, lost: Flags
) -> tuple[Floats, Floats]:
    """Eliminate the points one by one; those that stay move to their columns."""
    size, matrix, right = problem.layout.size, matrix.copy(), right.copy()
    kept = dict(zip(problem.layout.kept_points.tolist(), problem.layout.point_columns, strict=True))
    for j in range(len(lost)):
        own = np.arange(size + 3 * j, size + 3 * j + 3)
        if j in kept:
            matrix[kept[j]] += matrix[own]
            matrix[:, kept[j]] += matrix[:, own]
            right[kept[j]] += right[own]
        elif not lost[j]:
            block = matrix[np.ix_(own, own)] + damping * np.diag(np.diag(matrix)[own])
            less = matrix[:size, own] @ np.linalg.inv(block)
            matrix[:size, :size] -= less @ matrix[own, :size]
            right[:size] -= less @ right[own]
    return matrix[:size, :size], right[:size]


def dense(structure: Structure, values: Floats) -> Floats:
    """Lower triangle of a matrix of this structure; zero where it has no element."""
    result = np.zeros((structure.size, structure.size))
    for column in range(structure.size):
        inside = column < structure.band
        last = structure.last[column // structure.panel] if inside else structure.band
        rows = [*range(column, last), *range(max(column, structure.band), structure.size)]
        for row in rows:
            result[row, column] = values[element_address(structure, row, column)]
    return result


def of_two_cameras() -> Network:
    """Points that are known in all, in some and in no coordinates, and one that a single ray sees."""
    cameras = networks.lens("a", estimate=ALL), networks.lens("b", "brown-ideal", estimate=("c", "x0", "K1"))
    sigma = np.full((16, 3), INF)
    sigma[:4], sigma[4], sigma[5], sigma[6] = 0.003, [0.0, 0.002, INF], [INF, INF, 0.001], 0.0
    scene, rng = networks.convergent(cameras, images=6, points=16), np.random.default_rng(7)
    network = networks.observe(scene, rng, point_sigma=sigma, missing=0.2)
    rays = network.rays
    first = np.append(True, np.diff(rays.point) > 0)
    return replace(network, rays=rays.rows(first | (rays.point != 9)))


def with_kept_points() -> Network:
    scene, rng = networks.convergent(images=5, points=14), np.random.default_rng(12)
    sigma = np.full((14, 3), INF)
    sigma[:4], sigma[0], sigma[1, 2] = 0.01, 0.0, 0.0
    network = networks.observe(scene, rng, point_sigma=sigma)
    return networks.related(network, scene, rng, [0, 1, 2, 0], np.full(4, 0.001))


def with_parameters_of_images() -> Network:
    cameras = (
        networks.lens("a", photo_variant={"c": 0.05, "x0": 0.02, "K1": 1e-6, "B1": 1e-4}),
        networks.lens("b", "brown-ideal", estimate=("c", "x0", "K1"), c=24.0),
    )
    scene = networks.convergent(cameras, images=6, points=16)
    return networks.observe(scene, np.random.default_rng(15), point_sigma=np.full((16, 3), 0.003))


def moving() -> Network:
    """Images that move, and shake, while they are read."""
    own = replace(networks.lens(estimate=(*ALL, "readout")), readout_direction="top-to-bottom")
    network = networks.observe(networks.convergent((own,), images=5, points=18), np.random.default_rng(21))
    values = network.cameras[0].values.copy()
    values[PARAMETERS.index("readout")] = 0.01
    own = replace(network.cameras[0].with_values(values), shake=(1e-4, 5e-5, 5e-5, 3e-5, 1e-5, 5e-6))
    motion = np.random.default_rng(22).normal(0, 1, (5, 6))
    exposures = replace(network.exposures, motion=motion, motion_sigma=np.full((5, 6), 0.3))
    return replace(network, cameras=(own,), exposures=exposures)


@pytest.mark.parametrize("damping", [0.0, 0.1])
@pytest.mark.parametrize("rays", [10, 10_000], ids=["pieces", "one piece"])
@pytest.mark.parametrize("made", [of_two_cameras, with_kept_points, with_parameters_of_images, moving])
def test_points_are_eliminated(
    made: Callable[[], Network], rays: int, damping: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(normal, "RAYS_IN_PIECE", rays)
    network = made()
    problem, state = prepare(network), start_state(network)
    structure, size = problem.layout.envelope, problem.layout.size
    kept = normal.eliminated(problem, len(network.rays.image), len(state.points))
    found = np.zeros(int(structure.offset[-1]))
    gradient, total = normal.add_rays(
        problem, problem.design, values_of(problem, state), kept, found, damping=damping
    )
    matrix, right, expected_total = whole(problem, state)
    # Damping makes any block regular.
    lost = [9] if made is of_two_cameras and damping == 0.0 else []
    assert np.flatnonzero(kept.singular).tolist() == lost
    expected, expected_gradient = eliminated(problem, damping, matrix, right, kept.singular)
    scale = np.sqrt(np.maximum(np.diag(matrix)[:size], np.diag(expected)))
    scale[scale == 0.0] = 1.0
    assert total == pytest.approx(expected_total, rel=1e-12)
    assert (dense(structure, found) / np.outer(scale, scale)) == pytest.approx(
        np.tril(expected) / np.outer(scale, scale), abs=1e-11
    )
    assert gradient / scale == pytest.approx(
        expected_gradient / scale, abs=1e-11 * np.abs(right[:size] / scale).max()
    )
    # Another right-hand side, and the points' steps that belong to a step of the others.
    rng = np.random.default_rng(1)
    sides, steps = rng.normal(size=(2, *state.points.shape)), rng.normal(size=(2, size))
    reduced, moved = np.zeros((len(problem.design.pieces) - 1, 2, size)), np.zeros_like(sides)
    reduce_right(problem.design, structure, sides, kept, reduced)
    back_substitute(problem.design, structure, steps, kept, sides, moved)
    for j in range(len(state.points)):
        own = slice(size + 3 * j, size + 3 * j + 3)
        block = matrix[own, own] + damping * np.diag(np.diag(matrix)[own])
        stays = kept.singular[j] or j in problem.layout.kept_points
        inverse = np.zeros((3, 3)) if stays else np.linalg.inv(block)
        expected_step = -(sides[:, j] + steps @ matrix[:size, own]) @ inverse
        assert moved[:, j] == pytest.approx(expected_step, rel=1e-9, abs=1e-12 * np.abs(expected_step).max())
        reduced[0] += sides[:, j] @ inverse @ matrix[own, :size]
    assert reduced.sum(axis=0) / scale == pytest.approx(0.0, abs=1e-11)

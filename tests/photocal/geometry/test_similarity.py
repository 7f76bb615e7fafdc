"""Similarity between two systems of places."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from photocal.geometry.localisation import similarity


@given(st.integers(0, 2**32 - 1), st.integers(3, 12), st.floats(1e-3, 1e3))
def test_exact_places_give_the_transformation_back(seed: int, count: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    source = np.vstack([np.eye(3) * 2, rng.uniform(-5, 5, (count, 3))])
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-100, 100, 3)
    found = similarity(source, scale * source @ turn.T + shift)
    assert found is not None
    assert np.abs(found.rotation - turn).max() < 1e-9
    assert abs(found.scale / scale - 1) < 1e-9
    assert np.abs(found.applied(source) - (scale * source @ turn.T + shift)).max() < 1e-9 * (100 + scale)


def test_least_squares_against_scipy() -> None:
    rng = np.random.default_rng(1)
    source = rng.uniform(-3, 3, (9, 3))
    target = 1.7 * source @ Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix().T + rng.normal(0, 0.2, (9, 3))

    def miss(x: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(x[:3]).as_matrix()
        return np.asarray((x[3] * source @ turn.T + x[4:] - target).ravel())

    fit = least_squares(miss, np.array([0.3, -1.0, 0.5, 1.7, 0, 0, 0]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = similarity(source, target)
    assert found is not None
    assert np.abs((found.applied(source) - target).ravel() - fit.fun).max() < 1e-6


def test_rotations_follow_the_places() -> None:
    """Camera axes of a direction are the same before and after."""
    rng = np.random.default_rng(2)
    source, turn = rng.uniform(-3, 3, (4, 3)), Rotation.random(rng=rng).as_matrix()
    found = similarity(source, 2.0 * source @ turn.T)
    assert found is not None
    camera = Rotation.random(rng=rng).as_matrix()
    direction = source[1] - source[0]
    after = found.applied_to_rotations(camera) @ (found.applied(source[1]) - found.applied(source[0]))
    assert np.abs(after / found.scale - camera @ direction).max() < 1e-12


def test_two_places_or_a_line_are_not_enough() -> None:
    line = np.outer(np.arange(4.0), [1.0, 2.0, 3.0])
    assert similarity(line[:2], line[:2]) is None
    assert similarity(line, line) is None

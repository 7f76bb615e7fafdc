"""Rotations against SciPy, against printed matrices, and as exact inverses of each other."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.geometry.rotation import (
    angles_from_matrix,
    inverse_left_jacobian,
    left_jacobian,
    matrix_from_angles,
    turn_per_angle,
    turned,
)

PUBLISHED = Path(__file__).parents[2] / "reference" / "dcs460" / "eo_initial_ori.csv"
Floats = NDArray[np.float64]

angle = st.floats(-np.pi, np.pi)
triples = st.tuples(angle, angle, angle).map(np.array)
small = st.floats(-1e-3, 1e-3)


@given(triples)
def test_matrix_is_the_transpose_of_the_active_rotations(angles: Floats) -> None:
    # R3 R2 R1 with passive factors is the inverse of the active intrinsic rotations about X, Y, Z.
    expected = Rotation.from_euler("XYZ", angles).as_matrix().T
    assert matrix_from_angles(angles) == pytest.approx(expected, abs=1e-14)


def test_printed_matrices_of_resections() -> None:
    with PUBLISHED.open(encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    assert len(rows) == 11
    for row in rows:
        angles = np.array([float(row[f"{name}_rad"]) for name in ("omega", "phi", "kappa")])
        printed = np.array([[float(row[f"m{i}{j}"]) for j in (1, 2, 3)] for i in (1, 2, 3)])
        # The angles are printed to ten decimals.
        assert matrix_from_angles(angles) == pytest.approx(printed, abs=5e-11)


def test_printed_angles_follow_from_printed_matrices() -> None:
    with PUBLISHED.open(encoding="utf-8", newline="") as text:
        for row in csv.DictReader(text):
            printed = np.array([[float(row[f"m{i}{j}"]) for j in (1, 2, 3)] for i in (1, 2, 3)])
            angles = [float(row[f"{name}_rad"]) for name in ("omega", "phi", "kappa")]
            error = angles_from_matrix(printed) - angles
            assert (error + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0, abs=2e-10)


@given(triples)
def test_angles_give_back_the_same_matrix(angles: Floats) -> None:
    matrix = matrix_from_angles(angles)
    again = angles_from_matrix(matrix)
    assert abs(again[1]) <= np.pi / 2
    assert matrix_from_angles(again) == pytest.approx(matrix, abs=1e-7)
    if abs(np.cos(angles[1])) > 1e-3:
        assert matrix_from_angles(again) == pytest.approx(matrix, abs=1e-12)


@pytest.mark.parametrize("phi", [np.pi / 2, -np.pi / 2])
def test_angles_at_the_lock_describe_the_same_rotation(phi: float) -> None:
    matrix = matrix_from_angles(np.array([0.4, phi, -1.1]))
    angles = angles_from_matrix(matrix)
    assert angles[1] == pytest.approx(phi, abs=1e-7)
    assert matrix_from_angles(angles) == pytest.approx(matrix, abs=1e-9)


@given(triples, st.tuples(small, small, small).map(np.array))
def test_turning_is_the_exponential_of_the_turn(angles: Floats, turn: Floats) -> None:
    matrix = matrix_from_angles(angles)
    expected = Rotation.from_rotvec(turn).as_matrix() @ matrix
    assert turned(matrix[None], turn[None])[0] == pytest.approx(expected, abs=1e-14)


def test_large_turns_stay_rotations() -> None:
    rng = np.random.default_rng(4)
    matrix = matrix_from_angles(rng.uniform(-3, 3, (200, 3)))
    turn = rng.uniform(-3, 3, (200, 3))
    expected = Rotation.from_rotvec(turn).as_matrix() @ matrix
    assert turned(matrix, turn) == pytest.approx(expected, abs=1e-13)
    for _ in range(1000):
        matrix = turned(matrix, turn)
    assert matrix @ np.swapaxes(matrix, 1, 2) == pytest.approx(
        np.broadcast_to(np.eye(3), matrix.shape), abs=1e-14
    )


@given(triples.filter(lambda a: abs(np.cos(a[1])) > 0.02), st.integers(0, 2))
def test_turn_per_angle_is_the_derivative(angles: Floats, which: int) -> None:
    step = np.zeros(3)
    step[which] = 1e-6
    change = matrix_from_angles(angles + step) @ matrix_from_angles(angles - step).T
    numerical = Rotation.from_matrix(change).as_rotvec() / 2e-6
    assert turn_per_angle(angles)[:, which] == pytest.approx(numerical, abs=1e-8)


@given(triples, st.sampled_from([0.0, 1e-12, 1e-7, 1e-5, 1e-3, 1.0]))
def test_left_jacobian_and_its_inverse(direction: Floats, size: float) -> None:
    turn = size * direction
    # Barfoot and Furgale (2014), eq. 98: the mean of the rotations by a part of the turn, by quadrature.
    place, weight = np.polynomial.legendre.leggauss(24)
    parts = Rotation.from_rotvec(np.outer((place + 1.0) / 2.0, turn)).as_matrix()
    jacobian = np.tensordot(weight / 2.0, parts, axes=1)
    assert left_jacobian(turn) == pytest.approx(jacobian, abs=1e-13)
    assert inverse_left_jacobian(turn) @ jacobian == pytest.approx(np.eye(3), abs=1e-12)

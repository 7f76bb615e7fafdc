from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.analysis.accuracy.statistics import circular_error, counted_error, linear_error


def test_linear_error_is_1_6449_times_the_rmse() -> None:
    assert linear_error(1.0, 0.90) == pytest.approx(1.6449, abs=5e-5)


def test_circular_error_of_a_circle_is_2_1460_sigma() -> None:
    # Greenwalt and Shultz 1962; closed form sqrt(-2 ln 0.1).
    assert circular_error(np.eye(2), 0.90) == pytest.approx(2.1460, abs=5e-5)
    assert circular_error(4.0 * np.eye(2), 0.90) == pytest.approx(
        2.0 * math.sqrt(-2.0 * math.log(0.1)), rel=1e-9
    )


def test_circular_error_of_a_line_is_the_linear_error() -> None:
    assert circular_error(np.diag([1.0, 0.0]), 0.90) == pytest.approx(1.6449, abs=5e-5)


def test_no_error_has_no_radius() -> None:
    assert circular_error(np.zeros((2, 2)), 0.90) == 0.0


@pytest.mark.parametrize("ratio", [0.9, 0.5, 0.2, 0.05, 0.011])
def test_circle_holds_its_share_of_simulated_errors(ratio: float) -> None:
    generator = np.random.default_rng(7)
    turn = np.array([[math.cos(0.6), -math.sin(0.6)], [math.sin(0.6), math.cos(0.6)]])
    moments = turn @ np.diag([1.0, ratio**2]) @ turn.T
    errors = generator.multivariate_normal([0.0, 0.0], moments, 200_000)
    held = np.mean(np.hypot(*errors.T) <= circular_error(moments, 0.90))
    # Three standard deviations of a share of 0.9 in 200 000 trials.
    assert abs(held - 0.90) < 3.0 * math.sqrt(0.09 / 200_000)


@given(st.floats(0.001, 100.0), st.floats(0.0, 1.0))
def test_circular_error_lies_between_line_and_circle(sigma: float, ratio: float) -> None:
    found = circular_error(np.diag([sigma**2, (ratio * sigma) ** 2]), 0.90)
    assert linear_error(sigma, 0.90) * (1 - 1e-4) <= found <= 2.14597 * sigma * (1 + 1e-6)


def test_counted_error_is_the_27th_of_30() -> None:
    lengths = np.random.default_rng(1).permutation(np.arange(1.0, 31.0))
    assert counted_error(lengths, 0.90) == 27.0
    assert counted_error(np.array([3.0]), 0.90) == 3.0
    assert counted_error(np.array([1.0, 2.0]), 0.90) == 2.0

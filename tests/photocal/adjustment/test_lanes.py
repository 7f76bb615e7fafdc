"""Eight numbers at once are what they are one by one, with vectors of any length."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from photocal.adjustment.kernels.lanes import LANES, load, none, padded, plus, plus_each, store, summed
from photocal.base.arrays import Floats
from photocal.base.compiled import compiled

FACTORS, NUMBERS = np.linspace(0.3, 2.9, 5), np.arange(5.0 * LANES).reshape(5, LANES) / 7.0


@compiled
def combine(factors: Floats, numbers: Floats, combined: Floats) -> float:
    """Combine rows of eight; returns the sum of squares of what they make."""
    total = none()
    for k in range(len(factors)):
        total = plus(total, factors[k], load(numbers, LANES * k))
    store(combined, 1, total)
    return float(summed(plus_each(none(), total, total)))


def combination() -> tuple[list[float], float]:
    """What the compiled function makes of the numbers."""
    combined = np.zeros(LANES + 2)
    squares = combine(FACTORS, NUMBERS, combined)
    return combined.tolist(), squares


def check(combined: list[float], squares: float) -> None:
    """Compare with sums of products one by one; beside their place nothing is written."""
    expected = FACTORS @ NUMBERS
    assert combined == pytest.approx([0.0, *expected, 0.0], rel=1e-14)
    assert squares == pytest.approx(np.sum(expected**2), rel=1e-14)


def test_on_this_processor() -> None:
    check(*combination())


def test_on_a_processor_without_long_vectors() -> None:
    there = "from tests.photocal.adjustment import test_lanes as there"
    told = f"import json; {there}; print(json.dumps(there.combination()))"
    made = subprocess.run(
        [sys.executable, "-c", told],
        env=os.environ | {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    check(*json.loads(made.stdout))


@pytest.mark.parametrize(("count", "whole"), [(0, 0), (1, 8), (8, 8), (9, 16), (47, 48)])
def test_whole_lanes(count: int, whole: int) -> None:
    assert padded(count) == whole

"""Combined positions must lie between the directions that they were made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.navigation.engine import EngineSolution
from photocal.navigation.ppk import between_directions
from photocal.navigation.time import GpsTime

METRE_N = 1 / 110_850


def solution(north_m: list[float], quality: list[int], sigma_m: float) -> EngineSolution:
    n = len(north_m)
    one = np.ones(n)
    time = GpsTime.from_week(np.full(n, 2370), np.arange(float(n)))
    covariance = np.tile(np.eye(3) * sigma_m**2, (n, 1, 1))
    return EngineSolution(
        time, -25.4 + np.array(north_m) * METRE_N, -49.2 * one, 900.0 * one, np.array(quality),
        covariance, 9 * one, np.full((n, 3), np.nan),
    )  # fmt: skip


def test_only_what_lies_apart_is_replaced() -> None:
    forward = solution([0.0, 0.010, 0.0, 0.0], [1, 1, 2, 1], 0.01)
    backward = solution([0.004, 0.002, 1.0, 3.0], [1, 1, 2, 2], 0.02)
    # A good mean, a broken one, a float mean, and a fix of one direction alone.
    combined = solution([0.002, 0.230, 0.4, 0.0], [1, 1, 2, 1], 0.0001)
    found, replaced = between_directions(combined, forward, backward)
    assert replaced.tolist() == [False, True, False, False]
    # Weights 4 to 1 of the variances.
    assert (found.lat_deg[1] + 25.4) / METRE_N == pytest.approx(0.0084, abs=2e-4)
    assert np.sqrt(found.covariance_m2[1, 0, 0]) == pytest.approx(0.02)
    assert np.array_equal(found.lat_deg[[0, 2, 3]], combined.lat_deg[[0, 2, 3]])
    assert found.quality.tolist() == [1, 1, 2, 1]


def test_a_direction_that_is_missing_decides_nothing() -> None:
    forward = solution([0.0, 0.0], [1, 1], 0.01)
    backward = replace(forward, time=GpsTime.from_week([2370, 2370], [50.0, 51.0]))
    combined = solution([5.0, 5.0], [1, 1], 0.01)
    assert not between_directions(combined, forward, backward)[1].any()

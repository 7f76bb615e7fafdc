"""Several calibrations of one camera: variance between flights, trends, and what one more flight has."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from photocal.analysis.stability.repeatability import Occasion, between_flights, repeatability
from photocal.geometry.camera import Camera, camera


def calibrated(c: float, sigma: float) -> Camera:
    own = camera("a", "brown-ideal", "mm", (4000, 3000), (0.004, 0.004), {"c": c}, estimate=("c",))
    sigmas = np.where(own.estimated, sigma, 0.0)
    return replace(own, sigma=sigmas, correlation=np.eye(len(sigmas)))


def occasions(values: np.ndarray, sigma: float, warm: np.ndarray | None = None) -> list[Occasion]:
    day = dt.date(2026, 1, 1)
    return [
        (
            calibrated(c, sigma),
            day + dt.timedelta(days=10 * i) if warm is None else day,
            None if warm is None else float(warm[i]),
        )
        for i, c in enumerate(values)
    ]


def test_variance_between_flights_of_equal_precision_is_what_is_left_of_the_scatter() -> None:
    x = np.array([8.801, 8.806, 8.799, 8.811, 8.795])
    (found,) = repeatability(occasions(x, 0.002))
    between = x.var(ddof=1) - 0.002**2
    assert found.between == pytest.approx(math.sqrt(between), rel=1e-6)
    assert found.mean == pytest.approx(x.mean())
    assert found.sigma == pytest.approx(x.std(ddof=1) / math.sqrt(5))
    assert found.future == pytest.approx(math.sqrt(between + x.var(ddof=1) / 5))
    assert found.factor == pytest.approx(stats.t.ppf(0.975, 4))
    assert found.p_value == pytest.approx(stats.chi2.sf(4 * x.var(ddof=1) / 0.002**2, 4))


def test_calibrations_that_agree_better_than_their_sigmas_have_no_variance_between_them() -> None:
    (found,) = repeatability(occasions(np.array([8.8, 8.801, 8.799]), 0.01))
    assert found.between == 0.0
    assert found.sigma == pytest.approx(0.01 / math.sqrt(3))


def test_a_trend_with_temperature_is_that_of_a_straight_line() -> None:
    warm = np.array([5.0, 12.0, 20.0, 27.0, 33.0])
    x = 8.8 + 4e-4 * (warm - 20.0) + np.array([1.0, -1.5, 0.5, 1.0, -1.0]) * 1e-3
    (found,) = repeatability(occasions(x, 1e-5, warm))
    (trend,) = found.trends
    line = stats.linregress(warm, x)
    assert trend.against == "temperature"
    assert trend.slope == pytest.approx(line.slope, rel=1e-3)
    assert trend.sigma == pytest.approx(line.stderr, rel=1e-3)
    assert trend.p_value == pytest.approx(line.pvalue, rel=1e-2)
    assert trend.left < found.between / 2


def test_a_future_flight_lies_within_what_is_predicted() -> None:
    rng = np.random.default_rng(1)
    inside, count = 0, 400
    for _ in range(count):
        sigma = rng.uniform(0.5e-3, 2e-3, 7)
        x = 8.8 + rng.normal(0.0, 3e-3, 7) + rng.normal(0.0, sigma)
        flights = [(calibrated(float(c), float(s)), None, None) for c, s in zip(x, sigma, strict=True)]
        (found,) = repeatability(flights)
        inside += abs(8.8 + rng.normal(0.0, 3e-3) - found.mean) < found.factor * found.future
    assert stats.binomtest(inside, count, 0.95).pvalue > 0.001


def test_fewer_than_three_flights_tell_nothing() -> None:
    assert repeatability(occasions(np.array([8.8, 8.9]), 0.01)) == ()
    assert between_flights(np.array([1.0]), np.array([1.0]), np.ones((1, 1))) == 0.0

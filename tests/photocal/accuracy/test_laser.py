"""Laser distances over a canopy: a wrong surface is found, a right one is left alone, gaps are counted."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.accuracy.discrepancies import (
    LASER_M,
    LASER_SHARE,
    LaserCheck,
    check_laser,
    laser_finding,
)
from photocal.findings.texts import catalogue, finding_text, plain

Floats = NDArray[np.float64]


def canopy(x: Floats, y: Floats) -> Floats:
    """Crowns of some 6 m, up to 3 m high, on a slope; 18 m above the ground."""
    crowns = 1.5 * np.sin(x / 3.1 + np.sin(y / 7.0)) * np.cos(y / 3.7)
    return np.asarray(18.0 + 0.05 * x + crowns)


def flown(seed: int, bias_m: float = 0.0, scale: float = 0.0, gaps: float = 0.15) -> LaserCheck:
    """64 shots at 80 to 100 m; the surface lies `bias_m` too high, and by `scale` of the distance more."""
    rng = np.random.default_rng(seed)
    ties = rng.uniform(-60, 60, (9000, 2))
    surface = np.column_stack([ties, canopy(*ties.T) + rng.normal(0, 0.12, len(ties))])
    n = 64
    station = np.column_stack([rng.uniform(-45, 45, (n, 2)), rng.uniform(80, 100, n)])
    if scale:
        station[:, 2] += rng.uniform(0, 60, n)
    tilt = rng.normal(0, np.radians(2.0), (n, 2))
    direction = np.column_stack([np.sin(tilt), -np.ones(n)])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    distance = np.full(n, 70.0)
    for _ in range(30):
        hit = station + distance[:, None] * direction
        distance = (station[:, 2] - canopy(*hit[:, :2].T)) / -direction[:, 2]
    distance += (rng.random(n) < gaps) * rng.uniform(4, 15, n)
    measured = (
        distance + rng.normal(0, 0.05, n) + rng.normal(0, LASER_M) + distance * rng.normal(0, LASER_SHARE)
    )
    surface[:, 2] += bias_m
    told = measured * (1 + scale)
    check = check_laser(station + told[:, None] * direction, told, surface)
    assert check is not None
    return check


@pytest.mark.parametrize("seed", range(20))
def test_no_false_alarm_over_a_right_canopy(seed: int) -> None:
    check = flown(seed)
    assert not check.biased
    assert check.sigma_m < 0.2
    # Some 10 of 64 see the ground through gaps.
    assert 2 <= check.elsewhere <= 20


@pytest.mark.parametrize("bias_m", [0.5, -0.5])
def test_half_a_metre_is_found(bias_m: float) -> None:
    checks = [flown(seed, bias_m) for seed in range(20)]
    assert sum(check.biased for check in checks) >= 18
    assert np.mean([check.bias_m for check in checks]) == pytest.approx(bias_m, abs=0.06)
    # What is stated of the bias is what it scatters by.
    share = [(check.bias_m - bias_m) / check.sigma_m for check in checks]
    assert 0.4 < np.std(share) < 1.6
    text = finding_text(laser_finding(checks[0], 64), catalogue("en"), plain)
    assert "more than laser, surface and c explain" in text


def test_a_scale_shows_where_distances_differ() -> None:
    check = flown(3, scale=0.01)
    # A laser that reads 1 % too long puts its targets lower: the surface is above them, more with distance.
    assert check.scale == pytest.approx(0.01, abs=3 * check.scale_sigma)
    assert check.scale > 3 * check.scale_sigma
    clean = flown(3)
    assert abs(clean.scale) < 3 * clean.scale_sigma


def test_a_c_that_is_not_known_excuses_its_heights() -> None:
    """2 % of 70 m are 1.4 m."""
    rng = np.random.default_rng(2)
    ties = np.column_stack([rng.uniform(-50, 50, (4000, 2)), np.zeros(4000)])
    station = np.column_stack([rng.uniform(-40, 40, (30, 2)), np.full(30, 70.0)])
    distance = np.full(30, 71.0)
    known, unknown = (check_laser(station - [0.0, 0.0, 71.0], distance, ties, share) for share in (0.0, 0.02))
    assert known is not None
    assert unknown is not None
    assert known.bias_m == pytest.approx(1.0, abs=1e-6)
    assert (known.biased, unknown.biased) == (True, False)
    assert unknown.sigma_m == pytest.approx(1.4, abs=0.05)


def test_too_few_shots_say_nothing() -> None:
    none = np.zeros((0, 3))
    assert check_laser(none, np.zeros(0), np.zeros((100, 3))) is None
    found = laser_finding(None, 3)
    assert (found.severity, found.cause) == ("untested", "few-laser-shots")
    assert finding_text(found, catalogue("en"), plain).startswith("3 laser distances")

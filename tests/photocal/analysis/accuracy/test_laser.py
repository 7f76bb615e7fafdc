"""Laser distances over a canopy: a wrong surface is found, a right one is left alone, gaps are counted."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.analysis.accuracy.discrepancies import LASER_M, LASER_SHARE, check_laser
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text, plain

Floats = NDArray[np.float64]


def canopy(x: Floats, y: Floats) -> Floats:
    """Crowns of some 6 m, up to 3 m high, on a slope; 18 m above the ground."""
    crowns = 1.5 * np.sin(x / 3.1 + np.sin(y / 7.0)) * np.cos(y / 3.7)
    return np.asarray(18.0 + 0.05 * x + crowns)


def flown(seed: int, bias_m: float = 0.0, scale: float = 0.0, gaps: float = 0.15) -> Finding:
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
    found = check_laser(station + told[:, None] * direction, told, surface)
    assert found.severity != "untested"
    return found


@pytest.mark.parametrize("seed", range(20))
def test_no_false_alarm_over_a_right_canopy(seed: int) -> None:
    found = flown(seed)
    assert found.severity == "note"
    assert found.figures["sigma_m"] < 0.2
    # Some 10 of 64 see the ground through gaps.
    assert 2 <= found.figures["elsewhere"] <= 20


@pytest.mark.parametrize("bias_m", [0.5, -0.5])
def test_half_a_metre_is_found(bias_m: float) -> None:
    found = [flown(seed, bias_m) for seed in range(20)]
    assert sum(one.severity == "doubtful" for one in found) >= 18
    assert np.mean([one.figures["bias_m"] for one in found]) == pytest.approx(bias_m, abs=0.06)
    # What is stated of the bias is what it scatters by.
    share = [(one.figures["bias_m"] - bias_m) / one.figures["sigma_m"] for one in found]
    assert 0.4 < np.std(share) < 1.6
    text = finding_text(found[0], catalogue("en"), plain)
    assert "more than laser, surface and c explain" in text


def test_a_scale_shows_where_distances_differ() -> None:
    figures = flown(3, scale=0.01).figures
    # A laser that reads 1 % too long puts its targets lower: the surface is above them, more with distance.
    assert figures["scale"] == pytest.approx(0.01, abs=3 * figures["scale_sigma"])
    assert figures["scale"] > 3 * figures["scale_sigma"]
    clean = flown(3).figures
    assert abs(clean["scale"]) < 3 * clean["scale_sigma"]


def test_a_c_that_is_not_known_excuses_its_heights() -> None:
    """2 % of 70 m are 1.4 m."""
    rng = np.random.default_rng(2)
    ties = np.column_stack([rng.uniform(-50, 50, (4000, 2)), np.zeros(4000)])
    station = np.column_stack([rng.uniform(-40, 40, (30, 2)), np.full(30, 70.0)])
    distance = np.full(30, 71.0)
    known, unknown = (check_laser(station - [0.0, 0.0, 71.0], distance, ties, share) for share in (0.0, 0.02))
    assert known.figures["bias_m"] == pytest.approx(1.0, abs=1e-6)
    assert (known.severity, unknown.severity) == ("doubtful", "note")
    assert unknown.figures["sigma_m"] == pytest.approx(1.4, abs=0.05)


def test_too_few_shots_say_nothing() -> None:
    found = check_laser(np.zeros((3, 3)), np.full(3, 70.0), np.zeros((100, 3)))
    assert (found.severity, found.cause) == ("untested", "few-laser-shots")
    assert finding_text(found, catalogue("en"), plain).startswith("3 laser distances")

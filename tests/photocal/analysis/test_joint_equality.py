"""Two calibrations equal as parameter vectors: the level is kept, differences are found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.stability.camera_file import read_camera_file
from photocal.analysis.stability.compared import _together, joint_comparison, joint_text
from photocal.analysis.stability.methods import sensor_grid
from photocal.findings.texts import catalogue
from photocal.geometry.camera import PARAMETERS, Camera

STUDY = Path(__file__).parents[3] / "configs/studies/canon-elph/calibrations.toml"
SETS = read_camera_file(STUDY).calibrations
GRID = sensor_grid(SETS[0].size_px, 400.0)
NAMES = tuple(name for name in PARAMETERS if SETS[1].sigma_of(name) > 0.0)


def drawn(random: np.random.Generator, name: str) -> Camera:
    """Set 2 as another calibration of the same camera would find it."""
    camera = SETS[1]
    step = random.multivariate_normal(np.zeros(len(NAMES)), camera.covariance_of(NAMES), method="eigh")
    values = {n: camera.value(n) + float(by) for n, by in zip(NAMES, step, strict=True)}
    return replace(camera.changed(**values), id=name)


def test_calibrations_of_one_camera_are_refused_as_often_as_the_level_says() -> None:
    random = np.random.default_rng(11)
    draws = ((drawn(random, "a"), drawn(random, "b")) for _ in range(150))
    tests = [joint_comparison(pair, GRID).pairs["a", "b"] for pair in draws]
    for kind in ("vector", "image"):
        refused = sum(getattr(test, kind).p_value < 0.05 for test in tests)
        # Of 150 binomial cases with 5 %, 99.9 % lie within these.
        assert 1 <= refused <= 18, kind


def test_the_statistic_is_that_of_the_textbook() -> None:
    (pair,) = joint_comparison(SETS[1:3], GRID).pairs.values()
    a, b = SETS[1:3]
    d = np.array([b.value(name) - a.value(name) for name in NAMES])
    expected = d @ np.linalg.inv(a.covariance_of(NAMES) + b.covariance_of(NAMES)) @ d
    assert pair.parameters == NAMES
    assert pair.vector.chi_squared == pytest.approx(expected, rel=1e-6)
    assert pair.vector.degrees_of_freedom == 10


def test_sets_of_the_study_are_not_one_camera_but_for_the_first_two() -> None:
    """The study had no such test: sets 1 and 2 were taken the same day without moving the lens."""
    joint = joint_comparison(SETS, GRID)
    equal = {names for names, pair in joint.pairs.items() if pair.vector.p_value > 0.05}
    assert equal == {("1", "2")}
    assert joint.together is not None
    assert joint.together.vector.degrees_of_freedom == 60
    assert joint.together.vector.p_value < 1e-6
    assert joint.together.image is not None
    assert joint.together.image.p_value < 1e-6
    assert "all calibrations as one: chi2" in joint_text(joint, 0.05, catalogue("en"))


def test_many_flights_of_one_camera_are_refused_as_often_as_the_level_says() -> None:
    random, coarse = np.random.default_rng(12), GRID[::12]
    refused = {"vector": 0, "image": 0}
    for _ in range(50):
        together = joint_comparison([drawn(random, name) for name in "abcde"], coarse).together
        assert together is not None
        for kind in refused:
            refused[kind] += getattr(together, kind).p_value < 0.05
    # Of 50 binomial cases with 5 %, 99.95 % are no more than these.
    assert max(refused.values()) <= 9, refused
    # One whose c is 8 standard deviations off among five is found both ways.
    odd = SETS[1].changed(c=SETS[1].value("c") + 8.0 * SETS[1].sigma_of("c"))
    together = joint_comparison(
        [*(drawn(random, name) for name in "abcd"), replace(odd, id="e")], coarse
    ).together
    assert together is not None
    assert together.image is not None
    assert max(together.vector.p_value, together.image.p_value) < 1e-3


def test_of_two_it_is_the_test_of_the_pair() -> None:
    (pair,), both = joint_comparison(SETS[1:3], GRID).pairs.values(), _together(SETS[1:3], GRID)
    assert both is not None
    assert both.vector.chi_squared == pytest.approx(pair.vector.chi_squared, rel=1e-6)
    assert pair.image is not None
    assert both.image is not None
    assert both.image.degrees_of_freedom == pair.image.degrees_of_freedom
    assert both.image.chi_squared == pytest.approx(pair.image.chi_squared, rel=0.01)


def test_what_no_picture_shows_counts_as_vector_only() -> None:
    """K3 and K2 that change together within a hundredth of a pixel."""
    camera = SETS[1]
    sharp = replace(camera, sigma=np.where(camera.sigma > 0, camera.sigma * 1e-3, 0.0))  # type: ignore[operator]
    other = replace(sharp.changed(c=sharp.value("c") + 6.0 * sharp.sigma_of("c")), id="b")
    (pair,) = joint_comparison((sharp, other), GRID).pairs.values()
    assert pair.vector.p_value < 0.01
    assert pair.image is not None
    assert pair.image.degrees_of_freedom == 0

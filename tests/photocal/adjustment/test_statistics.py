"""Many small blocks with known truth: the intervals hold the truth as often as they promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.adjustment.solution import Solution
from photocal.base.chi_square import global_test
from photocal.geometry.camera import Camera
from tests.photocal import networks
from tests.photocal.networks import Scene

RUNS = 100


@pytest.fixture(scope="module")
def truth() -> Scene:
    own = networks.lens(
        estimate=("c", "x0", "y0", "K1", "K2", "P1", "P2"), prior_sigma={"c": 0.05, "P1": 5e-6}, K3=0.0
    )
    return networks.convergent((own,), images=5, points=16)


@pytest.fixture(scope="module")
def trials(truth: Scene) -> list[Solution]:
    points = np.full((16, 3), np.inf)
    points[:6] = 0.004
    points[6] = [0.0, 0.002, np.inf]
    exposures = np.full((5, 6), np.inf)
    exposures[1:3] = [0.003, 0.003, 0.003, 0.02, 0.02, 0.03]
    return [
        adjust(
            networks.observe(
                truth,
                np.random.default_rng(1000 + k),
                point_sigma=points,
                exposure_sigma=exposures,
                missing=0.1,
            )
        )
        for k in range(RUNS)
    ]


def covered(error: np.ndarray, sigma: np.ndarray) -> float:
    """Share of errors within 1.96 sigma, over all that are not held."""
    free = sigma > 0
    return float(np.mean(np.abs(error[free]) < 1.959964 * sigma[free]))


def diagonal(covariance: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))


def test_camera_intervals(truth: Scene, trials: list[Solution]) -> None:
    own: Camera = truth.cameras[0]
    error = np.array([s.cameras - own.values for s in trials])
    # B1, B2 are not estimated and start from zero: not part of the comparison.
    assert 0.93 <= covered(error, np.array([diagonal(s.camera_covariance) for s in trials])) <= 0.97


def test_exposure_intervals(truth: Scene, trials: list[Solution]) -> None:
    error = np.array([s.exposures - truth.exposures for s in trials])
    error[..., :3] = (error[..., :3] + np.pi) % (2 * np.pi) - np.pi
    assert 0.93 <= covered(error, np.array([diagonal(s.exposure_covariance) for s in trials])) <= 0.97


def test_point_intervals(truth: Scene, trials: list[Solution]) -> None:
    error = np.array([s.points - truth.points for s in trials])
    assert 0.93 <= covered(error, np.array([diagonal(s.point_covariance) for s in trials])) <= 0.97


def test_whole_point_covariances(truth: Scene, trials: list[Solution]) -> None:
    """Squared errors of the free points in units of their full covariance follow chi-squared(3)."""
    lengths = [
        e @ np.linalg.solve(q, e)
        for s in trials
        for e, q in zip(s.points[7:] - truth.points[7:], s.point_covariance[7:], strict=True)
    ]
    assert np.mean(np.array(lengths) < stats.chi2(3).ppf(0.95)) == pytest.approx(0.95, abs=0.02)


def test_the_sum_of_squares_has_its_distribution(trials: list[Solution]) -> None:
    freedom = {s.degrees_of_freedom for s in trials}
    assert len(freedom) == 1
    found = stats.kstest([s.chi_squared for s in trials], stats.chi2(freedom.pop()).cdf)
    assert found.pvalue > 0.01


def test_standardised_residuals_have_unit_variance(truth: Scene, trials: list[Solution]) -> None:
    w = np.concatenate([s.standardised(np.full(s.residuals.shape, 0.003)).ravel() for s in trials])
    assert np.nanstd(w) == pytest.approx(1.0, abs=0.02)
    assert np.nanmean(np.abs(w) < 1.959964) == pytest.approx(0.95, abs=0.01)


def test_intervals_of_the_mounting() -> None:
    """Lever arm, boresight, time offset and shift of the flight free, scale of the heights weighted."""
    own = networks.lens(model="brown-ideal", estimate=("c", "x0", "y0"))
    scene = networks.convergent((own,), images=9, points=14)
    true = np.array([0.3, -0.1, -0.4, 0.01, -0.02, 0.015, 0.02, 0.05, -0.03, 0.12, 0.02, *[0.0] * 6])
    sigma = np.array([np.inf] * 10 + [0.05] + [0.0] * 6)
    errors, sigmas = [], []
    for k in range(RUNS):
        rng = np.random.default_rng(5000 + k)
        solution = adjust(networks.navigated(networks.observe(scene, rng), scene, rng, true, sigma))
        errors.append(solution.state.common - true)
        sigmas.append(np.sqrt(np.diag(solution.common_covariance)))
    assert (np.array(sigmas)[:, :11] > 0).all()
    assert 0.93 <= covered(np.array(errors), np.array(sigmas)) <= 0.97


def test_global_test_of_a_published_study() -> None:
    # DCS460: 887.6 with 842 degrees of freedom, 95 % interval 763.5 to 924.3, upper tail 0.13.
    test = global_test(887.6, 842)
    assert test is not None
    assert test.lower == pytest.approx(763.5, abs=0.05)
    assert test.upper == pytest.approx(924.3, abs=0.05)
    assert test.accepted
    assert test.p_value / 2 == pytest.approx(0.13, abs=0.005)


def test_no_global_test_without_redundancy() -> None:
    assert global_test(0.0, 0) is None

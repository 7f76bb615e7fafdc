"""Second opinions on standard deviations, against the true errors of simulated flights."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.analysis.robust import apart, bootstrap, sandwich
from tests.photocal.analysis.aerial import Flight, correlated, fly

FLIGHT = Flight(24, 1500, sigma_px=0.5)


def flown(seed: int, size_px: float) -> tuple[AdjustedNetwork, np.ndarray]:
    """A flight whose images have smooth errors of their own, adjusted, and the errors of its camera."""
    truth = fly(FLIGHT, seed)
    found = fit(correlated(truth.network, size_px, np.random.default_rng(seed)))
    return found, (found.state.cameras - truth.lens.values)[0]


def test_sandwich_covers_where_rays_of_an_image_are_not_independent() -> None:
    formal, robust = [], []
    for seed in range(8):
        found, error = flown(seed, 0.5)
        estimated = found.network.cameras[0].estimated
        sigma = np.sqrt(np.diag(found.solution.camera_covariance[0]) * found.solution.variance_factor)
        formal.append((error / np.where(estimated, sigma, 1.0))[estimated])
        robust.append(error[estimated] / sandwich(found)[0][estimated])
    assert np.sqrt(np.mean(np.square(formal))) > 1.6
    assert 0.7 < np.sqrt(np.mean(np.square(robust))) < 1.3


def test_sandwich_and_bootstrap_agree_with_the_adjustment_on_a_clean_flight() -> None:
    found, _ = flown(1, 0.0)
    estimated = found.network.cameras[0].estimated
    formal = np.sqrt(np.diag(found.solution.camera_covariance[0]))[estimated]
    assert np.median(sandwich(found)[0][estimated] / formal) == pytest.approx(1.0, abs=0.25)
    drawn = bootstrap(found, 30, np.random.default_rng(1))[0][estimated]
    assert np.median(drawn / formal) == pytest.approx(1.0, abs=0.35)


def test_apart_from_a_third_on() -> None:
    assert apart(1.0, 1.34)
    assert apart(1.34, 1.0)
    assert not apart(1.0, 1.33)
    assert not apart(0.0, 1.0)
    assert not apart(1.0, None)
    assert not apart(1.0, float("nan"))

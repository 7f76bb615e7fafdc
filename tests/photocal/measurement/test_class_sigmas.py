"""Sigmas of tie points by class, against drawn errors of known size."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.measurement.tie_adjustment import GROSS, class_sigmas


def drawn(sigma: np.ndarray, redundancy: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lengths of residuals: of both errors the part that the redundancy number says is seen."""
    x, y = rng.normal(size=(2, len(sigma))) * sigma * np.sqrt(redundancy)
    return np.asarray(np.hypot(x, y))


def test_each_class_has_its_sigma() -> None:
    rng = np.random.default_rng(1)
    scale = rng.uniform(0, 8, 40_000)
    true = 0.03 + 0.02 * np.floor(scale)
    redundancy = rng.uniform(0.3, 0.95, len(scale))
    found = class_sigmas(scale, drawn(true, redundancy, rng), redundancy)
    # 5000 rays of two coordinates each know their sigma to 0.7 %; the classes' edges are quantiles.
    for k in range(8):
        assert np.median(found[np.floor(scale) == k]) == pytest.approx(0.03 + 0.02 * k, rel=0.03)


def test_gross_errors_do_not_count() -> None:
    rng = np.random.default_rng(2)
    redundancy = rng.uniform(0.3, 0.95, 10_000)
    size = drawn(np.full(10_000, 0.04), redundancy, rng)
    size[::50] = 5.0
    assert class_sigmas(np.zeros(10_000), size, redundancy)[0] == pytest.approx(0.04, rel=0.03)


def test_rays_that_stay_have_a_variance_factor_of_one() -> None:
    """Also where their errors are no normal ones: half of the rays are twice as precise as the others."""
    rng = np.random.default_rng(3)
    redundancy = rng.uniform(0.3, 0.95, 20_000)
    size = drawn(np.where(rng.random(20_000) < 0.5, 0.03, 0.06), redundancy, rng)
    size[::40] = rng.uniform(1, 5, 500)
    sigma = class_sigmas(np.zeros(20_000), size, redundancy)
    stays = size <= GROSS * sigma * np.sqrt(2 * redundancy)
    assert 300 < np.count_nonzero(~stays) < 700
    factor = (size[stays] ** 2 / sigma[stays] ** 2).sum() / (2 * redundancy[stays].sum())
    assert factor == pytest.approx(1.0, abs=2e-3)


def test_few_rays_are_one_class() -> None:
    rng = np.random.default_rng(4)
    scale, redundancy = rng.uniform(size=300), np.full(300, 0.5)
    assert len(np.unique(class_sigmas(scale, drawn(np.full(300, 0.1), redundancy, rng), redundancy))) == 1

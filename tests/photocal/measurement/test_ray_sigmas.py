"""Sigmas of tie points by class and image, against drawn errors of known size."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.measurement.tie_block import GROSS, class_sigmas, ray_sigmas


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


def test_each_image_has_its_factor() -> None:
    """Two flying heights, and one image that is blurred; the classes stay what they are."""
    rng = np.random.default_rng(5)
    scale, image = rng.uniform(0, 8, 40_000), rng.integers(40, size=40_000)
    factor = np.where(np.arange(40) < 20, 0.85, 1.15)
    factor[7] = 3.0
    true = (0.04 + 0.02 * np.floor(scale)) * factor[image]
    redundancy = rng.uniform(0.3, 0.95, len(scale))
    ratio = ray_sigmas(scale, image, drawn(true, redundancy, rng), redundancy) / true
    # 1000 rays of an image know its factor to 1.6 %.
    for k in range(40):
        assert np.median(ratio[image == k]) == pytest.approx(1.0, abs=0.06)
    for k in range(8):
        assert np.median(ratio[np.floor(scale) == k]) == pytest.approx(1.0, abs=0.03)


def test_an_image_of_few_rays_has_the_sigmas_of_all() -> None:
    rng = np.random.default_rng(6)
    image = np.where(np.arange(2000) < 1960, 0, 1)
    true = np.where(image == 0, 0.1, 0.2)
    redundancy = np.full(2000, 0.5)
    found = ray_sigmas(np.zeros(2000), image, drawn(true, redundancy, rng), redundancy)
    assert len(np.unique(found)) == 1
    assert found[0] == pytest.approx(0.1, rel=0.05)

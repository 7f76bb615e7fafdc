"""Where on the sensor residuals keep a pattern, and what scatters how much."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.analysis.systematic_errors.search import (
    assumed_sigma,
    grid_shape,
    residual_map,
    variance_components,
)


def test_the_residual_map_finds_a_patch_and_nothing_else() -> None:
    generator = np.random.default_rng(12)
    pixel = generator.uniform(0, [4000, 3000], (4000, 2))
    w = generator.standard_normal((4000, 2))
    patch = (pixel[:, 0] > 3000) & (pixel[:, 1] < 750)
    clean = residual_map((4000, 3000), pixel, 0.3 * w, w, 1.0)
    dirty = residual_map((4000, 3000), pixel, 0.3 * (w + 1.2 * patch[:, None]), w + 1.2 * patch[:, None], 1.0)
    assert not clean.significant.any()
    assert clean.global_p_value > 0.01
    assert dirty.significant.any()
    assert dirty.global_p_value < 1e-10
    rows, columns = np.nonzero(dirty.significant)
    assert np.all(dirty.columns_px[columns + 1] > 3000)
    assert np.all(dirty.rows_px[rows] < 750)
    inside = dirty.mean_px[0, -1]
    np.testing.assert_allclose(inside, 0.36, atol=0.15)


def test_the_residual_map_keeps_its_level() -> None:
    generator = np.random.default_rng(13)
    alarms = 0.0
    for _ in range(400):
        pixel, w = generator.uniform(0, [400, 300], (300, 2)), generator.standard_normal((300, 2))
        alarms += float(residual_map((400, 300), pixel, w, w, 1.0, level=0.05).significant.any())
    # 20 expected, with a standard deviation of 4.4.
    assert abs(alarms - 20) < 4 * 4.4


@pytest.mark.parametrize(("rays", "shape"), [(1, (1, 1)), (240, (4, 3)), (10**6, (12, 9))])
def test_cells_are_as_many_as_the_rays_can_fill(rays: int, shape: tuple[int, int]) -> None:
    assert grid_shape((4000, 3000), rays) == shape


def test_variance_components_of_known_scatter() -> None:
    generator = np.random.default_rng(14)
    group = np.repeat(np.arange(5), 200)
    truth = np.array([1.0, 1.0, 1.0, 1.6, 1.0])
    v = generator.standard_normal(1000) * truth[group]
    parts = variance_components(tuple("abcde"), group, v**2, np.full(1000, 1.0))
    for part, sigma in zip(parts, truth, strict=True):
        assert part.ratio == pytest.approx(sigma, abs=4 * sigma / np.sqrt(400))
    assert min(parts, key=lambda part: part.p_value).name == "d"
    equal = variance_components(tuple("abcde"), group, (v / truth[group]) ** 2, np.full(1000, 1.0))
    assert all(part.p_value > 0.005 for part in equal)


def test_the_sigma_that_is_found_has_an_honest_interval() -> None:
    generator = np.random.default_rng(15)
    inside = 0
    for _ in range(300):
        v = 2.0 * np.sqrt(0.8) * generator.standard_normal((40, 2))
        one = assumed_sigma(np.full((40, 2), 1.0), v, np.full((40, 2), 0.8))
        # 80 residuals with redundancy 0.8 carry 64 degrees of freedom: the interval is a little wide.
        inside += one.lower < 2.0 < one.upper
    assert 285 - 4 * 3.8 <= inside <= 300

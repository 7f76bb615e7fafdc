from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from photocal.analysis.accuracy.statistics import critical_deviate, outliers, similarity_trend
from photocal.base.errors import IllPosedError

Published = Callable[[str], list[dict[str, str]]]

# The worked example of Rosner 1983: 54 values, three outliers at 0.95.
ROSNER = [
    -0.25, 0.68, 0.94, 1.15, 1.20, 1.26, 1.26, 1.34, 1.38, 1.43, 1.49, 1.49, 1.55, 1.56, 1.58,
    1.65, 1.69, 1.70, 1.76, 1.77, 1.81, 1.91, 1.94, 1.96, 1.99, 2.06, 2.09, 2.10, 2.14, 2.15,
    2.23, 2.24, 2.26, 2.35, 2.37, 2.40, 2.47, 2.54, 2.62, 2.64, 2.90, 2.92, 2.92, 2.93, 3.21,
    3.26, 3.30, 3.59, 3.68, 4.30, 4.64, 5.34, 5.42, 6.01,
]  # fmt: skip


def test_rosners_example_has_three_outliers() -> None:
    values = np.array(ROSNER)
    assert {float(values[row]) for row in outliers(values, 0.95)} == {6.01, 5.42, 5.34}
    # Critical values of the published solution for the first steps.
    assert critical_deviate(54, 0.95) == pytest.approx(3.159, abs=5e-4)
    assert critical_deviate(53, 0.95) == pytest.approx(3.151, abs=5e-4)


def test_two_outliers_that_hide_each_other_are_both_found() -> None:
    values = np.append(np.random.default_rng(4).normal(0.0, 0.02, 18), [0.9, 0.91])
    assert set(outliers(values, 0.95)) == {18, 19}


def test_normal_values_raise_a_false_alarm_as_rarely_as_said() -> None:
    generator = np.random.default_rng(9)
    alarms = sum(bool(outliers(generator.normal(size=30), 0.95)) for _ in range(1000))
    # At most 5 % for the first step; the later steps add a little (Rosner 1983).
    assert alarms < 80


def test_equal_values_and_small_samples_have_no_outliers() -> None:
    assert outliers(np.full(12, 0.3), 0.95) == ()
    assert outliers(np.array([0.0, 0.0, 0.0, 9.0]), 0.95) == ()


@pytest.mark.parametrize(
    ("case", "scale", "rotation_mrad", "left"),
    [("f20", 0.0166, -0.86, 2.05), ("f20p4721", -0.0024, -0.64, 1.53)],
)
def test_similarity_of_the_orthophoto_tables(
    published: Published, case: str, scale: float, rotation_mrad: float, left: float
) -> None:
    rows = published(f"dcs460/orthophoto_check_{case}.csv")
    base = np.array([[float(row["E_base_m"]), float(row["N_base_m"])] for row in rows])
    corrections = np.array([[float(row["dE_m"]), float(row["dN_m"])] for row in rows])
    trend = similarity_trend(base, -corrections)
    # The study prints what the product needs: the corrections.
    assert -trend.scale == pytest.approx(scale, abs=5e-5)
    assert -trend.rotation_rad * 1e3 == pytest.approx(rotation_mrad, abs=5e-3)
    # The digest gives what is left for one coordinate.
    assert trend.rmse_left_m / np.sqrt(2.0) == pytest.approx(left, abs=5e-3)


def test_a_pure_similarity_is_recovered() -> None:
    positions = np.random.default_rng(0).uniform(0.0, 1000.0, (8, 2)) + np.array([457e3, 7553e3])
    reduced = positions - positions.mean(axis=0)
    d = np.array([0.4, -0.2]) + reduced @ np.array([[1e-3, 2e-4], [-2e-4, 1e-3]])
    trend = similarity_trend(positions, d)
    assert trend.scale == pytest.approx(1e-3, rel=1e-9)
    assert trend.rotation_rad == pytest.approx(2e-4, rel=1e-8)
    assert trend.shift_m == pytest.approx((0.4, -0.2))
    assert trend.rmse_left_m == pytest.approx(0.0, abs=1e-9)


def test_points_that_carry_no_similarity_are_refused() -> None:
    with pytest.raises(IllPosedError, match="three"):
        similarity_trend(np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(IllPosedError, match="same coordinates"):
        similarity_trend(np.ones((4, 2)), np.zeros((4, 2)))

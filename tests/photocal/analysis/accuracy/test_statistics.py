from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from photocal.analysis.accuracy.classes import Sample
from photocal.analysis.accuracy.statistics import (
    Moments,
    length_statistics,
    lengths,
    moments,
    spread,
)
from photocal.base.errors import InputMalformedError

Published = Callable[[str], list[dict[str, str]]]
FloatArray = NDArray[np.float64]
values = st.lists(st.floats(-100.0, 100.0, width=32), min_size=2, max_size=40).map(np.array)


def test_published_moments_give_the_rmse_of_the_study(published: Published) -> None:
    table5 = {(row["product"], row["component"]): row for row in published("ixus220/table5_statistics.csv")}
    for row in published("ixus220/recomputed_tests.csv"):
        given_row = table5[row["product"], row["component"]]
        figures = Moments(int(given_row["n"]), float(given_row["mean_m"]), float(given_row["std_m"]))
        assert figures.rmse_m == pytest.approx(float(row["rmse_from_table5_m"]), abs=5e-5)


ORTHOPHOTO = {
    # mean dE, dN; sd dE, dN; rms dE, dN; rms 2D, max 2D: three decimals of the study's digest
    "f20": ((0.330, -1.441), (3.291, 4.233), (3.225, 4.370), (5.431, 8.495)),
    "f20p4721": ((0.411, 0.622), (1.594, 1.692), (1.607, 1.762), (2.385, 4.752)),
}


@pytest.mark.parametrize("case", sorted(ORTHOPHOTO))
def test_orthophoto_tables_to_three_decimals(published: Published, case: str) -> None:
    rows = published(f"dcs460/orthophoto_check_{case}.csv")
    d = np.array([[float(row["dE_m"]), float(row["dN_m"])] for row in rows])
    # The printed columns are corrections: base minus orthophoto.
    base_minus_ortho = np.array(
        [[float(row[f"{k}_base_m"]) - float(row[f"{k}_ortho_m"]) for k in "EN"] for row in rows]
    )
    assert d == pytest.approx(base_minus_ortho, abs=1e-4)
    east, north = (moments(column) for column in d.T)
    plane = length_statistics(lengths(d))
    means, stds, rmses, (rms, longest) = ORTHOPHOTO[case]
    assert (east.mean_m, north.mean_m) == pytest.approx(means, abs=5.1e-4)
    assert (east.std_m, north.std_m) == pytest.approx(stds, abs=5.1e-4)
    assert (east.rmse_m, north.rmse_m) == pytest.approx(rmses, abs=5.1e-4)
    assert Sample((east, north)).rmse_m == pytest.approx(rms, abs=5.1e-4)
    assert plane.rms_m == pytest.approx(rms, abs=5.1e-4)
    assert plane.maximum_m == pytest.approx(longest, abs=5.1e-4)


# Of the 19 tests of the tank study; the digest tells which printed values are off and by how much.
TANK_TOLERANCE = {
    "3": 0.00055,
    "14": 0.001,
    "15": 0.001,
    "16": 0.001,
    "17": 0.0003,
    "18": 0.0006,
    "19": 0.0006,
}


def test_tank_lengths_by_mean_and_by_root_mean_square_for_all_19_tests(published: Published) -> None:
    residuals = published("tank/tests_residuals.csv")
    summary = published("tank/tests_summary.csv")
    assert len(summary) == 19
    for row in summary:
        for role in ("control", "check"):
            of_role = [r for r in residuals if r["test"] == row["test"] and r["role"] == role]
            printed = row[f"R_{role}_m"]
            if not of_role:
                continue
            figures = length_statistics(np.array([float(r["residual_m"]) for r in of_role]))
            assert figures.rms_m >= figures.mean_m - 1e-15
            # Tables 9 and 10 swap the roles of their columns: the printed value stands where it stands.
            printed = printed or row["R_check_m"]
            tolerance = TANK_TOLERANCE.get(row["test"], 0.00011)
            assert figures.mean_m == pytest.approx(float(printed), abs=tolerance), row["test"]
            if float(printed) > 0.001:
                # Equation 5 of the study is the root mean square; its tables are not.
                assert 1.02 < figures.rms_m / float(printed) < 1.34


def test_tank_root_mean_square_of_test_16(published: Published) -> None:
    rows = [r for r in published("tank/tests_residuals.csv") if r["test"] == "16"]
    assert length_statistics(np.array([float(r["residual_m"]) for r in rows])).rms_m == pytest.approx(
        0.0440, abs=5e-5
    )


@given(values)
def test_rmse_is_the_mean_square_of_the_values(sample: FloatArray) -> None:
    figures = moments(sample)
    assert figures.rmse_m == pytest.approx(math.sqrt(np.mean(sample**2)), rel=1e-9, abs=1e-12)
    assert figures.rmse_without_mean_m == pytest.approx(float(np.std(sample)), rel=1e-9, abs=1e-12)


@given(values, st.floats(-50.0, 50.0))
def test_a_shift_of_the_product_changes_the_mean_and_not_the_spread(sample: FloatArray, shift: float) -> None:
    before, after = moments(sample), moments(sample - shift)
    assert after.mean_m == pytest.approx(before.mean_m - shift, abs=1e-9)
    assert after.std_m == pytest.approx(before.std_m, abs=1e-9)


def test_adding_the_mean_to_the_product_removes_the_bias() -> None:
    reference, product = np.array([10.0, 11.0, 12.5]), np.array([9.0, 10.2, 11.3])
    mean = moments(reference - product).mean_m
    assert moments(reference - (product + mean)).mean_m == pytest.approx(0.0, abs=1e-12)


def test_robust_standard_deviation_ignores_an_outlier() -> None:
    clean = np.random.default_rng(5).normal(0.0, 1.0, 2001)
    spoilt = np.append(clean, 1e6)
    assert spread(spoilt).nmad_m == pytest.approx(1.0, abs=0.06)


def test_one_point_has_no_spread() -> None:
    one = moments(np.array([0.3]))
    assert math.isnan(one.std_m)
    assert one.rmse_m == pytest.approx(0.3)


def test_no_point_is_refused() -> None:
    with pytest.raises(InputMalformedError, match="check point"):
        moments(np.array([]))

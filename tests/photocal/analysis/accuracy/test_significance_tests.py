from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from photocal.analysis.accuracy.classes import component_sigma
from photocal.analysis.accuracy.statistics import (
    Moments,
    bias_test,
    normality_test,
    precision_quantile,
    precision_test,
    rmse_after_trend_removal,
    std_interval_factors,
)
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, IllPosedError

Published = Callable[[str], list[dict[str, str]]]

# Scale and class that each product of the ixus220 study claims (Table 6), as the standard error in m.
CLAIMED_EP = {
    ("no_gcp", "E"): 0.3e-3 * 2500,
    ("no_gcp", "N"): 0.3e-3 * 2500,
    ("no_gcp", "h"): 2.0 / 3.0,
    ("gcp_8", "E"): 0.3e-3 * 1125,
    ("gcp_8", "N"): 0.3e-3 * 1125,
    ("gcp_8", "h"): 1.0 / 3.0,
}


def ixus(published: Published) -> dict[tuple[str, str], Moments]:
    return {
        (row["product"], row["component"]): Moments(int(row["n"]), float(row["mean_m"]), float(row["std_m"]))
        for row in published("ixus220/table5_statistics.csv")
    }


def test_quantiles_of_the_ixus220_study(published: Published) -> None:
    any_component = Moments(30, 1.0, 1.0)
    assert precision_quantile(30, 0.90) == pytest.approx(39.087469771, abs=1e-6)
    assert bias_test(any_component, 0.90).critical == pytest.approx(1.699127027, abs=1e-6)
    for row in published("ixus220/critical_values.csv"):
        level, value = float(row["probability"]), float(row["value"])
        if row["distribution"] == "chi2":
            assert precision_quantile(int(row["dof"]) + 1, level) == pytest.approx(value, abs=1e-6)
        else:
            # A two-sided confidence of 2 p - 1 compares with the quantile p.
            assert bias_test(any_component, 2.0 * level - 1.0).critical == pytest.approx(value, abs=1e-6)


def test_twelve_accept_or_reject_decisions_of_the_ixus220_study(published: Published) -> None:
    figures = ixus(published)
    decisions = 0
    for row in published("ixus220/table7_chi_square.csv"):
        for component in ("E", "N", "h"):
            key = row["product"], component
            sigma = component_sigma(CLAIMED_EP[key], 1 if component == "h" else 2)
            accepted = float(row[f"chi2_{component}"]) < float(row["chi2_tabulated"])
            assert precision_test(figures[key], sigma, 0.90).accepted == accepted, key
            decisions += 1
    for row in published("ixus220/table8_student_t.csv"):
        for component in ("E", "N", "h"):
            key = row["product"], component
            biased = float(row[f"t_{component}"]) >= float(row["t_tabulated"])
            assert bias_test(figures[key], 0.90).significant == biased, key
            decisions += 1
    assert decisions == 12


def test_statistics_of_the_ixus220_study_to_three_decimals(published: Published) -> None:
    figures = ixus(published)
    for row in published("ixus220/recomputed_tests.csv"):
        key = row["product"], row["component"]
        sigma = component_sigma(CLAIMED_EP[key], 1 if key[1] == "h" else 2)
        assert sigma == pytest.approx(float(row["sigma_expected_m"]), abs=5e-7)
        chi = precision_test(figures[key], sigma, 0.90).chi_squared
        assert chi == pytest.approx(float(row["chi2_from_table5"]), abs=6e-4)
        assert abs(bias_test(figures[key], 0.90).t) == pytest.approx(float(row["t_from_table5"]), abs=6e-4)


def moments_from_rmse_and_t(rmse_m: float, t: float, n: int) -> Moments:
    """Mean and standard deviation behind a published RMSE and Student statistic."""
    std = rmse_m * math.sqrt(n / (t**2 + n - 1))
    return Moments(n, t * std / math.sqrt(n), std)


def test_canon_elph_critical_value_and_all_42_values_of_table_24(published: Published) -> None:
    rmse = published("canon-elph/table22_check_rmse.csv")
    t = published("canon-elph/table23_check_t.csv")
    corrected = published("canon-elph/table24_check_rmse_trend_corrected.csv")
    compared = 0
    for rmse_row, t_row, row in zip(rmse, t, corrected, strict=True):
        for axis in "xyz":
            component = moments_from_rmse_and_t(float(rmse_row[f"{axis}_m"]), float(t_row[f"t_{axis}"]), 9)
            assert bias_test(component, 0.95).critical == pytest.approx(2.306, abs=5e-4)
            found = rmse_after_trend_removal(component, 0.95)
            assert found == pytest.approx(float(row[f"{axis}_m"]), abs=0.0012)
            compared += 1
    assert compared == 42


def test_canon_elph_pairs_of_tables_25_to_28_stay_within_their_bounds(published: Published) -> None:
    """hypot(ma - mb, sa - sb) <= RMSE of the difference <= hypot(ma - mb, sa + sb), for the fixed runs."""
    rmse = {(row["set"], row["iop_mode"]): row for row in published("canon-elph/table22_check_rmse.csv")}
    t = {(row["set"], row["iop_mode"]): row for row in published("canon-elph/table23_check_t.csv")}

    def spread_about_mean(name: str, mode: str, axis: str) -> tuple[float, float]:
        of = name, mode
        component = moments_from_rmse_and_t(float(rmse[of][f"{axis}_m"]), float(t[of][f"t_{axis}"]), 9)
        return component.mean_m, component.rmse_without_mean_m

    def inside(mode: str) -> list[bool]:
        held = []
        for row in published("canon-elph/table25_28_pairwise_check_rmse.csv"):
            if int(row["set_a"]) > int(row["set_b"]):
                continue
            for axis in "xyz":
                mean_a, s_a = spread_about_mean(row["set_a"], mode, axis)
                mean_b, s_b = spread_about_mean(row["set_b"], mode, axis)
                low = math.hypot(mean_a - mean_b, s_a - s_b)
                high = math.hypot(mean_a - mean_b, s_a + s_b)
                # Half a unit of the third decimal in each of the published figures.
                held.append(low - 0.002 <= float(row[f"{axis}_m"]) <= high + 0.002)
        return held

    assert inside("fixed") == [True] * 63
    assert inside("weighted").count(False) >= 15


def test_small_samples_are_worth_little() -> None:
    low, high = std_interval_factors(9, 0.95)
    # Closed form with the tabulated quantiles of chi-square with 8 degrees of freedom: 17.535, 2.180.
    assert low == pytest.approx(math.sqrt(8 / 17.535), abs=1e-4)
    assert high == pytest.approx(math.sqrt(8 / 2.180), abs=2e-4)


def test_false_alarms_come_at_the_level_of_the_test() -> None:
    generator = np.random.default_rng(11)
    biased = 0
    imprecise = 0
    for _ in range(2000):
        values = generator.normal(0.0, 0.2, 12)
        component = Moments(12, float(values.mean()), float(values.std(ddof=1)))
        biased += bias_test(component, 0.90).significant
        imprecise += not precision_test(component, 0.2, 0.90).accepted
    # Binomial with 2000 trials and 0.1: three standard deviations are 40.
    assert abs(biased - 200) < 41
    assert abs(imprecise - 200) < 41


@pytest.mark.parametrize("n", [3, 4, 5, 6, 11, 12, 30, 400, 5000])
def test_normality_is_that_of_scipy(n: int) -> None:
    rng = np.random.default_rng(n)
    samples: list[Floats] = [
        rng.normal(2.0, 0.03, n),
        rng.exponential(0.1, n),
        np.tile([0.0, 0.01, 0.02], n)[:n],
    ]
    for values in samples:
        result, expected = normality_test(values, 0.95), stats.shapiro(values)
        assert result is not None
        assert result.w == pytest.approx(expected.statistic, abs=1e-8)
        assert result.p_value == pytest.approx(expected.pvalue, abs=1e-5)


def test_normality_decides_as_scipy_and_says_nothing_without_spread() -> None:
    skew = np.random.default_rng(2).exponential(1.0, 40)
    result = normality_test(skew, 0.95)
    assert result is not None
    assert result.rejected
    assert result.w == pytest.approx(float(stats.shapiro(skew).statistic))
    assert normality_test(np.array([0.1, 0.2]), 0.95) is None
    assert normality_test(np.full(5, 0.1), 0.95) is None


def test_equal_discrepancies_are_a_pure_bias() -> None:
    assert bias_test(Moments(5, 0.3, 0.0), 0.90).significant
    assert not bias_test(Moments(5, 0.0, 0.0), 0.90).significant


def test_impossible_questions_are_refused() -> None:
    with pytest.raises(IllPosedError, match="at least two"):
        bias_test(Moments(1, 0.3, math.nan), 0.90)
    with pytest.raises(ConfigurationError, match="confidence"):
        bias_test(Moments(5, 0.3, 0.1), 90.0)
    with pytest.raises(ConfigurationError, match="standard deviation"):
        precision_test(Moments(5, 0.3, 0.1), 0.0, 0.90)

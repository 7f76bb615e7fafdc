"""F tests against the tables of the Canon ELPH study and against simulated adjustments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.analysis.estimates import (
    Estimates,
    f_test,
    from_sigmas,
    quadratic_form,
    scaled,
    significance,
    without,
)
from photocal.base.chi_square import global_test
from photocal.base.errors import ConfigurationError, IllPosedError

Rows = list[dict[str, str]]
NAMES = {"f": "c", "A": "B1", "B": "B2"}
# Degrees of freedom that the printed chi-squared values imply: Box 4, with the misprint of set 5
# (2407 for 2107) and set 4 of another run (2468).
REDUNDANCY = {"1": 2470, "2": 2462, "3": 2532, "4": 2468, "5": 2107, "6": 1996, "7": 1884}


def test_table_10_single_parameters(canon: Callable[[str], Rows], canon_sets: dict[str, Estimates]) -> None:
    within, worst = 0, []
    for row in canon("table10_f_individual"):
        if row["set"] == "4":  # the printed column belongs to another run than Table 7
            continue
        estimates = canon_sets[row["set"]]
        name = NAMES.get(row["parameter"], row["parameter"])
        test = f_test(estimates, (name,), REDUNDANCY[row["set"]], alpha=0.10)
        printed = float(row["f_computed"])
        if abs(test.statistic / printed - 1.0) <= 0.0055:
            within += 1
        else:
            worst.append((row["set"], name))
        assert test.significant == (printed >= 2.71)
    # f of set 1 was misprinted (4.370 for 4.3816): its F agrees to 0.51 % but not in the printed digits.
    assert within >= 59
    assert set(worst) <= {("1", "c")}


def test_the_printed_f_of_set_1_is_not_the_tested_one(canon_sets: dict[str, Estimates]) -> None:
    misprinted = f_test(canon_sets["1"], ("c",), 2470, 0.10).statistic
    assert f"{misprinted:.2e}" != "1.10e+07"
    assert f"{(4.3816 / 0.001321) ** 2:.2e}" == "1.10e+07"


@pytest.mark.parametrize(
    ("parameters", "printed"), [(("c",), 2.71), (("x0", "y0"), 2.30), (("K1", "K2", "K3"), 2.09)]
)
def test_critical_values(
    canon_sets: dict[str, Estimates], parameters: tuple[str, ...], printed: float
) -> None:
    for name, redundancy in REDUNDANCY.items():
        test = f_test(canon_sets["1"], parameters, redundancy, alpha=0.10)
        assert test.critical == pytest.approx(printed, abs=0.0065), name


@pytest.mark.parametrize(
    ("parameters", "printed", "tolerance"),
    # Two decimals of the correlation 0.90 leave 1.940 to 1.959e4 for x0 y0.
    [(("x0", "y0"), 1.949e4, 1e1), (("P1", "P2"), 1.11e4, 5e1), (("B1", "B2"), 11.1, 0.05)],
)
def test_table_11_groups_of_set_1(
    canon_sets: dict[str, Estimates], parameters: tuple[str, ...], printed: float, tolerance: float
) -> None:
    test = f_test(canon_sets["1"], parameters, 2470, alpha=0.10)
    assert test.statistic == pytest.approx(printed, abs=tolerance)
    assert test.significant


def test_table_11_x0_y0_as_printed(canon_sets: dict[str, Estimates]) -> None:
    # The sign and size of corr(x0, y0) = -0.03 is known to 0.005: the printed 1.96e4 lies in that range.
    statistics = []
    for rho in (-0.025, -0.030, -0.035):
        pair = canon_sets["1"].select(("x0", "y0"))
        known = from_sigmas(pair.names, list(pair.values), list(pair.sigmas), np.array([[1, rho], [rho, 1]]))
        statistics.append(f_test(known, ("x0", "y0"), 2470, 0.10).statistic)
    assert min(statistics) == pytest.approx(1.940e4, abs=10)
    assert max(statistics) == pytest.approx(1.959e4, abs=10)


def test_all_the_usual_tests_are_made(canon_sets: dict[str, Estimates]) -> None:
    tests = significance(canon_sets["1"], 2470)
    groups = [test.parameters for test in tests if test.kind == "group"]
    cumulative = [test.parameters for test in tests if test.kind == "cumulative"]
    assert groups == [("x0", "y0"), ("K1", "K2", "K3"), ("P1", "P2"), ("B1", "B2")]
    assert cumulative == [("K1",), ("K1", "K2"), ("K1", "K2", "K3")]
    weak = {test.parameters[0] for test in tests if test.kind == "single" and not test.significant}
    assert weak == {"K3", "B2"}  # section 2.4.2 of the study: K3 and B of set 1


def test_table_5_global_test(canon: Callable[[str], Rows]) -> None:
    for row in canon("table05_global_test"):
        redundancy = REDUNDANCY[row["set"]]
        # What the table calls a variance is a standard deviation.
        chi_squared = redundancy * float(row["variance_a_posteriori_px_as_labelled"]) ** 2
        assert chi_squared == pytest.approx(float(row["chi2_computed"]), rel=5e-4)
        test = global_test(chi_squared, redundancy, 0.90, "one-sided")
        assert test is not None
        assert test.upper == pytest.approx(float(row["chi2_critical"]), abs=0.02)
        assert test.accepted


def test_redundancy_of_box_4(canon: Callable[[str], Rows]) -> None:
    for row in canon("box04_adjustment_counts"):
        counted = int(row["observations"]) + int(row["constraints"]) - int(row["parameters_total"])
        assert (counted == REDUNDANCY[row["set"]]) == (row["set"] != "4")


def test_global_test_of_the_convergent_camera_study() -> None:
    # DCS460 study: chi-squared 887.6 with 842 degrees of freedom, p = 0.13.
    test = global_test(887.6, 842, 0.95, "one-sided")
    assert test is not None
    assert test.accepted
    assert test.p_value == pytest.approx(0.13, abs=0.005)


def test_without_agrees_with_an_adjustment_made_anew() -> None:
    generator = np.random.default_rng(4)
    A, l = generator.standard_normal((60, 5)), generator.standard_normal(60)  # noqa: E741
    x0 = np.array(np.linalg.lstsq(A, l)[0], dtype=np.float64)
    S = np.array(np.linalg.inv(A.T @ A), dtype=np.float64)
    full = Estimates(tuple("abcde"), x0, S)
    kept, increase = without(full, ("b", "d")), quadratic_form(full.select("bd"))
    B = A[:, [0, 2, 4]]
    x = np.linalg.lstsq(B, l)[0]
    assert kept.names == ("a", "c", "e")
    np.testing.assert_allclose(kept.values, x, rtol=1e-10)
    np.testing.assert_allclose(kept.covariance, np.linalg.inv(B.T @ B), rtol=1e-10)
    grown = float(np.sum((B @ x - l) ** 2) - np.sum((A @ full.values - l) ** 2))
    assert increase == pytest.approx(grown, rel=1e-10)


def test_false_alarms_keep_the_level() -> None:
    generator = np.random.default_rng(7)
    A = generator.standard_normal((40, 6))
    Q = np.array(np.linalg.inv(A.T @ A), dtype=np.float64)
    alarms = 0
    for _ in range(2000):
        l = generator.standard_normal(40) * 3.0  # noqa: E741
        x = Q @ A.T @ l
        v = A @ x - l
        estimates = scaled(Estimates(tuple("abcdef"), x, Q), float(v @ v) / 34)
        alarms += f_test(estimates, ("b", "e", "f"), 34, 0.10).significant
    # 2000 trials at 10 %: 200 with a standard deviation of 13.4.
    assert abs(alarms - 200) < 4 * 13.4


@given(st.lists(st.floats(0.01, 100.0), min_size=3, max_size=3), st.floats(-0.9, 0.9))
def test_the_quadratic_form_does_not_depend_on_units(units: list[float], rho: float) -> None:
    r = np.array([[1.0, rho, 0.1], [rho, 1.0, -0.1], [0.1, -0.1, 1.0]])
    if np.linalg.eigvalsh(r)[0] < 1e-3:
        return
    x, s = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.2, 0.1])
    in_one = quadratic_form(from_sigmas("abc", list(x), list(s), r))
    in_other = quadratic_form(from_sigmas("abc", list(x * units), list(s * units), r))
    assert in_other == pytest.approx(in_one, rel=1e-9)


def test_an_impossible_correlation_matrix_is_refused() -> None:
    r = np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]])
    with pytest.raises(IllPosedError, match=r"K1 K2 K3 is not positive definite \(least eigenvalue -0.8\)"):
        f_test(from_sigmas(("K1", "K2", "K3"), [1, 1, 1], [1, 1, 1], r), ("K1", "K2", "K3"), 10, 0.1)


@pytest.mark.parametrize(
    ("values", "sigmas", "correlation", "message"),
    [
        ([1.0], [1.0, 1.0], None, "do not fit together"),
        ([1.0, 1.0], [1.0, 0.0], None, "sigma of y is not a positive number"),
        ([1.0, 1.0], [1.0, 1.0], np.array([[1.0, 0.5], [0.4, 1.0]]), "not symmetric"),
        ([1.0, 1.0], [1.0, 1.0], np.array([[1.0, 1.5], [1.5, 1.0]]), "within -1 and 1"),
    ],
)
def test_wrong_estimates_are_refused(
    values: list[float],
    sigmas: list[float],
    correlation: np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None,
    message: str,
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        from_sigmas(("x", "y"), values, sigmas, correlation)


def test_a_parameter_that_was_not_estimated_is_named() -> None:
    with pytest.raises(ConfigurationError, match="parameter K3 is not among the estimated ones"):
        f_test(from_sigmas(("c",), [1.0], [0.1]), ("K3",), 10, 0.1)

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from photocal.analysis.accuracy.classes import Sample, admitted_size, decide, sample, smallest_listed
from photocal.analysis.accuracy.standard import LimitTable, ScaleStandard, load_standard
from photocal.analysis.accuracy.statistics import Moments

Published = Callable[[str], list[dict[str, str]]]
FloatArray = NDArray[np.float64]


def table(standard: str, product: str) -> LimitTable:
    content = load_standard(standard)
    assert isinstance(content, ScaleStandard)
    return next(entry for entry in content.tables if entry.product == product)


def ixus(published: Published, product: str, component: str) -> Sample:
    figures = {
        row["component"]: Moments(int(row["n"]), float(row["mean_m"]), float(row["std_m"]))
        for row in published("ixus220/table5_statistics.csv")
        if row["product"] == product
    }
    return Sample((figures["E"], figures["N"]) if component == "planimetry" else (figures["h"],))


DECREE = {"planimetry": "planimetry", "altimetry": "heights"}


def test_largest_scales_by_precision_of_the_ixus220_study(published: Published) -> None:
    for row in published("ixus220/recomputed_classification_precision.csv"):
        if row["std_source"] != "table5":
            continue
        product = ixus(published, row["product"], row["component"])
        limits = table("decree-89817", DECREE[row["component"]])
        size = admitted_size(product, limits, row["class"], 0.9, 0.90).precision
        decimals = 1 if row["quantity"] == "scale_denominator" else 4
        assert size == pytest.approx(float(row["minimum_passing_chi2"]), abs=0.6 * 10.0**-decimals)


def test_largest_scales_1_1056_and_1_2274(published: Published) -> None:
    limits = table("decree-89817", "planimetry")
    sizes = {
        name: admitted_size(ixus(published, name, "planimetry"), limits, "A", 0.9, 0.90).precision
        for name in ("gcp_8", "no_gcp")
    }
    assert sizes["gcp_8"] == pytest.approx(1055.7, abs=0.05)
    assert sizes["no_gcp"] == pytest.approx(2273.9, abs=0.05)
    assert smallest_listed((1000.0, 1125.0, 2000.0, 2500.0), sizes["gcp_8"] or 0.0) == 1125.0
    assert smallest_listed((1000.0, 1125.0, 2000.0, 2500.0), sizes["no_gcp"] or 0.0) == 2500.0


def test_accuracy_truth_of_the_ixus220_study(published: Published) -> None:
    for row in published("ixus220/recomputed_classification_rmse.csv"):
        product = ixus(published, row["product"], row["component"])
        limits = table("decree-89817", DECREE[row["component"]])
        found = admitted_size(product, limits, row["class"], 0.9, 0.90)
        assert product.rmse_m == pytest.approx(float(row["rmse_m"]), abs=6e-5)
        rounding = 0.51 if row["quantity"] == "scale_denominator" else 0.51e-3
        assert found.rmse == pytest.approx(float(row["minimum_for_rmse_le_ep"]), abs=rounding)
        # Only moments were published, therefore the 90 % rule cannot be applied.
        assert found.share is None


def test_published_conclusions_that_do_not_follow(published: Published) -> None:
    """Class A at 1:2500 without control points, and class A of the heights at 1 m with eight."""
    plane = table("decree-89817", "planimetry")
    heights = table("decree-89817", "heights")
    no_gcp = decide(ixus(published, "no_gcp", "planimetry"), plane.limits_at(2500.0)[0], 0.9, 0.90)
    assert no_gcp.precise
    assert not no_gcp.accurate
    gcp_heights = [
        decide(ixus(published, "gcp_8", "altimetry"), limit, 0.9, 0.90) for limit in heights.limits_at(1.0)
    ]
    assert [decision.precise for decision in gcp_heights] == [True, True, True]
    assert [decision.accurate for decision in gcp_heights] == [False, True, True]
    gcp_plane = decide(ixus(published, "gcp_8", "planimetry"), plane.limits_at(1125.0)[0], 0.9, 0.90)
    assert gcp_plane.precise
    assert gcp_plane.accurate


def test_90_percent_rule_with_the_minima_of_the_ixus220_study() -> None:
    """Every point of the flight without control is off by 1.458 m at least: 0 of 30 within 1.25 m."""
    vectors = np.tile([[0.87, 1.17]], (30, 1))
    decision = decide(sample(vectors), table("decree-89817", "planimetry").limits_at(2500.0)[0], 0.9, 0.90)
    assert decision.limit.pec_m == pytest.approx(1.25)
    assert decision.share_within == 0.0


def test_pec_pcd_verdicts_on_the_ixus220_study(published: Published) -> None:
    def first(product: str, component: str, limits: LimitTable, size: float) -> str | None:
        figures = ixus(published, product, component)
        return next((c.name for c in limits.limits_at(size) if decide(figures, c, 0.9, 0.90).accurate), None)

    plane = table("pec-pcd", "planimetry")
    assert first("gcp_8", "planimetry", plane, 1125.0) == "B"
    assert first("gcp_8", "planimetry", plane, 1000.0) == "C"
    assert first("gcp_8", "planimetry", plane, 2000.0) == "A"
    assert first("gcp_8", "altimetry", table("pec-pcd", "spot heights and elevation models"), 1.0) == "C"


def test_phantom4pro_scales_that_its_check_rmse_supports() -> None:
    """Planimetric RMSE 1.02 cm and height RMSE 1.44 cm; a class without scale says nothing."""
    plane = Sample((Moments(10, 0.0102, 0.0), Moments(10, 0.0, 0.0)))
    height = Sample((Moments(10, 0.0144, 0.0),))
    models = table("pec-pcd", "spot heights and elevation models")
    assert admitted_size(plane, table("decree-89817", "planimetry"), "A", 0.9, 0.9).rmse == pytest.approx(
        34.0
    )
    assert admitted_size(plane, table("pec-pcd", "planimetry"), "A", 0.9, 0.9).rmse == pytest.approx(60.0)
    assert admitted_size(height, table("decree-89817", "heights"), "A", 0.9, 0.9).rmse == pytest.approx(
        0.0432
    )
    assert admitted_size(height, models, "A", 0.9, 0.9).rmse == pytest.approx(0.0864)


vectors = st.lists(
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), min_size=3, max_size=30, unique=True
).map(np.array)


@given(vectors, st.sampled_from("ABCD"))
def test_a_class_is_reached_just_above_its_exact_scale_and_not_just_below(d: FloatArray, name: str) -> None:
    limits = table("pec-pcd", "planimetry")
    product = sample(d)
    exact = admitted_size(product, limits, name, 0.9, 0.90)

    def decision(denominator: float, precise: bool) -> bool:
        limit = next(c for c in limits.limits(denominator) if c.name == name)
        found = decide(product, limit, 0.9, 0.90)
        return found.precise if precise else found.accurate

    if exact.accuracy > 1e-6:
        assert decision(exact.accuracy * (1 + 1e-9), precise=False)
        assert not decision(exact.accuracy * (1 - 1e-6), precise=False)
    if exact.precision is not None and exact.precision > 1e-6:
        assert decision(exact.precision * (1 + 1e-6), precise=True)
        assert not decision(exact.precision * (1 - 1e-6), precise=True)


@given(vectors, st.floats(0.5, 20.0))
def test_a_bias_lowers_the_accuracy_class_and_leaves_the_precision_class(d: FloatArray, bias: float) -> None:
    limits = table("pec-pcd", "planimetry")
    centred = d - d.mean(axis=0)
    straight = admitted_size(sample(centred), limits, "A", 0.9, 0.90)
    biased = admitted_size(sample(centred + np.array([bias, 0.0])), limits, "A", 0.9, 0.90)
    assert biased.rmse > straight.rmse
    assert biased.precision == pytest.approx(straight.precision, rel=1e-6, abs=1e-6)


def test_one_point_has_an_accuracy_and_no_precision() -> None:
    product = sample(np.array([[0.1, 0.1]]))
    limits = table("decree-89817", "planimetry")
    assert not decide(product, limits.limits_at(1000.0)[0], 0.9, 0.90).precise
    assert decide(product, limits.limits_at(1000.0)[0], 0.9, 0.90).accurate
    assert admitted_size(product, limits, "A", 0.9, 0.90).precision is None


def test_errors_equal_to_the_limit_are_within_it() -> None:
    """The norm asks for errors "equal to or smaller than" PEC: 0.50 m at 1:1000 in class A of the decree."""
    limit = table("decree-89817", "planimetry").limits_at(1000.0)[0]
    d = np.array([[0.5, 0.0]] + [[0.0, 0.0]] * 4)
    assert decide(sample(d), limit, 1.0, 0.90).share_passes

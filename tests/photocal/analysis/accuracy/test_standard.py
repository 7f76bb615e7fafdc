from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import pytest

from photocal.analysis.accuracy.standard import (
    SHIPPED,
    LimitTable,
    ScaleStandard,
    ValueStandard,
    load_standard,
    parse_standard,
)
from photocal.base.errors import ConfigurationError, InputNotFoundError

Published = Callable[[str], list[dict[str, str]]]


def table(standard: str, product: str) -> LimitTable:
    content = load_standard(standard)
    assert isinstance(content, ScaleStandard)
    return next(entry for entry in content.tables if entry.product == product)


def test_decree_as_printed_in_the_studies(published: Published) -> None:
    plane, heights = table("decree-89817", "planimetry"), table("decree-89817", "heights")
    for row, unit, fraction in zip(
        published("ixus220/table1_pec.csv"), plane.limits(1000.0), heights.limits(1.0), strict=True
    ):
        assert unit.name == fraction.name == row["class"]
        assert unit.pec_m == pytest.approx(float(row["planim_pec_mm"]))
        assert unit.ep_m == pytest.approx(float(row["planim_ep_mm"]))
        assert fraction.pec_m == pytest.approx(float(Fraction(row["altim_pec_equidistance"])))
        assert fraction.ep_m == pytest.approx(float(Fraction(row["altim_ep_equidistance"])))


def test_standard_errors_on_the_ground_of_the_ixus220_study(published: Published) -> None:
    for row in published("ixus220/table6_standard_errors.csv"):
        plane = table("decree-89817", "planimetry").limits_at(float(row["scale_denominator"]))[0]
        heights = table("decree-89817", "heights").limits_at(float(row["equidistance_m"]))[0]
        assert plane.ep_m == pytest.approx(float(row["planim_ep_ground_m"]), abs=5.1e-4)
        # 0.666 is truncated in print.
        assert heights.ep_m == pytest.approx(float(row["altim_ep_ground_m"]), abs=7e-4)


@pytest.mark.parametrize(
    ("product", "file"),
    [
        ("planimetry", "canon-elph/table01_pec_pcd_planimetry.csv"),
        ("contours", "canon-elph/table02_pec_pcd_contours.csv"),
    ],
)
def test_pec_pcd_as_printed_in_the_dissertation(published: Published, product: str, file: str) -> None:
    limits = table("pec-pcd", product)
    for row in published(file):
        size = float(row["scale_denominator" if limits.basis == "scale" else "contour_interval_m"])
        limit = next(entry for entry in limits.limits_at(size) if entry.name == row["class"])
        assert limit.pec_m == float(row["pec_m"])
        # 8.51 m is printed for class A at 1:50 000 where the rule gives 8.50.
        assert limit.ep_m == pytest.approx(float(row["ep_m"]), abs=0.0101 if size == 50_000 else 1e-12)


def test_pec_pcd_of_elevation_models_by_the_rule(published: Published) -> None:
    limits = table("pec-pcd", "spot heights and elevation models").limits(1.0)
    for row, limit in zip(published("phantom4pro/pec_pcd_external.csv"), limits, strict=True):
        assert limit.pec_m == pytest.approx(float(Fraction(row["dem_altim_pec_equidistance"])))
        assert limit.ep_m == pytest.approx(float(Fraction(row["dem_altim_ep_equidistance"])))


@pytest.mark.parametrize("product", ["planimetry", "spot heights and elevation models", "contours"])
def test_printed_figures_follow_the_rule_within_their_rounding(product: str) -> None:
    limits = table("pec-pcd", product)
    assert limits.sizes()[-1] == (250_000.0 if limits.basis == "scale" else 100.0)
    for size in limits.sizes():
        for rule, printed in zip(limits.limits(size), limits.limits_at(size), strict=True):
            assert printed.pec_m == pytest.approx(rule.pec_m, rel=0.02)
            assert printed.ep_m == pytest.approx(rule.ep_m, rel=0.021)


def test_contour_intervals_of_the_scales() -> None:
    contours = table("pec-pcd", "contours")
    scales = (1000, 2000, 5000, 10_000, 25_000, 50_000, 100_000, 250_000)
    assert [contours.interval_at(scale) for scale in scales] == [1, 1, 2, 5, 10, 20, 50, 100]
    assert contours.interval_at(3000) is None
    assert table("pec-pcd", "planimetry").interval_at(1000) is None


@pytest.mark.parametrize("name", SHIPPED)
def test_every_figure_has_its_source_and_second_hand_ones_say_so(name: str) -> None:
    standard = load_standard(name)
    if isinstance(standard, ValueStandard):
        entries = [standard.minimum_points, standard.maximum_points, standard.mean_share_of_target]
        assert standard.minimum_points.value == 30
        assert all(entry.source and entry.source_note for entry in entries if entry.second_hand)
    else:
        assert all(entry.source and entry.source_note for entry in standard.tables if entry.second_hand)


SMALL = """
id = "mine"
kind = "scale"
title = "Mine"
authority = "me"
fraction_within_pec = 0.9
[[table]]
product = "planimetry"
component = "planimetry"
basis = "scale"
pec = { A = 0.5 }
ep = { A = 0.3 }
source = "mine"
second_hand = false
"""


def test_a_standard_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(SMALL, encoding="utf-8")
    standard = load_standard(str(path))
    assert isinstance(standard, ScaleStandard)
    assert standard.tables[0].limits_at(1000.0)[0].ep_m == 0.3


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("pec = { A = 0.5 }", "pec = { A = -0.5 }", "positive"),
        ("pec = { A = 0.5 }", 'pec = { A = "x" }', "not a number"),
        ("pec = { A = 0.5 }", 'pec = { A = "1/0" }', "not a number"),
        ("pec = { A = 0.5 }", "pec = { B = 0.5 }", "same classes"),
        ("fraction_within_pec", "fraction", "fraction"),
        ('kind = "scale"', 'kind = "scales"', "kind"),
        ('basis = "scale"', 'basis = "map"', "basis"),
        ("second_hand = false", "", "second_hand"),
        ("[[table]]", "[[table", "TOML"),
    ],
)
def test_a_wrong_standard_is_refused_in_one_line(before: str, after: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=re.compile(message)) as failure:
        parse_standard(SMALL.replace(before, after, 1), "mine.toml")
    assert "\n" not in str(failure.value)


def test_an_unknown_standard_is_not_found() -> None:
    with pytest.raises(InputNotFoundError, match="decree-89817"):
        load_standard("nbr-13133")

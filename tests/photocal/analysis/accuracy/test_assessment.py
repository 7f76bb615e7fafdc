from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from photocal.analysis.accuracy.assessment import Assessment, TableResult, assess, findings
from photocal.analysis.accuracy.classes import Sample, class_cm, sample, value_class
from photocal.analysis.accuracy.discrepancies import Discrepancies, read_discrepancies
from photocal.analysis.accuracy.maps import gsd_circles
from photocal.analysis.accuracy.output import to_json, to_text
from photocal.analysis.accuracy.standard import SHIPPED, Question, ValueStandard, load_standard
from photocal.base.errors import ConfigurationError
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue
from tests.photocal.findings.english import english

Published = Callable[[str], list[dict[str, str]]]
FloatArray = NDArray[np.float64]
STANDARDS = tuple(load_standard(name) for name in SHIPPED)


def synthetic_ixus(published: Published, product: str) -> Discrepancies:
    """Thirty points with the four printed corrections of Table 4 and the moments of Table 5: synthetic.

    The other 26 rows are random, shifted and scaled so that mean and standard deviation are those of
    the table. The largest and smallest values are not.
    """
    suffix = {"no_gcp": "no_gcp_m", "gcp_8": "gcp_m"}[product]
    printed = published("ixus220/table4_discrepancies.csv")
    known = np.array([[float(row[f"d{axis}_{suffix}"]) for axis in "ENh"] for row in printed])
    moments = {
        row["component"]: (float(row["mean_m"]), float(row["std_m"]))
        for row in published("ixus220/table5_statistics.csv")
        if row["product"] == product
    }
    rest = np.random.default_rng(30).uniform(-1.0, 1.0, (26, 3))
    for column, axis in enumerate("ENh"):
        mean, std = moments[axis]
        rest_mean = (30 * mean - known[:, column].sum()) / 26
        squares = 29 * std**2 - float(np.sum((known[:, column] - mean) ** 2)) - 26 * (rest_mean - mean) ** 2
        values = rest[:, column] - rest[:, column].mean()
        rest[:, column] = rest_mean + values * math.sqrt(squares / float(np.sum(values**2)))
    names = tuple(row["target"] for row in printed) + tuple(f"S{number}" for number in range(1, 27))
    return Discrepancies(names, -np.vstack((known, rest)))


def of_table(result: Assessment, standard: str, component: str) -> TableResult:
    return next(
        table
        for table in result.tables
        if table.standard_id == standard and table.table.component == component
    )


def codes(said: tuple[Finding, ...]) -> list[str]:
    return [finding.code for finding in said]


def test_flight_without_control_is_precise_and_not_accurate(published: Published) -> None:
    result = assess(synthetic_ixus(published, "no_gcp"), STANDARDS, Question(2500.0, 2.0))
    plane = of_table(result, "decree-89817", "planimetry")
    heights = of_table(result, "decree-89817", "height")
    assert plane.precision_class == "A"
    assert plane.accuracy_class is None
    assert plane.differ
    assert plane.admitted[0].rmse == pytest.approx(10614.0, abs=0.5)
    assert (heights.precision_class, heights.accuracy_class) == (None, None)
    texts = [english(finding) for finding in findings(result) if finding.code == "class-differs"]
    assert any("by precision class A, but by accuracy no class" in text for text in texts)
    biases = [english(finding) for finding in findings(result) if finding.code == "bias"]
    assert len(biases) == 3
    # The printed correction is positive in h: the model lies about 2.8 m low, as the study says.
    assert "too low" in biases[2]
    assert "adding +2.830 m" in biases[2]


def test_flight_with_control_is_class_b_in_height_at_1_m(published: Published) -> None:
    result = assess(synthetic_ixus(published, "gcp_8"), STANDARDS, Question(1125.0, 1.0))
    plane = of_table(result, "decree-89817", "planimetry")
    heights = of_table(result, "decree-89817", "height")
    assert plane.precision_class == "A"
    assert (heights.precision_class, heights.accuracy_class) == ("A", "B")
    assert "bias" in codes(findings(result))
    assert "small-sample" not in codes(findings(result))


def test_points_within_the_circles_of_the_study(published: Published) -> None:
    """The four printed rows; with control 0.480, 0.211, 0.334 and 0.215 m from their places."""
    printed = published("ixus220/table4_discrepancies.csv")
    for suffix in ("no_gcp_m", "gcp_m"):
        d = np.array([[-float(row[f"d{axis}_{suffix}"]) for axis in "ENh"] for row in printed])
        result = assess(Discrepancies(tuple("1234"), d), STANDARDS, Question(gsd_m=0.25))
        assert result.plane is not None
        # None of those without control lies within a circle, as the study says of all 30.
        assert result.plane.within_gsd == ((2, 4) if suffix == "gcp_m" else (0, 0))
    assert to_json(result)["planimetry"]["within_2_gsd"] == 4
    assert "in 2 GSD" in to_text(result)
    figure = gsd_circles(result.discrepancies, 0.25, catalogue("en"))
    assert figure is not None
    radii = [np.hypot(*np.array(line.get_data())).max() for line in figure.axes[0].lines[1:]]
    assert radii == pytest.approx([0.25, 0.5])


def test_interval_of_the_scale_is_taken_from_the_standard() -> None:
    d = Discrepancies(("A", "B", "C"), np.array([[0.1, 0.0, 0.1], [0.0, 0.1, -0.1], [-0.1, 0.0, 0.05]]))
    result = assess(d, STANDARDS, Question(10_000.0))
    assert of_table(result, "pec-pcd", "height").size == 5.0
    assert of_table(result, "decree-89817", "height").size is None
    assert of_table(result, "decree-89817", "height").decisions == ()


def test_measures_of_iso_19157() -> None:
    off = np.random.default_rng(4).normal((0.02, -0.01, 0.05), 0.03, (40, 3))
    told = to_json(assess(Discrepancies(tuple(map(str, range(40))), off), STANDARDS, Question()))["iso_19157"]
    measures = {(one["measure"], one["of"]): one["value_m"] for one in told}
    plane, height = np.hypot(off[:, 0], off[:, 1]), off[:, 2]
    assert measures[128, "N"] == pytest.approx(off[:, 1].mean())
    assert measures[39, "h"] == pytest.approx(np.sqrt(np.mean(height**2)))
    assert measures[47, "planimetry"] == pytest.approx(np.sqrt(np.mean(plane**2)))
    assert measures[28, "planimetry"] == pytest.approx(plane.mean())
    assert measures[28, "space"] == pytest.approx(np.linalg.norm(off, axis=1).mean())
    assert measures[35, "height"] == pytest.approx(1.644854 * measures[39, "h"], rel=1e-5)
    # Nine of ten points lie within the circle, but for chance.
    assert np.mean(plane <= measures[44, "planimetry"]) == pytest.approx(0.9, abs=0.1)


def test_asprs_class_includes_the_survey() -> None:
    standard = load_standard("asprs-2024")
    assert isinstance(standard, ValueStandard)
    generator = np.random.default_rng(8)
    d = Discrepancies(tuple(f"P{i}" for i in range(40)), generator.normal(0.0, 0.03, (40, 3)))
    bare = assess(d, (standard,), Question()).values[0]
    full = assess(d, (standard,), Question(survey_horizontal_m=0.02, survey_vertical_m=0.04)).values[0]
    assert bare.horizontal_m is not None
    assert bare.vertical_m is not None
    assert full.horizontal_m == pytest.approx(math.hypot(bare.horizontal_m, 0.02))
    assert full.vertical_m == pytest.approx(math.hypot(bare.vertical_m, 0.04))
    assert full.spatial_m == pytest.approx(math.hypot(full.horizontal_m or 0.0, full.vertical_m or 0.0))
    assert full.enough_points
    # Without a target nothing goes by it.
    assert (full.survey_too_coarse, full.systematic, full.blunders) == ((), (), ())
    assert value_class(standard, None, None, Question()).horizontal_m is None


# Edition 2, table 7.4: vertical, survey 2.0 cm; fit and product in cm.
TABLE_7_4 = dict(
    zip(
        (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 8.0, 8.5, 9.0, 9.5, 10.0),
        (
            *(2.24, 2.50, 2.83, 3.20, 3.61, 4.03, 4.47, 4.92, 5.39, 5.85),
            *(6.32, 6.80, 7.28, 7.76, 8.25, 8.73, 9.22, 9.71, 10.20),
        ),
        strict=True,
    )
)


def asprs() -> ValueStandard:
    standard = load_standard("asprs-2024")
    assert isinstance(standard, ValueStandard)
    return standard


def of_rmse(*rmse_cm: float) -> Sample:
    """Thirty points, half of them on either side: no mean, and these RMSE."""
    signs = np.tile([1.0, -1.0], 15)
    turned = np.repeat([1.0, -1.0], 15)
    return sample(np.column_stack([s * r / 100.0 for s, r in zip((signs, turned), rmse_cm, strict=False)]))


def test_asprs_vertical_class_of_table_7_4() -> None:
    for fit_cm, product_cm in TABLE_7_4.items():
        value = value_class(asprs(), None, of_rmse(fit_cm), Question(survey_vertical_m=0.02))
        assert value.vertical_m is not None
        assert 100.0 * value.vertical_m == pytest.approx(product_cm, abs=0.005)


def test_asprs_horizontal_class_takes_the_radial_survey() -> None:
    """Fit 4 and 3 cm, survey 1 cm an axis: 5.196 cm, which misses 5; in space with 2.236: 5.657."""
    stated = Question(
        survey_horizontal_m=math.sqrt(2.0) * 0.01, survey_vertical_m=0.02, target_horizontal_m=0.05
    )
    value = value_class(asprs(), of_rmse(4.0, 3.0), of_rmse(1.0), stated)
    assert value.horizontal_m == pytest.approx(0.05196152, abs=1e-8)
    assert value.vertical_m == pytest.approx(0.02236068, abs=1e-8)
    assert value.spatial_m == pytest.approx(0.05656854, abs=1e-8)


@pytest.mark.parametrize(("error_cm", "flagged"), [(10.60, False), (10.61, True)])
def test_asprs_blunder_of_an_axis(error_cm: float, flagged: bool) -> None:
    errors = {"E": (("P1", "P2"), np.array([0.0, -error_cm / 100.0]))}
    value = value_class(asprs(), of_rmse(3.0, 3.0), None, Question(target_horizontal_m=0.05), errors)
    assert value.blunders == ((("P2", "E"),) if flagged else ())


@pytest.mark.parametrize(("error_cm", "flagged"), [(14.9, False), (15.1, True)])
def test_asprs_blunder_of_a_height(error_cm: float, flagged: bool) -> None:
    errors = {"h": (("P1",), np.array([error_cm / 100.0]))}
    value = value_class(asprs(), None, of_rmse(3.0), Question(target_vertical_m=0.05), errors)
    assert bool(value.blunders) == flagged


@pytest.mark.parametrize(("mean_cm", "flagged"), [(1.24, False), (1.26, True)])
def test_asprs_mean_goes_by_the_target(mean_cm: float, flagged: bool) -> None:
    height = sample(np.full((30, 1), mean_cm / 100.0) + 1e-9 * np.arange(30)[:, None])
    value = value_class(asprs(), None, height, Question(target_vertical_m=0.05))
    assert value.systematic == (("h",) if flagged else ())


def test_asprs_survey_goes_by_the_target() -> None:
    """Fit 1 cm and survey 2 cm are no fault for a class of 5 cm, but for one of 3."""
    for target, coarse in ((0.05, ()), (0.03, ("vertical",))):
        stated = Question(survey_vertical_m=0.02, target_vertical_m=target)
        assert value_class(asprs(), None, of_rmse(1.0), stated).survey_too_coarse == coarse


@pytest.mark.parametrize(
    ("points", "target", "code"),
    [(30, 0.05, "target-met"), (29, 0.05, "target-met-reduced"), (30, 0.01, "target-missed")],
)
def test_asprs_statement(points: int, target: float, code: str) -> None:
    d = np.full((points, 3), np.nan)
    d[:, 2] = 0.03 * np.where(np.arange(points) % 2, 1.0, -1.0)
    question = Question(survey_vertical_m=0.01, target_vertical_m=target)
    said = findings(assess(Discrepancies(tuple(f"P{i}" for i in range(points)), d), (asprs(),), question))
    (one,) = [finding for finding in said if finding.code.startswith("target")]
    assert one.code == code
    assert f"{points} check points" in english(one)


def test_class_is_the_value_reached() -> None:
    assert class_cm(0.123) == 12.3
    assert class_cm(0.12301) == 12.4


def test_nine_points_are_called_a_small_sample() -> None:
    d = Discrepancies(tuple("abcdefghi"), np.random.default_rng(0).normal(0.0, 0.1, (9, 3)))
    said = findings(assess(d, STANDARDS, Question()))
    small = [english(finding) for finding in said if finding.code == "small-sample"]
    assert len(small) == 1
    assert small[0].startswith("E, N, h: small sample")
    assert "between 0.68 and 1.92 times" in small[0]
    assert "too-few-check-points" in codes(said)


def test_a_single_check_point_is_judged_without_tests() -> None:
    d = Discrepancies(("A",), np.array([[0.1, 0.2, -0.3]]))
    result = assess(d, STANDARDS, Question(1000.0, 1.0))
    assert codes(findings(result))[0] == "single-check-point"
    assert of_table(result, "decree-89817", "planimetry").accuracy_class == "A"
    assert of_table(result, "decree-89817", "planimetry").precision_class is None
    json.dumps(to_json(result), allow_nan=False)
    assert "-" in to_text(result)


def test_only_heights() -> None:
    d = Discrepancies(("A", "B", "C"), np.array([[np.nan, np.nan, h] for h in (0.1, -0.2, 0.15)]))
    result = assess(d, STANDARDS, Question(1000.0, 1.0))
    assert [component.name for component in result.components] == ["h"]
    assert result.plane is None
    assert {table.table.component for table in result.tables} == {"height"}
    json.dumps(to_json(result), allow_nan=False)


@pytest.mark.parametrize(
    "question",
    [Question(-1000.0), Question(0.0), Question(interval_m=math.nan), Question(survey_vertical_m=-0.01)],
)
def test_impossible_questions_are_refused(question: Question) -> None:
    with pytest.raises(ConfigurationError, match="not a positive number"):
        assess(Discrepancies(("A",), np.zeros((1, 3))), STANDARDS, question)


cells = st.one_of(st.floats(-5.0, 5.0), st.just(math.nan), st.just(0.0))
tables = st.lists(st.tuples(cells, cells, cells), min_size=1, max_size=12).map(np.array)


@settings(max_examples=40)
@given(tables)
def test_every_table_has_text_and_valid_json(d: FloatArray) -> None:
    if not np.isfinite(d).any():
        return
    names = tuple(f"P{i}" for i in range(len(d)))
    result = assess(Discrepancies(names, d), STANDARDS, Question(2000.0))
    json.dumps(to_json(result), allow_nan=False)
    assert to_text(result).startswith(f"{len(d)} check points; discrepancies are product minus reference")


@settings(max_examples=20)
@given(st.permutations(range(8)))
def test_the_order_of_the_points_does_not_matter(order: list[int]) -> None:
    d = np.random.default_rng(12).normal(0.1, 0.2, (8, 3))
    names = tuple(f"P{i}" for i in range(8))
    straight = to_json(assess(Discrepancies(names, d), STANDARDS, Question(1000.0)))
    turned = to_json(
        assess(Discrepancies(tuple(names[i] for i in order), d[order]), STANDARDS, Question(1000.0))
    )
    assert [entry.get("accuracy_class") for entry in turned["standards"]] == [
        entry.get("accuracy_class") for entry in straight["standards"]
    ]
    assert turned["planimetry"]["rmse_m"] == pytest.approx(straight["planimetry"]["rmse_m"])


def test_equal_discrepancies_admit_any_scale_by_precision() -> None:
    d = Discrepancies(tuple("abcd"), np.full((4, 3), 0.25))
    result = assess(d, STANDARDS, Question(1000.0, 1.0))
    assert of_table(result, "decree-89817", "planimetry").admitted[0].precision == 0.0
    assert " any " in to_text(result)
    json.dumps(to_json(result), allow_nan=False)


def test_a_chi_square_that_is_stricter_than_the_standard_is_said_to_be() -> None:
    """Without bias RMSE = EP / 1.1 passes; the chi-square of few points may still reject one component."""
    values = np.array([1.0, -1.0, 1.0, -1.0])
    d = np.column_stack((values * 0.28, values * 0.0, values * 0.0))
    result = assess(Discrepancies(tuple("abcd"), d), STANDARDS, Question(1000.0))
    plane = of_table(result, "decree-89817", "planimetry")
    assert (plane.precision_class, plane.accuracy_class) == ("B", "A")
    said = [english(finding) for finding in findings(result) if finding.code == "class-differs"]
    assert any("stricter than the standard's own rule" in text for text in said)


def test_heights_in_vegetated_ground_are_reported_and_only_those_in_open_ground_are_judged(
    tmp_path: Path,
) -> None:
    rows = ["point,dh_cm,ground"]
    rows += [f"A{i},{3.0 if i % 2 else -3.0},open" for i in range(30)]
    rows += [f"V{i},{20.0 if i % 2 else -20.0},vegetated" for i in range(10)]
    path = tmp_path / "d.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    question = Question(survey_vertical_m=0.02, target_vertical_m=0.05)
    judged = assess(read_discrepancies(path), (asprs(),), question)
    (value,) = judged.values
    assert value.vertical_m == pytest.approx(math.hypot(0.03, 0.02))
    assert value.vegetated_m == pytest.approx(math.hypot(0.20, 0.02))
    assert value.blunders == ()
    assert value.counts == (30, 10)
    said = {one.code: one for one in findings(judged)}
    assert said["target-met"].figures["n"] == 30.0
    assert "reported as found" in english(said["vva"])
    assert said["too-few-check-points"].figures["n"] == 10.0

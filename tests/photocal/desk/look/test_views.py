"""What the views say, held against the tables of the run and against geometry done another way."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from scipy.stats import norm

from photocal.block.results.adjusted_block import position_residuals
from photocal.desk.views import overview, pictures
from photocal.desk.views.plots import plots
from photocal.desk.views.shown import Shown, numbers
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue
from tests.photocal.desk.look.surveys import GROSS_IMAGE, GROSS_POINT, GROSS_PX, PLATES, POSITION_M


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def test_a_picture_shows_the_residuals_of_the_run(shown: Shown, made: Path) -> None:
    told = pictures.picture(shown, GROSS_IMAGE)
    listed = {
        row["point"]: row for row in rows(made / "work/analysis/residuals.csv") if row["image"] == GROSS_IMAGE
    }
    assert set(told["points"]) == set(listed)
    for name, place, residual in zip(told["points"], told["place"], told["residual_px"], strict=True):
        row = listed[name]
        assert place == pytest.approx([float(row["x"]), float(row["y"])], abs=0.006)
        assert residual == pytest.approx([float(row["vx"]), float(row["vy"])], abs=6e-4)


def test_the_worst_picture_of_a_point_comes_first(shown: Shown) -> None:
    told = pictures.point(shown, GROSS_POINT)
    assert told["images"][0] == GROSS_IMAGE
    # Computed minus measured: the mark lies too far right.
    assert told["residual_px"][0][0] < -0.8 * GROSS_PX
    assert told["in_sigmas"] == sorted(told["in_sigmas"], reverse=True)
    assert told["of_role"] == "control"


def test_footprints_are_where_the_pictures_see_the_ground(shown: Shown) -> None:
    rings = overview.footprints(shown)
    level = np.median(shown.result.points.values[:, 2])
    width, height = 480, 360
    corners = [(-0.5, -0.5), (width - 0.5, -0.5), (width - 0.5, height - 0.5), (-0.5, height - 0.5)]
    for k, ring in enumerate(rings):
        place = np.column_stack([ring[::2], np.full(4, level)])
        seen = shown.images.project(np.full(4, k), shown.frame.to_local(place))
        assert seen == pytest.approx(np.array(corners), abs=0.05)


def test_overlap_counts_the_footprints_over_a_place(shown: Shown) -> None:
    head, cells = overview.overlap(shown)
    count = np.frombuffer(cells, np.uint8).reshape(head["rows"], head["columns"])
    outlines = [Outline(ring) for ring in overview.footprints(shown)]
    rng = np.random.default_rng(0)
    agree = []
    for row, column in zip(
        rng.integers(0, head["rows"], 300), rng.integers(0, head["columns"], 300), strict=True
    ):
        place = np.array(head["first"]) + column * np.array(head["column"]) + row * np.array(head["row"])
        inside = sum(bool(outline.contains_point(place)) for outline in outlines)
        agree.append(int(count[row, column]) == inside)
    # Sides of footprints are bent a little by the lens: cells on them may differ.
    assert np.mean(agree) > 0.97


def test_position_residuals_are_those_of_the_adjustment(shown: Shown) -> None:
    residual, sigma, strip = position_residuals(shown.block, shown.result, shown.frame)
    (group,) = [group for group in shown.result.groups if group.name == "position"]
    assert sigma == pytest.approx(np.full((8, 3), POSITION_M))
    assert float(np.sum((residual / sigma) ** 2)) == pytest.approx(group.chi_squared, rel=1e-6)
    assert strip.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]


def test_differences_of_points_are_adjusted_less_surveyed(shown: Shown, made: Path) -> None:
    told = overview.overview(shown)["points"]
    assert sorted(told["names"]) == sorted(PLATES)
    adjusted = {row["point"]: row for row in rows(made / "work/analysis/points.csv")}
    given = {row["point"]: row for row in rows(made / "block/points.csv")}
    for name, difference, ellipse in zip(told["names"], told["difference_m"], told["ellipse"], strict=True):
        wanted = [float(adjusted[name][axis]) - float(given[name][axis]) for axis in "XYZ"]
        assert difference == pytest.approx(wanted, abs=2e-5)
        # 95 %: 2.4477 times the standard deviation along the axes, whose squares add up as sX and sY do.
        variance = sum(float(adjusted[name][f"s{axis}"]) ** 2 for axis in "XY")
        assert sum(a**2 for a in ellipse[:2]) == pytest.approx(2.4477**2 * variance, rel=2e-3)


def test_ties_are_all_there(shown: Shown) -> None:
    values = np.frombuffer(overview.ties(shown), "<f4").reshape(-1, 5)
    names = overview.tie_names(shown)
    row = shown.point_rows[names[5]]
    assert len(names) == len(values)
    wanted = shown.result.points.values[row] - overview.origin(shown)
    assert values[5, :3] == pytest.approx(wanted, abs=1e-4)
    assert values[5, 4] == shown.result.points.rays[row]


def test_plots_count_every_residual(shown: Shown) -> None:
    told = plots(shown)
    of = told["cameras"]["cam"]
    residuals = shown.result.residuals.accepted
    assert of["rays"] == sum(of["radius"]["count"]) == len(residuals)
    assert sum(of["standardised"]["count"]) == of["standardised"]["n"] == 2 * len(residuals)
    # Within one standard deviation, by the table of the normal distribution.
    edges, expected = np.array(of["standardised"]["edges"]), np.array(of["standardised"]["expected"])
    middle = (edges[1:] + edges[:-1]) / 2
    inside = expected[np.abs(middle) < 1.0].sum() / of["standardised"]["n"]
    assert inside == pytest.approx(norm.cdf(1.0) - norm.cdf(-1.0), abs=1e-4)
    rays = told["rays_per_point"]
    ties = np.array(shown.result.points.role) == "tie"
    assert sum(rays["points"]) == ties.sum()
    assert np.dot(rays["rays"], rays["points"]) == shown.result.points.rays[ties].sum()
    matrix = np.array(of["correlation"]["matrix"])
    assert np.diag(matrix) == pytest.approx(1.0)


def test_the_lens_is_drawn_as_its_equation_says(shown: Shown) -> None:
    of = plots(shown)["cameras"]["cam"]["distortion"]
    camera = shown.result.cameras["cam"]
    k1 = camera.value("K1")
    # Brown (1971): the radial displacement is K1 r^3; in the grid x and y have their parts of it.
    assert of["radial_px"] == pytest.approx(k1 * np.array(of["radius_px"]) ** 3, rel=2e-3, abs=2e-3)
    for column, row, u, v in of["grid"]:
        at = np.array([column, row]) - of["principal_px"]
        radius = float(np.hypot(*at))
        assert np.hypot(u, v) == pytest.approx(abs(k1) * radius**3, rel=0.05, abs=0.02)


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_findings_are_told_worst_first_with_what_they_concern(shown: Shown, language: str) -> None:
    told = overview.findings(shown, catalogue(language))
    kinds = [line["kind"] for line in told["lines"]]
    assert kinds == sorted(kinds, key=["bad", "warn", "note"].index)
    control = [line for line in told["lines"] if line["code"] == "control-outside-prediction"]
    # Once for each point, with all methods that it does not fit.
    points = [point for line in control for point in line["concerns"]["points"]]
    assert GROSS_POINT in points
    assert len(points) == len(set(points))
    assert all(line["remedy"] and line["remedy"] not in line["text"] for line in control)
    assert told["paragraph"]


def test_a_mark_is_seen_through_its_picture_and_its_point(shown: Shown) -> None:
    for subject, figures in (
        ("P5 (p2.png)", {"point": "P5", "image": "p2.png"}),
        ("P5 (p2.png)", {}),
        ("P5", {"image": "p2.png"}),
    ):
        told = overview.concerns([Finding("mark-off", "doubtful", subject, figures)], shown)
        assert told["observations"] == [["p2.png", "P5"]]
        assert told["images"] == ["p2.png"]
        assert told["points"] == ["P5"]


def test_parameters_are_no_points_of_the_same_name(shown: Shown) -> None:
    finding = Finding("prior-contradicted", "doubtful", "cam K1", {"camera": "cam", "parameter": "P1"})
    told = overview.concerns([finding], shown)
    assert told["points"] == []
    assert told["parameters"] == [["cam", "K1"], ["cam", "P1"]]


def test_what_is_no_number_is_null() -> None:
    assert numbers(np.array([[1.23456, np.nan], [np.inf, -2.0]]), 2) == [[1.23, None], [None, -2.0]]

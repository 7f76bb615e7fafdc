"""Laser distances as observations, on simulated flights over trees and fields with known truth."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.adjustment.factored import covariance_column
from photocal.analysis.lasers import of_lasers
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.project import read_project
from photocal.block.writer import write_block
from photocal.findings.texts import catalogue, finding_text, plain
from photocal.run import laser_distances
from photocal.run.laser_distances import with_lasers
from tests.photocal.canopies import OFFSET_M, SCALE, C, Canopy, fly
from tests.photocal.conftest import Answer

# A gimbal that hardly moves, over a field: c goes with the heights.
over_a_field = partial(fly, gaps=0.1, tall=0.05, tilt_deg=0.2)
# As a receiver without corrections places pictures: heights and scale go with it.
SINGLE_M = (1.5, 1.5, 3.0)


def height(block: Block, at: AdjustedNetwork, truth: Canopy, *, flying: bool) -> tuple[float, float]:
    """Mean height of all points, or of the images above them: its error and standard deviation, m."""
    solution, layout = at.solution, at.factored.problem.layout
    sign, n = (-1.0 if flying else 1.0), len(solution.points)
    points, reduced = np.zeros_like(solution.points), np.zeros(layout.size)
    points[:, 2] = sign / n
    columns = layout.image_columns[:, 5]
    reduced[columns] = flying / len(columns)
    reduced[layout.point_columns] += points[layout.kept_points]
    steps, moved = covariance_column(at.factored, reduced.copy(), points.copy())
    eliminated = np.setdiff1d(np.arange(n), layout.kept_points)
    variance = reduced @ steps + np.sum((points * moved)[eliminated])
    found = sign * solution.points[:, 2].mean() + flying * solution.state.centre[:, 2].mean()
    middle = 0.0 if flying else assemble(block).frame.to_given(np.zeros((1, 3)))[0, 2]
    true = sign * truth.points[:, 2].mean() + flying * truth.centre[:, 2].mean()
    return float(found + middle - true), float(np.sqrt(variance))


def adjusted_both(truth: Canopy) -> tuple[tuple[Block, AdjustedNetwork], tuple[Block, AdjustedNetwork]]:
    """The block without and with its laser distances."""
    ranged, _ = with_lasers(truth.block, truth.facts)
    return tuple((block, fit(assemble(block).network)) for block in (truth.block, ranged))  # type: ignore[return-value]


def test_heights_over_a_field_become_as_good_as_the_laser() -> None:
    """Closed form: what the laser knows of the mean height is offset, scale, and the mean of its shots."""
    for seed in range(4):
        truth = over_a_field(seed)
        (plain_block, before), (block, after) = adjusted_both(truth)
        (_, old), (error, new) = (
            height(one, at, truth, flying=False) for one, at in ((plain_block, before), (block, after))
        )
        assert abs(error) < 3 * new
        of_shots = np.median(block.lasers.sigma) / np.sqrt(len(block.lasers.image))
        laser = np.sqrt(OFFSET_M**2 + (SCALE * np.median(block.lasers.values)) ** 2 + of_shots**2)
        assert new == pytest.approx((old**-2 + laser**-2) ** -0.5, rel=0.05)
        assert new < 0.3 * old
        sigma_c = [float(np.sqrt(at.solution.camera_covariance[0, 0, 0])) for at in (before, after)]
        assert abs(after.solution.cameras[0, 0] - C) < 3 * sigma_c[1]
        assert sigma_c[1] < 0.45 * sigma_c[0]


def test_without_corrections_the_laser_gives_the_scale() -> None:
    for seed in range(3):
        truth = fly(seed, sigma_m=SINGLE_M)
        (plain_block, before), (block, after) = adjusted_both(truth)
        (_, old), (error, new) = (
            height(one, at, truth, flying=True) for one, at in ((plain_block, before), (block, after))
        )
        assert abs(error) < 3 * new
        assert new < 0.25 * old
        assert abs(after.solution.cameras[0, 0] - C) < 3 * np.sqrt(after.solution.camera_covariance[0, 0, 0])


def test_no_false_alarm_over_twenty_canopies() -> None:
    refuted, wrongly, statistics = 0, 0, []
    for seed in range(20):
        truth = fly(seed)
        block, said = with_lasers(truth.block, truth.facts)
        (found,) = of_lasers(fit(assemble(block).network))
        refuted += "laser-refuted" in found.clauses
        statistics.append(found.figures["bias_m"] / found.figures["sigma_m"])
        # What fell by less than the crowns are rough may stay.
        wrongly += len(set(said.figures["images"]) - truth.gaps)
        assert len(truth.gaps - set(said.figures["images"])) <= 3
    assert refuted == 0
    # Of some 1080 shots, by four sigmas of a surface that eight points tell.
    assert wrongly <= 2
    # Their own standard deviation is what they scatter by: 95 % of chi-squared of 20.
    assert 9.59 < np.sum(np.square(statistics)) < 34.17


@pytest.mark.parametrize("bias_m", [0.5, -0.5])
def test_half_a_metre_is_named_and_not_absorbed(bias_m: float) -> None:
    named, biases = 0, []
    for seed in range(6):
        truth = fly(100 + seed, bias_m)
        block, _ = with_lasers(truth.block, truth.facts)
        at = fit(assemble(block).network)
        (found,) = of_lasers(at)
        named += "laser-refuted" in found.clauses and found.severity == "doubtful"
        biases.append(found.figures["bias_m"])
    # A bias of 0.5 m with a standard deviation of 0.09 m is missed once in 80 times.
    assert named >= 5
    assert np.mean(biases) == pytest.approx(bias_m, abs=3 * 0.09 / np.sqrt(6))
    for language, words in (("en", "more than laser and block"), ("pt-BR", "mais do que laser e bloco")):
        assert words in finding_text(found, catalogue(language), plain)


def test_a_shot_that_hit_something_else_is_named() -> None:
    """One that came in unseen, such as by hand, 2 m too long."""
    truth = fly(3, gaps=0.0)
    block, _ = with_lasers(truth.block, truth.facts)
    values = block.lasers.values.copy()
    values[7] += 2.0
    block = replace(block, lasers=replace(block.lasers, values=values))
    (found,) = of_lasers(fit(assemble(block).network))
    assert found.figures["images"] == (block.images.names[block.lasers.image[7]],)
    assert found.clauses == ("laser-off",)


def test_few_shots_change_nothing() -> None:
    truth = fly(1)
    block, found = with_lasers(truth.block, truth.facts[:7])
    assert (found.severity, found.cause, len(block.lasers.image)) == ("untested", "few-laser-shots", 0)
    block, found = with_lasers(truth.block, [replace(fact, laser_m=np.nan) for fact in truth.facts])
    assert found.figures["n"] == 0.0


def test_no_more_of_them_than_help(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laser_distances, "MOST_SHOTS", 20)
    truth = fly(2)
    block, found = with_lasers(truth.block, truth.facts)
    assert len(block.lasers.image) == 20
    assert found.figures["spare"] + found.figures["elsewhere"] + found.figures["lonely"] == 34.0
    assert "laser-spare" in found.clauses


def test_a_block_without_a_scale_gets_that_of_the_laser() -> None:
    """Five times too large at the start, and free."""
    truth = fly(4)
    given, count = truth.block, len(truth.block.images.names)
    values = given.images.values * np.repeat([1.0, 5.0], 3)
    free = replace(
        given,
        datum="free",
        images=replace(given.images, values=values, sigma=np.full((count, 6), np.inf)),
        points=replace(given.points, values=5.0 * given.points.values),
    )
    block, _ = with_lasers(free, truth.facts)
    at = fit(assemble(block).network)
    assert at.solution.datum_defect == 6
    centre = at.solution.state.centre
    flown = centre[:, 2].mean() - at.solution.points[:, 2].mean()
    assert flown == pytest.approx(truth.centre[:, 2].mean() - truth.points[:, 2].mean(), abs=0.3)


def test_a_block_folder_keeps_them(tmp_path: Path) -> None:
    truth = fly(5)
    block, _ = with_lasers(truth.block, truth.facts)
    write_block(tmp_path, block)
    again = read_block(tmp_path)
    assert "laser_distances.csv" in [file.path for file in again.inputs]
    for name in ("image", "corners", "values", "sigma"):
        assert np.array_equal(getattr(again.lasers, name), getattr(block.lasers, name))
    assert again.lasers.common_sigma == block.lasers.common_sigma
    text = (tmp_path / "block.toml").read_text(encoding="utf-8")
    (tmp_path / "block.toml").write_text(text[: text.index("[laser]")], encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"laser_distances.csv needs"):
        read_block(tmp_path)
    write_block(tmp_path, truth.block)
    assert not (tmp_path / "laser_distances.csv").exists()


@pytest.mark.parametrize(
    ("column", "cell", "words"),
    [
        ("second", "t999999", "t999999"),
        ("image", "nothing.jpg", "nothing.jpg"),
        ("value", "-3", "not positive"),
        ("sigma", "0", "not positive"),
        ("third", "first", "the same point"),
    ],
)
def test_wrong_cells_are_named_with_their_line(tmp_path: Path, column: str, cell: str, words: str) -> None:
    truth = fly(5)
    block, _ = with_lasers(truth.block, truth.facts)
    write_block(tmp_path, block)
    path = tmp_path / "laser_distances.csv"
    with path.open(encoding="utf-8") as rows:
        table = list(csv.DictReader(rows))
    table[3][column] = table[3].get(cell, cell)
    with path.open("w", encoding="utf-8", newline="") as rows:
        writer = csv.DictWriter(rows, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    with pytest.raises(InputMalformedError, match=words) as refused:
        read_block(tmp_path)
    assert "line 5" in str(refused.value)


PROJECT = """
[project]
name = "canopy"
crs = "local"
height = "local"
output = "work"
[images]
folder = "pictures"
{laser}
[measurements]
block = "block"
"""


def written(folder: Path, truth: Canopy, laser: str) -> Path:
    """Write a project of a ready block, with small pictures that state their laser distances."""
    (folder / "pictures").mkdir(parents=True)
    for fact in truth.facts:
        packet = f'<rdf:Description drone-dji:LRFTargetDistance="{fact.laser_m}"/>'
        Image.new("L", (40, 30)).save(folder / "pictures" / fact.name, xmp=packet.encode())
    write_block(folder / "block", truth.block)
    (folder / "project.toml").write_text(PROJECT.format(laser=laser), encoding="utf-8")
    return folder / "project.toml"


def test_the_option_through_the_command(tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    truth = over_a_field(6)
    results = {}
    for name, laser in (("default", ""), ("check", 'laser = "check"'), ("used", 'laser = "observation"')):
        project = written(tmp_path / name, truth, laser)
        said = photocal("run", project)
        assert said.code == 0, said.err
        work = project.parent / "work"
        results[name] = json.loads((work / "calibration" / "result.json").read_text(encoding="utf-8"))
    used, checked = results["used"], results["check"]
    # Without the option all is as it was.
    assert json.dumps(results["default"]) == json.dumps(checked)
    assert "lasers" not in checked
    tables = ("images.csv", "points.csv", "residuals.csv", "covariance.parquet")
    for table in tables:
        ours, theirs = (
            next((tmp_path / name / "work" / "calibration").glob(table.split(".")[0] + ".*")).read_bytes()
            for name in ("default", "check")
        )
        assert ours == theirs
    groups = {group["name"]: group for group in used["groups"]}
    assert groups["laser"]["observations"] == len(used["lasers"]["shots"])
    assert 0.9 * groups["laser"]["observations"] < groups["laser"]["redundancy"]
    shares = [shot["redundancy"] for shot in used["lasers"]["shots"]]
    assert groups["laser"]["redundancy"] == pytest.approx(sum(shares))
    for shot in used["lasers"]["shots"]:
        w = shot["residual"] / (shot["sigma"] * shot["redundancy"] ** 0.5)
        assert shot["w"] == pytest.approx(w)
    sigma = [r["cameras"]["h20t"]["parameters"]["c"]["sigma"] for r in (checked, used)]
    assert sigma[1] < 0.45 * sigma[0]
    work = tmp_path / "used" / "work"
    told = json.loads((work / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    (found,) = [one for one in told["findings"] if one["code"] == "laser-offset"]
    assert found["severity"] == "note"
    listed = json.loads((work / "block" / "findings.json").read_text(encoding="utf-8"))["findings"]
    assert [one["code"] for one in listed] == ["laser-observations"]
    page = (work / "certificate" / "certificate.html").read_text(encoding="utf-8")
    assert "laser distances are observations" in page
    assert ">laser distances<" in page
    said = photocal("verify", work / "certificate", "--json")
    assert json.loads(said.out)["verified"] is True, said.err


def test_the_option_needs_pictures(tmp_path: Path) -> None:
    path = tmp_path / "project.toml"
    text = PROJECT.format(laser='laser = "observation"').replace('folder = "pictures"', 'times = "t.csv"')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="needs pictures"):
        read_project(path)

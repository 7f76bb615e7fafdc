"""Certificates of analysed runs: findings, significance, method and warnings in both languages."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.analyse_run import analyse_run, exterior_difference
from photocal.block.folder import read_block
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.folder import read_result
from photocal.findings.document import (
    Document,
    KeyValues,
    Paragraph,
    Remarks,
    Signature,
    Statement,
    TablePart,
    html,
)
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import Metadata, read_particulars
from photocal.report.derived_figures import derived_figures
from photocal.report.issue import record
from photocal.report.ministry_rows import Context, entries, read_layout
from photocal.report.stored_analysis import AnalysedRun, read_run
from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.report.conftest import DAY

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> AnalysedRun:
    folder = tmp_path_factory.mktemp("analysed") / "run"
    adjust_block(DEMO, folder)
    analyse_run(folder, DEMO)
    return read_run(folder)


def test_a_certificate_without_an_analysis_says_so(analysed: AnalysedRun) -> None:
    """What nobody looked for is a reservation, on the page and in the record."""
    bare, say = replace(analysed, analysis=None), catalogue("en")
    particulars = read_particulars(None, DAY)
    first = certificate(bare, particulars, say).verdicts[0]
    assert any(line.startswith("No analysis") for line in first.lines)
    assert record(bare, particulars, say)["verdict"]["code"] != "usable"
    assert not any(
        "No analysis" in line for line in certificate(analysed, particulars, say).verdicts[0].lines
    )


def words(document: Document) -> str:
    """Everything that is printed."""
    said = [piece.text for piece in document.verdicts]
    for section in document.sections:
        said.append(section.title)
        for piece in section.pieces:
            if isinstance(piece, Paragraph | Statement):
                said.append(piece.text)
            elif isinstance(piece, TablePart):
                said += [cell for row in piece.rows for cell in row]
                assert all(len(row) == len(piece.columns) for row in piece.rows), piece.caption
            elif isinstance(piece, Remarks):
                said += piece.texts
            elif isinstance(piece, KeyValues):
                said += [f"{label} {value}" for label, value in piece.rows]
            elif not isinstance(piece, Signature):
                said.append(piece.caption)
    return "\n".join(said)


@pytest.mark.parametrize(
    ("language", "expected"),
    [
        (
            "en",
            ("y scale factor 0.9980", "the pixels are square", "K₃ is not significant once corrected",
             "powers of the same radius", "Images left out", "convergent cameras"),
        ),
        (
            "pt-BR",
            ("fator de escala em y 0,9980", "os pixels são quadrados", "K₃ não é significativo após",
             "potências do mesmo raio", "câmeras convergentes"),
        ),
    ],
)  # fmt: skip
def test_what_was_found_is_printed(analysed: AnalysedRun, language: str, expected: tuple[str, ...]) -> None:
    document = certificate(analysed, read_particulars(None, DAY), catalogue(language))
    said = words(document)
    for text in expected[: 4 if language == "en" else None]:
        assert text in said
    # Hidden errors that are not small stand at the head.
    assert any(expected[0] in line for line in document.verdicts[0].lines)
    assert expected[0] in html(document)


def test_without_analysis_it_is_said(analysed: AnalysedRun) -> None:
    bare = AnalysedRun(analysed.result, analysed.files)
    document = certificate(bare, read_particulars(None, DAY), catalogue("en"))
    assert "was not analysed" in words(document)


def test_warnings_reach_every_form(analysed: AnalysedRun) -> None:
    given, say = read_particulars(None, DAY), catalogue("en")
    fixed = {"percent": 62.0, "n_float": 9.0, "n_single": 0.0}
    told = (Finding("ppk-not-fixed", "doubtful", figures=fixed), Finding("one-height", "note"))
    warned = certificate(analysed, given, say, told)
    # It is a line of the verdict, which it takes part in.
    assert any("62.0 % of the epochs" in line for line in warned.verdicts[0].lines)
    assert html(warned).replace("\u00a0", " ").count("62.0 % of the epochs") == 1
    assert warned.number != certificate(analysed, given, say).number
    plain = record(analysed, given, say, told)
    assert [one["code"] for one in plain["warnings"]] == ["ppk-not-fixed"]
    assert "62.0 % of the epochs" in plain["warnings"][0]["text"]
    assert [one["code"] for one in plain["notes"]] == ["one-height"]
    json.dumps(plain, allow_nan=False)


def test_a_parameter_is_as_significant_as_its_largest_standard_deviation_lets_it(
    analysed: AnalysedRun,
) -> None:
    """With images left out P1 spreads 40 times, P2 1.2 times as much as the adjustment says."""
    camera = analysed.result.cameras["dcs460"]
    assert analysed.analysis is not None
    assert analysed.result.scale is None
    formal = {name: camera.sigma_of(name) for name in camera.free}
    spread = formal | {"P1": 40.0 * formal["P1"], "P2": 1.2 * formal["P2"]}
    unknown = dict.fromkeys(formal, float("nan"))
    opinions = replace(
        analysed.analysis.jackknife["dcs460"], standard_error=spread, sandwich=unknown, bootstrap=None,
        not_possible=(),
    )  # fmt: skip
    run = replace(analysed, analysis=replace(analysed.analysis, jackknife={"dcs460": opinions}))
    tables = [
        p for s in certificate(run, read_particulars(None, DAY), catalogue("en")).sections for p in s.pieces
    ]
    table = next(
        p for p in tables if isinstance(p, TablePart) and p.caption.startswith("Interior orientation p")
    )
    heads = [column.head for column in table.columns]
    assert heads[3:5] == ["Std. dev.", "Images left out"]
    rows = {row[0]: dict(zip(heads, row, strict=True)) for row in table.rows}
    for name, sigma in (("P₁", 40.0 * formal["P1"]), ("P₂", formal["P2"])):
        t = camera.value(name.translate({0x2081: "1", 0x2082: "2"})) / sigma
        assert float(rows[name]["t"].replace("−", "-")) == pytest.approx(t, abs=0.051)
        assert rows[name]["Significant"] == ("yes" if abs(t) > 1.97 else "no")
    assert rows["P₁"]["Significant"] == "no"
    assert rows["P₂"]["Images left out"] == "–"


def test_what_the_sides_of_a_pixel_do_is_said_once(analysed: AnalysedRun, tmp_path: Path) -> None:
    """The analysis measures the wrong scale of y; where B1 takes it, nothing is left to say of the sides."""
    text = (DEMO / "block.toml").read_text(encoding="utf-8")
    with_b1 = Path(shutil.copytree(DEMO, tmp_path / "block"))
    (with_b1 / "block.toml").write_text(text.replace('"P2"]', '"P2", "B1"]'), encoding="utf-8")
    adjust_block(with_b1, tmp_path / "run")
    estimated = read_run(tmp_path / "run")
    assert "B1" in estimated.result.cameras["dcs460"].free
    for run, times in ((analysed, 0), (estimated, 0), (replace(analysed, analysis=None), 1)):
        found = [one.code for one in derived_figures(run, "dcs460", Metadata(date=DAY)).findings]
        assert found.count("pitch_not_square") == times
    assert analysed.analysis is not None
    assert "y-scale" in [one.code for one in analysed.analysis.findings]


def test_a_limit_of_the_flight_is_no_warning(analysed: AnalysedRun) -> None:
    given, say = read_particulars(None, DAY), catalogue("en")
    noted = certificate(analysed, given, say, (Finding("one-height", "note"),))
    assert noted.verdicts == certificate(analysed, given, say).verdicts
    assert "One flying height" in words(noted)


def test_table_3_is_original_less_adjusted(tmp_path: Path) -> None:
    """Without lever arm the antenna is the camera: against the two tables, subtracted by hand."""
    folder = fly(tmp_path / "flight", np.random.default_rng(3), plan=Plan(tie=40))
    adjust_block(folder, tmp_path / "run")
    found = exterior_difference(read_block(folder), read_result(tmp_path / "run"))
    assert found is not None
    tables = []
    for path in (folder / "positions.csv", tmp_path / "run" / "images.csv"):
        with path.open(encoding="utf-8", newline="") as stream:
            rows = {row["image"]: [float(row[axis]) for axis in "XYZ"] for row in csv.DictReader(stream)}
        tables.append(np.array([rows[name] for name in sorted(rows)]))
    d = tables[0] - tables[1]
    assert found.images == len(d)
    np.testing.assert_allclose(found.mean_m, d.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(found.rmse_m, np.sqrt(np.mean(d**2, axis=0)), atol=1e-6)
    # Attitudes with noise of 0.03 degrees; their residuals are a little smaller.
    assert np.all(np.array(found.rmse_arcsec) < 0.03 * 3600.0 * 1.2)
    assert np.all(np.array(found.rmse_arcsec) > 0.03 * 3600.0 * 0.4)


def test_offsets_and_table_3_come_from_the_run(tmp_path: Path) -> None:
    mounting = "lever_arm_m = [0.0, 0.0, 0.0]\nlever_arm_sigma_m = 0.05"
    fly(tmp_path / "flight", np.random.default_rng(3), plan=Plan(tie=40, mounting=mounting))
    adjust_block(tmp_path / "flight", tmp_path / "run")
    analyse_run(tmp_path / "run", tmp_path / "flight")
    run, given, say = read_run(tmp_path / "run"), read_particulars(None, DAY), catalogue("en")
    rows = {
        entry["key"]: entry
        for entry in entries(read_layout(), Context(run, given, derived_figures(run, "cam", given), say))
    }
    assert rows["lever_arm"]["origin"] == rows["eo_quality"]["origin"] == "computed"
    assert rows["lever_arm"]["value"].startswith("dX")
    assert rows["boresight"]["origin"] == "not_determined"
    assert rows["eo_quality"]["value"].startswith("RMSE X 0.0")

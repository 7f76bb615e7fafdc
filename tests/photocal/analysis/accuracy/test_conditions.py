"""A class stands with what it rests on, on one line, wherever it is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.analysis.accuracy.assessment import assess
from photocal.analysis.accuracy.discrepancies import Discrepancies
from photocal.analysis.accuracy.output import to_json, to_text
from photocal.analysis.accuracy.standard import Question, load_standard
from photocal.commands.cli import app
from tests.evidence.judging import fly
from tests.independent.faults import BASE
from tests.independent.flights import CHECK_M, Errors

FEW = "3 of 30 check points: stated, not tested"


@pytest.mark.parametrize(
    ("points", "survey_m", "said"),
    [
        (3, 0.01, f"({FEW})"),
        (29, 0.01, "(29 of 30 check points: stated, not tested)"),
        (30, 0.01, "(30 check points: tested)"),
        (3, None, f"({FEW}, without the accuracy of the survey)"),
    ],
)
def test_of_a_product(points: int, survey_m: float | None, said: str) -> None:
    d = np.tile([[0.03, 0.0, 0.04], [-0.03, 0.0, -0.04]], (points, 1))[:points]
    question = Question(survey_horizontal_m=survey_m, survey_vertical_m=survey_m)
    judged = assess(
        Discrepancies(tuple(f"P{k}" for k in range(points)), d), (load_standard("asprs-2024"),), question
    )
    line = next(line for line in to_text(judged).splitlines() if " cm" in line and "horizontal" in line)
    assert line.endswith(said)
    assert f"({to_json(judged)['standards'][0]['condition']})" == said


def test_of_a_block(tmp_path: Path) -> None:
    """Screen, report.md and JSON; the survey's own sigma stands beside the errors."""
    folder = fly(tmp_path / "block", BASE, Errors(), 1).folder
    asked = ["check", str(folder), "-o", str(tmp_path / "out"), "--standard", "asprs-2024", "--json"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    integrated = json.loads(done.stdout)["methods"]["integrated"]
    condition = "12 of 30 check points: stated, not tested, without the accuracy of the survey"
    assert integrated["assessment"]["standards"][0]["condition"] == condition
    assert list(integrated["check"]["survey_m"].values()) == pytest.approx(CHECK_M)
    shown = CliRunner().invoke(app, [*asked[:2], "--standard", "asprs-2024"]).output
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    for text in (shown, report):
        line = next(line for line in text.splitlines() if "class reached" in line)
        assert line.count(condition) == line.count("horizontal") == 3
    row = next(line for line in report.splitlines() if "integrated" in line and "check" in line)
    assert [float(cell) for cell in row.split("|")[-5:-2]] == pytest.approx(CHECK_M)


def test_of_assumed_sigmas_no_test_is_made_and_that_is_said(tmp_path: Path) -> None:
    folder = fly(tmp_path / "block", BASE, Errors(), 1).folder
    setup = folder / "block.toml"
    setup.write_text(
        setup.read_text(encoding="utf-8").replace(
            'datum = "control"', 'datum = "control"\nglobal_test = "none"'
        ),
        encoding="utf-8",
    )
    assert "standard deviations that are assumed" in CliRunner().invoke(app, ["check", str(folder)]).output
    done = CliRunner().invoke(app, ["check", str(folder), "--json"])
    assert json.loads(done.stdout)["methods"]["integrated"]["global_test"] is None

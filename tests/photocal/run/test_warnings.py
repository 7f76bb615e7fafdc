"""Findings of the stages in one list."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import photocal
from photocal.analysis.analyse_run import analyse_run
from photocal.analysis.georeferencing.output import to_json
from photocal.base.errors import InputMalformedError
from photocal.findings.document import text
from photocal.findings.finding import Finding, Severity
from photocal.findings.texts import catalogue, finding_text
from photocal.findings.verdict import every_line
from photocal.hypotheses.faults import FAULTS
from photocal.report.analysis_sections import analysed, hidden_errors
from photocal.report.stored_analysis import read_run
from photocal.run.summary import gather, kind, project_findings
from tests.evidence.judging import fly
from tests.independent.faults import ROLLING
from tests.independent.flights import Errors

PPK = {"fixed_percent": 100.0, "findings": []}
FILES = {"ppk": "ppk.json", "exposures": "exposures.json", "measurements": "measurement.json"}
FILES |= {"georeferencing": "check.json", "analysis": "analysis.json"}


def told(*codes: str, severity: Severity = "doubtful") -> dict[str, Any]:
    return {"findings": [vars(Finding(code, severity)) for code in codes]}


def gathered(work: Path, **stages: dict[str, Any]) -> tuple[Finding, ...]:
    for stage, content in stages.items():
        (work / stage).mkdir(exist_ok=True, parents=True)
        (work / stage / FILES[stage]).write_text(json.dumps(content), encoding="utf-8")
    return gather(work)


def kinds(work: Path, **stages: dict[str, Any]) -> dict[str, str]:
    return {one.code: kind(one) for one in gathered(work, **stages)}


def test_a_good_flight_has_none(tmp_path: Path) -> None:
    passed = told("event-time-base", severity="passed")
    assert gathered(tmp_path, ppk=PPK, exposures=passed, measurements={}, georeferencing={}) == ()


def test_stages_that_were_not_made_say_nothing(tmp_path: Path) -> None:
    assert gather(tmp_path) == ()


def test_a_fault_is_said_once(tmp_path: Path) -> None:
    ppk = {"fixed_percent": 36.0, **told("ppk-not-fixed")}
    assert [one.stage for one in gathered(tmp_path, ppk=ppk, exposures=told("ppk-not-fixed"))] == ["ppk"]


def test_a_readout_that_was_estimated_is_said_once(tmp_path: Path) -> None:
    """Adjustment, check and analysis all tell of it; a certificate has it beside the camera's values."""
    flown = fly(tmp_path / "block", ROLLING, Errors(readout_s=0.015), 0).folder
    work, block = tmp_path / "work", photocal.read_block(flown)
    photocal.write_result(work / "calibration", photocal.adjust(block))
    shutil.copytree(work / "calibration", work / "analysis")
    analyse_run(work / "analysis", flown)
    (work / "georeferencing").mkdir()
    (work / "georeferencing" / "check.json").write_text(json.dumps(to_json(photocal.check(block))))
    told = [(one.stage, one.severity) for one in gather(work) if one.code == "shutter-rolls"]
    assert told == [("calibration", "note")]
    lines = [line.worst for line in every_line(project_findings(work))]
    assert [one.stage for one in lines if one.code == "shutter-rolls"] == ["calibration"]
    run, say = read_run(work / "analysis"), catalogue("en")
    assert "rolling shutter" not in text([hidden_errors(run, say)])
    assert text(analysed(run, say)).count("rolling shutter, lines read in") == 1


def test_findings_of_another_version_are_refused_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(InputMalformedError, match="another version"):
        gathered(tmp_path, georeferencing={"findings": [{"code": "lever-arm", "text": "x"}]})


def test_symptoms_follow_their_cause(tmp_path: Path) -> None:
    found = told("global-test", "camera-change")
    found["findings"] += told("not-separated", severity="note")["findings"]
    assert list(kinds(tmp_path, georeferencing=found).items()) == [
        ("camera-change", "warning"),
        ("global-test", "consequence"),
        ("not-separated", "note"),
    ]


def test_symptoms_without_a_cause_are_warnings(tmp_path: Path) -> None:
    """Lost telemetry makes no point wrong."""
    stages = {"exposures": told("telemetry-gap"), "georeferencing": told("check-outside-prediction")}
    assert set(kinds(tmp_path, **stages).values()) == {"warning"}


def test_every_fault_of_the_table_is_a_cause(tmp_path: Path) -> None:
    for fault in FAULTS:
        found = kinds(tmp_path, georeferencing=told("global-test", fault.code))
        assert found["global-test"] == "consequence", fault.code


def test_unfixed_positions_prove_nothing_against_the_base(tmp_path: Path) -> None:
    ppk = {"fixed_percent": 30.0, **told("ppk-not-fixed")}
    blamed = told("base-position", "control-mistyped")
    assert kinds(tmp_path, ppk=ppk, georeferencing=blamed) == {
        "ppk-not-fixed": "warning",
        "control-mistyped": "warning",
        "not-judged": "consequence",
    }
    last = gather(tmp_path)[-1]
    assert last.subject == "base-position"
    assert "position of the base" in finding_text(last, catalogue("en"))
    most = kinds(tmp_path, ppk={**ppk, "fixed_percent": 80.0})
    assert most["base-position"] == "warning"


def test_a_cause_that_the_check_has_sought_is_not_told_again(tmp_path: Path) -> None:
    """The analysis looks with the same search: where it sees another one, the flight is told one cause."""
    height = told("antenna-height", severity="grave") | {"systematic_errors": {"found": []}}
    drift, head = told("c-drift", severity="grave"), told("head-moved", severity="grave")
    assert kinds(tmp_path, georeferencing=height, analysis=drift) == {"antenna-height": "warning"}
    assert kinds(tmp_path, georeferencing=height, analysis=head) == {
        "antenna-height": "warning", "head-moved": "warning",
    }  # fmt: skip
    assert kinds(tmp_path / "alone", analysis=drift) == {"c-drift": "warning"}


def test_images_that_are_left_out_for_several_reasons_are_all_named(tmp_path: Path) -> None:
    images = {"few-ties": ("a.jpg",), "not-joined": ("b.jpg", "c.jpg")}
    left = [Finding("image-left-out", "doubtful", figures={"images": i}, cause=c) for c, i in images.items()]
    found = gathered(tmp_path, measurements={"findings": [vars(finding) for finding in left]})
    assert [tuple(finding.figures["images"]) for finding in found] == list(images.values())

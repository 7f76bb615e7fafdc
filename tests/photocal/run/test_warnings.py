"""Findings of the stages in one list."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from photocal.base.errors import InputMalformedError
from photocal.findings.finding import Finding, Severity
from photocal.findings.texts import catalogue, finding_text
from photocal.hypotheses.table import FAULTS
from photocal.run.summary import gather, kind

PPK = {"fixed_percent": 100.0, "findings": []}
FILES = {"ppk": "ppk.json", "exposures": "exposures.json", "measurements": "measurement.json"}
FILES |= {"georeferencing": "check.json", "analysis": "analysis.json"}


def told(*codes: str, severity: Severity = "doubtful") -> dict[str, Any]:
    return {"findings": [vars(Finding(code, severity)) for code in codes]}


def gathered(work: Path, **stages: dict[str, Any]) -> tuple[Finding, ...]:
    for stage, content in stages.items():
        (work / stage).mkdir(exist_ok=True)
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


@pytest.mark.parametrize("cause", ["rolling-shutter", "c-drift"])
def test_a_rolling_shutter_or_a_drift_of_c_looks_like_a_zoom(tmp_path: Path, cause: str) -> None:
    blamed = told("camera-change", "strip-shifts", "control-mistyped")
    found = gathered(tmp_path, georeferencing=blamed, analysis=told(cause))
    assert [(one.code, kind(one)) for one in found] == [
        ("control-mistyped", "warning"),
        (cause, "warning"),
        ("not-judged", "consequence"),
        ("not-judged", "consequence"),
    ]
    small = told(cause, severity="note")
    assert kinds(tmp_path, analysis=small)["camera-change"] == "warning"


def test_what_explains_more_is_not_excused(tmp_path: Path) -> None:
    """An antenna 0.2 m too low drags c along: v'Pv falls by 135 with the one, by 75 with a drift of c."""

    def blamed(fall: float) -> dict[str, str]:
        height = told("antenna-height", severity="grave")
        height["findings"][0]["figures"] = {"fall": fall}
        drift = told("c-drift", severity="grave")
        drift["findings"][0]["figures"] = {"fall": 75.0}
        return kinds(tmp_path, georeferencing=height, analysis=drift)

    assert blamed(135.0) == {"antenna-height": "warning", "c-drift": "consequence"}
    assert blamed(60.0) == {"c-drift": "warning", "not-judged": "consequence"}


@pytest.mark.parametrize(("fall", "rival"), [(18.4, True), (27.0, True), (5.0, False)])
def test_what_explains_as_much_is_told_beside_a_drift_of_c(tmp_path: Path, fall: float, rival: bool) -> None:
    """A zoom of 0.05 % looks like a lever arm and like a drift of c: 18.4 and 17.8 of v'Pv."""
    lever = told("lever-arm", severity="grave")
    lever["findings"][0]["figures"] = {"fall": fall, "numbers": ("lever_arm_z +0.078",)}
    drift = told("c-drift", severity="grave")
    drift["findings"][0]["figures"] = {"fall": 17.8, "camera": "a", "figure": 0.006, "sigma": 0.001}
    drift["findings"][0]["figures"] |= {"unit": "mm", "share": 0.0007}
    first, second = gathered(tmp_path, georeferencing=lever, analysis=drift)
    assert (first.code, second.code) == ("c-drift", "not-judged")
    assert first.clauses == (("same",) if rival else ())
    said = finding_text(first, catalogue("en"))
    assert ("cannot tell it from an error of the lever arm" in said) is rival


def test_images_that_are_left_out_for_several_reasons_are_all_named(tmp_path: Path) -> None:
    images = {"few-ties": ("a.jpg",), "not-joined": ("b.jpg", "c.jpg")}
    left = [Finding("image-left-out", "doubtful", figures={"images": i}, cause=c) for c, i in images.items()]
    found = gathered(tmp_path, measurements={"findings": [vars(finding) for finding in left]})
    assert [tuple(finding.figures["images"]) for finding in found] == list(images.values())

"""Warnings of the stages in one list."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from photocal.findings.hypotheses import FAULTS
from photocal.run.doubt import Doubt
from photocal.run.warnings import gather

PPK = {"fixed_percent": 100.0, "float": 0, "single": 0}
CAMERA: dict[str, Any] = {"unmatched_images": [], "ambiguous_images": [], "unmatched_events": []}
EXPOSURES: dict[str, Any] = {
    "cameras": [CAMERA],
    "not_placed": [],
    "placed": 10,
    "with_attitude": 10,
    "checks": [{"code": "lever-arm", "verdict": "passed", "text": "fine"}],
}


def codes(work: Path, **stages: dict[str, Any]) -> list[str]:
    files = {"ppk": "ppk.json", "exposures": "exposures.json", "measurements": "measurement.json"}
    files |= {"georeferencing": "check.json", "analysis": "analysis.json"}
    for stage, content in stages.items():
        (work / stage).mkdir(exist_ok=True)
        (work / stage / files[stage]).write_text(json.dumps(content), encoding="utf-8")
    return [one.code for one in gather(work)]


def test_a_good_flight_has_none(tmp_path: Path) -> None:
    assert codes(tmp_path, ppk=PPK, exposures=EXPOSURES, measurements={}, georeferencing={}) == []


def test_stages_that_were_not_made_say_nothing(tmp_path: Path) -> None:
    assert codes(tmp_path) == []


def test_lost_fixes_images_events_and_telemetry_are_named(tmp_path: Path) -> None:
    camera = {"unmatched_images": ["a.jpg"], "ambiguous_images": ["b.jpg"], "unmatched_events": [3, 4]}
    exposures = {
        **EXPOSURES,
        "cameras": [camera],
        "with_attitude": 7,
        "not_placed": [{"event": 9, "time_gps": "", "reason": "outside the trajectory"}],
        "checks": [{"code": "event-time-base", "verdict": "failed", "text": "18 s off"}],
    }
    found = codes(tmp_path, ppk={**PPK, "fixed_percent": 94.9, "float": 51}, exposures=exposures)
    assert found == [
        "ppk-not-fixed",
        "images-without-event",
        "images-ambiguous",
        "events-without-image",
        "exposure-not-placed",
        "event-time-base",
        "telemetry-gap",
    ]


def test_a_fault_is_said_once(tmp_path: Path) -> None:
    told = [{"code": "ppk-not-fixed", "text": "only 36 % fixed"}]
    ppk = {**PPK, "fixed_percent": 36.0, "float": 9, "findings": told}
    again = {**EXPOSURES, "findings": told}
    assert codes(tmp_path, ppk=ppk, exposures=again) == ["ppk-not-fixed"]


def test_limits_of_the_flight_are_notes(tmp_path: Path) -> None:
    findings = [{"code": "not-separated", "text": "x"}, {"code": "base-position", "text": "y"}]
    codes(tmp_path, georeferencing={"findings": findings})
    assert [one.as_json()["kind"] for one in gather(tmp_path)] == ["warning", "note"]


def told(*codes: str) -> dict[str, Any]:
    return {"findings": [{"code": code, "text": f"{code} it is."} for code in codes]}


def gather_all(work: Path, **stages: dict[str, Any]) -> tuple[Doubt, ...]:
    codes(work, **stages)
    return gather(work)


def kinds(work: Path, **stages: dict[str, Any]) -> dict[str, str]:
    return {one.code: one.kind for one in gather_all(work, **stages)}


def test_symptoms_follow_their_cause(tmp_path: Path) -> None:
    found = kinds(tmp_path, georeferencing=told("global-test", "not-separated", "camera-change"))
    assert list(found.items()) == [
        ("camera-change", "warning"),
        ("global-test", "consequence"),
        ("not-separated", "note"),
    ]


def test_symptoms_without_a_cause_are_warnings(tmp_path: Path) -> None:
    """Lost telemetry makes no point wrong."""
    exposures = {**EXPOSURES, "with_attitude": 7}
    found = kinds(tmp_path, exposures=exposures, georeferencing=told("check-outside-prediction"))
    assert set(found.values()) == {"warning"}


def test_every_error_that_is_searched_for_is_a_cause(tmp_path: Path) -> None:
    for fault in FAULTS:
        found = kinds(tmp_path, georeferencing=told("global-test", fault.code))
        assert found["global-test"] == "consequence", fault.code


def test_unfixed_positions_prove_nothing_against_the_base(tmp_path: Path) -> None:
    ppk = {**PPK, "fixed_percent": 30.0, "findings": [{"code": "ppk-not-fixed", "text": "only 30 %"}]}
    found = kinds(tmp_path, ppk=ppk, georeferencing=told("base-position", "control-mistyped"))
    assert found == {
        "ppk-not-fixed": "warning",
        "control-mistyped": "warning",
        "not-judged": "consequence",
    }
    assert "as if base-position: base-position it is." in gather(tmp_path)[-1].text
    most = kinds(tmp_path, ppk={**ppk, "fixed_percent": 80.0})
    assert most["base-position"] == "warning"


def test_images_and_marks_of_the_measurement(tmp_path: Path) -> None:
    record = {"left_out": [{"image": "a.jpg", "reason": "is empty"}], "warnings": ["a mark is 5 px off"]}
    codes(tmp_path, measurements=record)
    assert [one.text for one in gather(tmp_path)] == [
        "image a.jpg takes no part: is empty.",
        "a mark is 5 px off",
    ]


def test_a_rolling_shutter_looks_like_a_zoom(tmp_path: Path) -> None:
    finding = {"kind": "rolling-shutter", "sentence": "rows are read slowly.", "small": False}
    blamed = told("camera-change", "strip-shifts", "control-mistyped")
    found = gather_all(tmp_path, georeferencing=blamed, analysis={"findings": [finding]})
    assert [(one.code, one.kind) for one in found] == [
        ("control-mistyped", "warning"),
        ("rolling-shutter", "warning"),
        ("not-judged", "consequence"),
        ("not-judged", "consequence"),
    ]
    small = {"findings": [{**finding, "small": True}]}
    assert kinds(tmp_path, analysis=small)["camera-change"] == "warning"

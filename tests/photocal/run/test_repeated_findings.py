"""What a certificate tells beside its figures is found again in its inputs, or named as the issuer's word.

A check point of the flight is off by a metre: a verdict without reservation is wrong, whoever signs it.
"""

from __future__ import annotations

import datetime as dt
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.analysis.analyse_run import analyse_run
from photocal.base.progress import quiet
from photocal.block.folder import read_block
from photocal.block.project import Project, read_project
from photocal.block.results.adjusted import adjust_block
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_json
from photocal.report.certificate_metadata import read_particulars
from photocal.report.issue import issue
from photocal.run.calibration import calibrated_once, certificate_stage
from photocal.run.georeferencing import georeferencing_stage
from photocal.run.summary import gather
from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.conftest import Answer

DAY = dt.date(2026, 11, 23)
FORGED_DAY = dt.date(2031, 1, 1)
PROJECT = """
[project]
name = "field 9"
crs = "local"
height = "local"
output = "work"
[images]
times = "times.csv"
"""
PARTICULARS = '[camera]\nserial = "SN-FORGED"\n[laboratory]\ntraceability = "national standard"\n'
# Findings of a stage whose inputs no certificate carries.
UNFIXED = {"percent": 80.0, "n_float": 4.0, "n_single": 0.0}


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A flight through the stages of a run, one of its check points typed wrongly."""
    folder = tmp_path_factory.mktemp("flight")
    (folder / "project.toml").write_text(PROJECT, encoding="utf-8")
    (folder / "times.csv").write_text("image,time\n", encoding="utf-8")
    (folder / "particulars.toml").write_text(PARTICULARS, encoding="utf-8")
    work = folder / "work"
    fly(work / "block", np.random.default_rng(31), plan=Plan(tie=50, estimate=("c", "K1", "K2")))
    points = work / "block" / "points.csv"
    rows = [row.split(",") for row in points.read_text(encoding="utf-8").splitlines()]
    wrong = next(row for row in rows if row[-1] == "check")
    wrong[1] = repr(float(wrong[1]) + 1.0)
    points.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    adjust_block(work / "block", work / "calibration")
    shutil.copytree(work / "calibration", work / "analysis")
    analyse_run(work / "analysis", work / "block")
    (work / "georeferencing").mkdir()
    read = read_project(folder / "project.toml")
    block = work / "block"
    stage = georeferencing_stage(read, block, read_block, calibrated_once(block, read_block))
    stage.make(work / "georeferencing", quiet)
    return read


@pytest.fixture
def work(project: Project) -> Path:
    return project.output


@pytest.fixture
def issued(work: Path, tmp_path: Path) -> Callable[..., Path]:
    """Issue a certificate with other findings than those of the run: everything in it fits to them."""

    def make(warnings: tuple[Finding, ...], run: str = "analysis", day: dt.date = DAY) -> Path:
        folder, particulars = tmp_path / "certificate", work.parent / "particulars.toml"
        given = read_particulars(particulars, day, client="Another client")
        issue(work / run, folder, given, block=work / "block", warnings=warnings)
        return folder

    return make


def said(photocal: Callable[..., Answer], folder: Path) -> tuple[int, dict[str, Any]]:
    answer = photocal("verify", folder, "--json")
    return answer.code, json.loads(answer.out)


def test_what_a_run_has_told_is_found_again(
    project: Project, work: Path, tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    folder = tmp_path / "certificate"
    folder.mkdir()
    certificate_stage(project, work, DAY, ()).make(folder, quiet)
    code, answer = said(photocal, folder)
    certified = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    assert certified["verdict"]["code"] == "usable-with-reservations"
    assert (code, answer["problems"], answer["not_told"]) == (11, [], [])
    assert answer["verdict"] == certified["verdict"]


def test_emptied_warnings_do_not_make_a_clean_verdict(
    issued: Callable[..., Path], photocal: Callable[..., Answer]
) -> None:
    """Finding 10: warnings and notes emptied, another serial number, client and day, printed anew."""
    folder = issued((), day=FORGED_DAY)
    certified = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    assert certified["verdict"]["code"] == "usable"
    code, answer = said(photocal, folder)
    assert code == 11
    assert answer["verdict"]["code"] == "usable-with-reservations"
    assert any(line.startswith("not stated: check points (indirect)") for line in answer["not_told"])
    taken = {"date 2031-01-01", "document.client Another client", "camera.serial SN-FORGED"}
    taken |= {f"findings of {stage}: none stated" for stage in ("ppk", "exposures", "measurements")}
    assert {*taken, "laboratory.traceability national standard"} <= set(answer["not_repeated"])
    shown = photocal("verify", folder).out
    assert "nothing was found" not in shown
    assert all(f"  {line}\n" in shown for line in answer["not_repeated"])


def told_otherwise(change: Callable[[Finding], Finding | None]) -> Callable[[Path], tuple[Finding, ...]]:
    return lambda work: tuple(found for one in gather(work) if (found := change(one)) is not None)


def softer(finding: Finding) -> Finding:
    return replace(finding, severity="note")


def fewer(finding: Finding) -> Finding | None:
    return None if finding.code == "check-outside-prediction" else finding


def smaller(finding: Finding) -> Finding:
    figures = {key: 1.6 if key == "ratio" else value for key, value in finding.figures.items()}
    return replace(finding, figures=figures)


def elsewhere(finding: Finding) -> Finding:
    moved = finding.code == "check-outside-prediction"
    return replace(finding, figures={**finding.figures, "points": ("p10",)}) if moved else finding


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (told_otherwise(fewer), "not stated: check points (indirect)"),
        (told_otherwise(softer), "check points (indirect): stated as a note, found to be doubtful"),
        (told_otherwise(smaller), ": stated with another ratio"),
        (told_otherwise(elsewhere), ": stated with another points"),
        (
            lambda work: (*gather(work), Finding("no-control", "note", stage="georeferencing")),
            "no control points: stated, not found",
        ),
    ],
)
def test_findings_that_are_told_otherwise_are_named(
    change: Callable[[Path], tuple[Finding, ...]],
    named: str,
    work: Path,
    issued: Callable[..., Path],
    photocal: Callable[..., Answer],
) -> None:
    code, answer = said(photocal, issued(change(work)))
    assert code == 4
    assert any(named in problem for problem in answer["problems"]), answer["problems"]
    assert answer["reproducible"] is False


def test_an_analysis_that_was_taken_out_is_named(
    issued: Callable[..., Path], work: Path, photocal: Callable[..., Answer]
) -> None:
    _, answer = said(photocal, issued(gather(work), run="calibration"))
    assert "no analysis: hidden errors were not searched for" in answer["not_repeated"]
    _, answer = said(photocal, issued(gather(work)))
    assert not any(line.startswith("no analysis") for line in answer["not_repeated"])


def test_what_no_inputs_can_show_is_the_issuers_word(
    issued: Callable[..., Path], work: Path, tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    """Positions without fixed ambiguities make a consequence of what follows from them, in both readings."""
    flown = Path(shutil.copytree(work, tmp_path / "work"))
    (flown / "ppk").mkdir()
    unfixed = finding_json(Finding("ppk-not-fixed", "doubtful", figures=UNFIXED), catalogue("en"))
    ppk = {"fixed_percent": UNFIXED["percent"], "findings": [unfixed]}
    (flown / "ppk" / "ppk.json").write_text(json.dumps(ppk), encoding="utf-8")
    told = gather(flown)
    assert "consequence" in {finding.severity for finding in told}
    code, answer = said(photocal, issued(told))
    assert code == 11
    assert "findings of ppk: ppk-not-fixed" in answer["not_repeated"]
    assert "ppk-not-fixed" in answer["verdict"]["figures"]["codes"]

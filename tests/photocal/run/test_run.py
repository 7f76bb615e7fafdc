"""A project from its block to the certificate."""

from __future__ import annotations

import csv
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from photocal.base.codec import parsed_json
from photocal.base.errors import ConfigurationError, IllPosedError, InputNotFoundError
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.commands.cli import app
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

PLAN = Plan(
    heights_m=(80.0, 110.0),
    tie=40,
    estimate=("c", "x0", "y0", "K1", "K2"),
    mounting="lever_arm_sigma_m = 0.02\nboresight_sigma_deg = 0.5\ntime_offset_sigma_s = 0.005",
)
PROJECT = """
[project]
name = "field 9"
crs = "local"
height = "local"
output = "work"
[measurements]
block = "block"
[judgement]
scale = "1:1000"
standards = ["pec-pcd"]
"""
BASE = "The coordinates of the base station, or its datum or epoch, are wrong"
NOT_CHECKED = "positions, mounting and control were not tested for faults"


def project(folder: Path, errors: Errors, seed: int = 4) -> Path:
    fly(folder / "block", np.random.default_rng(seed), errors, PLAN)
    (folder / "project.toml").write_text(PROJECT, encoding="utf-8")
    return folder / "project.toml"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["run", *arguments])


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """A flight whose base station stands elsewhere than its coordinates say."""
    path = project(tmp_path_factory.mktemp("shifted"), Errors(datum_m=(0.7, -0.5, 0.5)))
    return path, run(str(path), "--json")


def test_every_stage_is_made_and_told(shifted: tuple[Path, Result]) -> None:
    path, said = shifted
    assert said.exit_code == 0, said.output
    figures = json.loads(said.stdout)
    stages = ["block", "calibration", "georeferencing", "analysis", "certificate"]
    assert [one["stage"] for one in figures["stages"]] == stages
    assert not any(one["kept"] for one in figures["stages"])
    assert (path.parent / "work" / "certificate" / "certificate.pdf").read_bytes().startswith(b"%PDF-")
    assert figures["check_points"]["indirect"]["errors_over_prediction"] < 2.0
    assert {one["standard"] for one in figures["classes"]} == {"pec-pcd"}


def restated(table: Path, scale: dict[str, float]) -> None:
    """Multiply columns of a table."""
    rows = list(csv.DictReader(io.StringIO(table.read_text(encoding="utf-8"))))
    for row in rows:
        row.update({name: repr(by * float(row[name])) for name, by in scale.items() if row[name]})
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.mark.parametrize(
    ("errors", "seed", "stated", "says"),
    [
        (Errors(), 4, 1.0, set()),
        (Errors(), 4, 3.0, {"sigmas-too-large"}),
        (Errors(), 6, 0.3, {"sigmas-too-small"}),
        (Errors(datum_m=(0.2, -0.15, 0.15)), 4, 1.0, {"base-position"}),
        (Errors(time_offset_s=0.05), 4, 1.0, {"time-offset"}),
    ],
)
def test_a_ready_block_is_read_once_and_adjusted_five_times_at_most(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    errors: Errors,
    seed: int,
    stated: float,
    says: set[str],
) -> None:
    """Each adjustment says why; what is kept repeats what it said, and reads nothing.

    stated: standard deviations of the positions over the true ones.
    """
    path, taken = project(tmp_path, errors, seed), []
    restated(tmp_path / "block" / "positions.csv", dict.fromkeys(("sX", "sY", "sZ"), stated))

    def counted(folder: Path) -> Block:
        taken.append(folder)
        return read_block(folder)

    results: list[Path] = []

    def parsed(file: Path, remedy: str) -> object:
        results.extend([file] if file.name == "result.json" else [])
        return parsed_json(file, remedy)

    for reader in ("photocal.block.folder.read_block", "photocal.run.campaign.read_block"):
        monkeypatch.setattr(reader, counted)
    monkeypatch.setattr("photocal.block.results.folder.parsed_json", parsed)
    for kept in (False, True):
        figures = json.loads(run(str(path), "--json").stdout)
        assert all(one["kept"] is kept for one in figures["stages"])
        reasons = [reason for one in figures["stages"] for reason in one["adjustments"]]
        assert len(reasons) <= 5
        assert all(reasons)
        # What is calibrated is the integrated method, and what is analysed.
        assert reasons[:2] == ["calibration of the block", "indirect georeferencing"]
        assert says <= {one["code"] for one in figures["warnings"]}
        assert len(taken) == 1
        # Those who begin with files, as `certificate`, ask for what was read.
        assert len(results) == 1


def test_a_fault_is_named_and_reaches_the_certificate(shifted: tuple[Path, Result]) -> None:
    path, said = shifted
    assert "base-position" in {one["code"] for one in json.loads(said.stdout)["warnings"]}
    folder = path.parent / "work" / "certificate"
    warned = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))["warnings"]
    (base,) = [one for one in warned if one["code"] == "base-position"]
    assert base["stage"] == "georeferencing"
    assert base["text"].startswith(BASE)
    assert BASE in (folder / "certificate.html").read_text(encoding="utf-8")


def test_one_verdict_everywhere(shifted: tuple[Path, Result]) -> None:
    path, said = shifted
    work = path.parent / "work"
    certified = json.loads((work / "certificate" / "certificate.json").read_text(encoding="utf-8"))
    sentence = certified["verdict"]["paragraph"]
    assert sentence == json.loads(said.stdout)["verdict"]["paragraph"]
    assert sentence in (work / "certificate" / "certificate.html").read_text(encoding="utf-8")
    for place in (path, work / "block"):
        assert sentence in CliRunner().invoke(app, ["check", str(place)]).stdout
        answer = CliRunner().invoke(app, ["check", str(place), "--json"]).stdout
        assert json.loads(answer)["verdict"]["paragraph"] == sentence


def test_a_check_after_the_block_changed_does_not_repeat_the_old_certificate(
    shifted: tuple[Path, Result], tmp_path: Path
) -> None:
    shutil.copytree(shifted[0].parent, tmp_path / "again")
    table = tmp_path / "again" / "block" / "points.csv"
    # Other ends of lines: another file, the same figures.
    table.write_text(table.read_text(encoding="utf-8").replace("\n", "\r\n"), encoding="utf-8", newline="")
    answer = CliRunner().invoke(app, ["check", str(tmp_path / "again" / "project.toml"), "--json"])
    assert answer.exit_code == 0, answer.output
    codes = {one["code"] for one in json.loads(answer.stdout)["findings"]}
    assert {"certificate-outdated", "base-position"} <= codes


def test_no_certificate_of_a_stage_is_silent(shifted: tuple[Path, Result], tmp_path: Path) -> None:
    work = shifted[0].parent / "work"
    said = CliRunner().invoke(app, ["certificate", str(work / "calibration"), "-o", str(tmp_path / "c")])
    assert said.exit_code == 0, said.output
    assert BASE in (tmp_path / "c" / "certificate.html").read_text(encoding="utf-8")


def test_a_certificate_before_the_check_says_so(shifted: tuple[Path, Result], tmp_path: Path) -> None:
    work = shifted[0].parent / "work"
    for name in ("block", "calibration"):
        shutil.copytree(work / name, tmp_path / "work" / name)
        shutil.copytree(work / ".stages" / name, tmp_path / "work" / ".stages" / name)
    calibration = str(tmp_path / "work" / "calibration")
    said = CliRunner().invoke(app, ["certificate", calibration, "-o", str(tmp_path / "c")])
    assert said.exit_code == 0, said.output
    assert NOT_CHECKED in (tmp_path / "c" / "certificate.html").read_text(encoding="utf-8")


def test_nothing_is_made_twice(shifted: tuple[Path, Result]) -> None:
    path, _ = shifted
    again = run(str(path))
    assert "0 stages made" in again.stdout
    assert "5 kept" in again.stdout
    for word in ("camera  ", "lever arm", "boresight", "time offset", "check points", "verdict"):
        assert word in again.stdout


def test_another_question_is_answered_without_adjusting_again(shifted: tuple[Path, Result]) -> None:
    path, _ = shifted
    other = path.with_name("other.toml")
    other.write_text(PROJECT.replace("1:1000", "1:2000"), encoding="utf-8")
    stages = json.loads(run(str(other), "--until", "georeferencing", "--json").stdout)["stages"]
    assert {one["stage"]: one["kept"] for one in stages} == {
        "block": True,
        "calibration": True,
        "georeferencing": False,
    }


def test_a_flight_without_fault_has_no_warning(tmp_path: Path) -> None:
    said = run(str(project(tmp_path, Errors())), "--until", "georeferencing", "--json")
    figures = json.loads(said.stdout)
    assert [one for one in figures["warnings"] if one["kind"] == "warning"] == []
    camera = figures["calibration"]["cameras"]["cam"]["parameters"]["c"]
    assert abs(camera["value"] - 12.0) < 3 * camera["sigma"]


def with_control_off(folder: Path, off_m: float) -> tuple[Path, str]:
    """Project whose first control point is off in X, and the name of that point."""
    path = project(folder, Errors())
    points = folder / "block" / "points.csv"
    head, *rows = points.read_text(encoding="utf-8").splitlines()
    first = next(k for k, row in enumerate(rows) if row.endswith("control"))
    name, x, *rest = rows[first].split(",")
    rows[first] = ",".join([name, f"{float(x) + off_m:.4f}", *rest])
    points.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path, name


def test_control_that_bends_the_block_is_named_first(tmp_path: Path) -> None:
    """A control point 200 m off: the adjustment ends at an absurd minimum, and the verdict says of what."""
    path, name = with_control_off(tmp_path, 200.0)
    said = run(str(path))
    assert said.exception is None
    verdict = said.stdout.partition("verdict")[2]
    assert "not fit for mapping as it stands" in verdict.splitlines()[0]
    assert verdict.splitlines()[0].endswith(f"measurements of {name}.")
    assert f"* Control point {name} contradicts" in verdict.splitlines()[1]


def test_a_run_that_fails_tells_why(tmp_path: Path) -> None:
    """A control point 5 km off: no adjustment ends, and the check and the refusal name the point first."""
    path, name = with_control_off(tmp_path, 5000.0)
    said = run(str(path))
    assert isinstance(said.exception, IllPosedError)
    assert said.exception.remedy.startswith(f"first correct or leave out {name}:")
    told = [line for line in said.stderr.splitlines() if ": warning: " in line]
    assert f"warning: control-mistyped: Control point {name} contradicts" in told[0]
    assert not (tmp_path / "work" / "certificate").exists()


def test_mistakes_are_one_line(tmp_path: Path) -> None:
    path = project(tmp_path, Errors())
    assert "that it has: block, calibration" in str(run(str(path), "--until", "ppk").exception)
    assert isinstance(run(str(path), "--again", "nothing").exception, ConfigurationError)
    assert "same output" in str(run(str(path), str(path)).exception)
    assert isinstance(run(str(tmp_path / "none.toml")).exception, InputNotFoundError)
    (tmp_path / "block" / "block.toml").unlink()
    assert "block.toml" in str(run(str(path)).exception)

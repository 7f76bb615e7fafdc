"""Calibrations of several flights side by side, and one used in another."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.block.results.adjusted import adjust_block
from photocal.commands.cli import app
from photocal.report.certificate_metadata import read_particulars
from photocal.report.issue import issue
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly
from tests.photocal.report.runs import invented

RIG = Errors(lever_arm_m=(0.1, -0.05, -0.2), boresight_deg=(0.4, -0.3, 0.5), time_offset_s=0.008)
PLAN = Plan(
    tie=50,
    estimate=("c", "x0", "y0", "K1", "K2", "P1", "P2"),
    mounting="lever_arm_m = [0.1, -0.05, -0.2]\nlever_arm_sigma_m = 0.02\n"
    "boresight_sigma_deg = 1.0\ntime_offset_sigma_s = 0.01",
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("campaign")
    made = []
    for seed, name in enumerate(("may", "june"), start=1):
        fly(folder / f"{name}-block", np.random.default_rng(seed), RIG, PLAN)
        adjust_block(folder / f"{name}-block", folder / name)
        made.append(folder / name)
    return made


def test_two_flights_of_one_camera(runs: list[Path]) -> None:
    said = CliRunner().invoke(app, ["compare", *map(str, runs), "--exchange", "--json"])
    assert said.exit_code == 0, said.output
    figures = json.loads(said.stdout)
    assert figures["cameras"] == ["may", "june"]
    zero_rotation = [f for f in figures["pairs"][0]["figures"] if f["method"] == "ROT"]
    # One camera: what is left differs by no more than the noise of both calibrations, which are known.
    assert all(f["sigma_px"] is not None and not f["different"] for f in zero_rotation)
    uses = {(use["of"], use["used_in"]): use for use in figures["exchange"]}
    assert set(uses) == {(a, b) for a in ("may", "june") for b in ("may", "june")}
    # Points of one flight err together: the root of the mean square stays below that of a single point.
    assert all(0.3 < uses[pair]["ratio"] < 2.3 for pair in (("may", "june"), ("june", "may")))
    assert all(use["points"] == 20 for use in uses.values())


def test_a_changed_camera_is_told(runs: list[Path], tmp_path: Path) -> None:
    changed = Errors(RIG.lever_arm_m, RIG.boresight_deg, RIG.time_offset_s, focal_mm=0.05)
    fly(tmp_path / "block", np.random.default_rng(5), changed, PLAN)
    adjust_block(tmp_path / "block", tmp_path / "zoomed")
    said = CliRunner().invoke(app, ["compare", str(runs[0]), str(tmp_path / "zoomed"), "--json"])
    figures = json.loads(said.stdout)["pairs"][0]["figures"]
    assert any(f["different"] for f in figures if f["method"] == "ROT")


def test_what_cannot_be_compared(runs: list[Path], tmp_path: Path) -> None:
    alone = CliRunner().invoke(app, ["compare", str(runs[0])])
    assert isinstance(alone.exception, InputNotFoundError)
    empty = CliRunner().invoke(app, ["compare", str(runs[0]), str(tmp_path)])
    assert isinstance(empty.exception, InputNotFoundError)
    assert "photocal run" in str(empty.exception)
    (tmp_path / "cameras.toml").write_text("[[camera]]\n", encoding="utf-8")
    mixed = CliRunner().invoke(app, ["compare", str(tmp_path / "cameras.toml"), str(runs[0])])
    assert isinstance(mixed.exception, ConfigurationError)
    issue(runs[0], tmp_path / "certificate", read_particulars(None, dt.date(2026, 5, 1)))
    itself = CliRunner().invoke(app, ["compare", str(runs[0]), str(tmp_path / "certificate")])
    assert "is the same calibration as may" in str(itself.exception)
    mistyped = CliRunner().invoke(app, ["compare", str(tmp_path / "mai"), str(runs[0])])
    assert str(mistyped.exception) == f"{tmp_path / 'mai'}: no such file or folder; check the name"


@pytest.mark.slow
def test_three_certificates_tell_how_their_camera_repeats(tmp_path: Path) -> None:
    folders = []
    for k, (warm, day) in enumerate(((8, "2026-01-10"), (20, "2026-04-10"), (31, "2026-07-10"))):
        run = invented(tmp_path / f"run{k}")
        record = json.loads((run / "result.json").read_text(encoding="utf-8"))
        own = next(iter(record["cameras"].values()))["parameters"]["c"]
        own["value"] += 40.0 * own["sigma"] * k
        (run / "result.json").write_text(json.dumps(record), encoding="utf-8")
        given = tmp_path / f"given{k}.toml"
        given.write_text(f"[laboratory]\nmeasured = {day}\n[conditions]\ntemperature_c = {warm}\n")
        issue(run, tmp_path / f"certificate{k}", read_particulars(given, dt.date(2026, 8, 1)))
        folders.append(str(tmp_path / f"certificate{k}"))
    answer = json.loads(CliRunner().invoke(app, ["compare", *folders, "--json"]).stdout)
    (found,) = answer["repeatability"].values()
    c = next(one for one in found if one["parameter"] == "c")
    assert c["between"] == pytest.approx(np.std([0.0, 40.0, 80.0], ddof=1) * own["sigma"], rel=0.01)
    assert {trend["against"] for trend in c["trends"]} == {"temperature", "time"}
    text = CliRunner().invoke(app, ["compare", *folders]).stdout
    assert "for one more flight" in text
    assert "with temperature" in text

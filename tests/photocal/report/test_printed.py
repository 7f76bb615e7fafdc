"""The printed Phantom 4 Pro calibration through the command: refused, and why."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from photocal.commands.cli import app
from photocal.report.derived_figures import check_printed

STUDY = Path(__file__).parents[3] / "configs" / "studies" / "phantom4pro" / "calibration.toml"


def test_printed_calibration_is_refused_for_what_is_wrong_with_it() -> None:
    answer = CliRunner().invoke(app, ["verify", str(STUDY), "--json"])
    assert answer.exit_code != 0
    said = json.loads(answer.stdout)
    assert said["plausible"] is False
    found = {(f["code"], f["subject"]): f for f in said["findings"]}
    lost = found["correlation_sign_lost", "K1-K2"]
    assert lost["figures"]["least_eigenvalue"] == pytest.approx(-0.909, abs=5e-4)
    assert "−0.9091" in lost["text"]
    for key in (
        ("px_printed_as_mm", "c"),
        ("distortion_folds", "K"),
        ("not_significant", "P1"),
        ("not_significant", "lever_arm_Y"),
        ("only_its_prior", "boresight"),
        ("pitch_contradicts_sensor", "pitch"),
        ("gsd_contradicts_height", "gsd"),
        ("base_contradicts_overlap", "base"),
    ):
        assert key in found
    assert said["acceptance"]["verdict"] == "acceptable"
    assert "−0.9091" in str(answer.exception)


def test_its_limits_are_those_of_the_form() -> None:
    """dz 24.45086 cm with the nominal focal length and the printed pixel."""
    limits = {limit.key: limit for limit in check_printed(STUDY)[2]}
    assert limits["altimetric"].limit == pytest.approx(24.45086, abs=5e-6)
    assert limits["planimetric"].limit == 3.17


def test_pixel_size_of_its_text_requires_a_new_calibration(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    text = STUDY.read_text(encoding="utf-8").replace("pixel_size_mm = 0.0241", "pixel_size_mm = 2.41e-6")
    path.write_text(text, encoding="utf-8")
    said = json.loads(CliRunner().invoke(app, ["verify", str(path), "--json"]).stdout)
    assert said["acceptance"]["verdict"] == "new_calibration"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('unit = "mm"', 'unit = "cm"', "calibration.unit"),
        ("[-0.11, 1],", "[-0.11],", "not a lower triangle"),
        ("c = [3673.03, 0.28]", "c = [-3673.03, 0.28]", "c must be positive"),
        ("gsd_cm", "gsd", "campaign.gsd"),
    ],
)
def test_wrong_files_are_refused_in_a_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(STUDY.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    answer = CliRunner().invoke(app, ["verify", str(path)])
    assert message in str(answer.exception)
    assert "\n" not in str(answer.exception)

"""What an error that all GNSS heights share does to c stands in the budget, or no probability is claimed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import photocal
from photocal.analysis.outcome import ANALYSIS
from photocal.commands.cli import app
from tests.evidence.judging import fly
from tests.independent.faults import BASE, NO_CONTROL
from tests.independent.flights import Design, Errors

LOWER_M = 0.05


def _section(page: str) -> str:
    start = page.index("Uncertainty of the principal distance")
    return page[start : page.index("</section>", start)]


def _run(folder: Path, design: Design = BASE, seed: int = 2) -> tuple[Path, float]:
    """Run folder of a flight whose GNSS heights are all 5 cm low, and the true c."""
    errors = Errors(datum_m=(0.0, 0.0, -LOWER_M))
    flown = fly(folder / "block", design, errors, seed)
    assert CliRunner().invoke(app, ["adjust", str(flown.folder), "-o", str(folder / "run")]).exit_code == 0
    return folder / "run", flown.truth.lens.c


def _certified(run: Path, given: str = "[uncertainty]\n") -> str:
    particulars = run.parent / "given.toml"
    particulars.write_text(given, encoding="utf-8")
    to = run.parent / "certificate"
    asked = ["certificate", str(run), "-o", str(to), "--particulars", str(particulars)]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code == 0, said.output
    # Blanks that no line breaks at are blanks.
    return _section((to / "certificate.html").read_text(encoding="utf-8").replace("\u00a0", " "))


def test_the_change_of_c_is_that_of_an_adjustment_with_lower_positions(tmp_path: Path) -> None:
    block = photocal.read_block(fly(tmp_path / "block", BASE, Errors(), 2).folder)
    told = photocal.analyse(block).c_by_height["cam0"]
    assert told is not None
    lower = replace(block.positions, values=block.positions.values - [0.0, 0.0, LOWER_M])
    c, moved = (photocal.adjust(b).camera().value("c") for b in (block, replace(block, positions=lower)))
    assert moved - c == pytest.approx(-LOWER_M * told, rel=2e-3)


def test_without_control_the_block_moves_and_c_stays(tmp_path: Path) -> None:
    block = photocal.read_block(fly(tmp_path / "block", NO_CONTROL, Errors(), 2).folder)
    assert photocal.analyse(block).c_by_height == {"cam0": 0.0}


def test_a_shift_that_is_an_unknown_is_in_the_covariance(tmp_path: Path) -> None:
    folder = fly(tmp_path / "block", BASE, Errors(), 2).folder
    with (folder / "block.toml").open("a", encoding="utf-8") as file:
        file.write("flight_shift_sigma_m = 0.02\n")
    assert photocal.analyse(photocal.read_block(folder)).c_by_height == {"cam0": None}


def test_the_expanded_uncertainty_covers_what_no_residual_tells(tmp_path: Path) -> None:
    """Positions 5 cm low: the formal 95 % miss the true c; with 5 cm stated, they do not."""
    run, true = _run(tmp_path)
    assert CliRunner().invoke(app, ["analyse", str(run)]).exit_code == 0
    by_height = json.loads((run / ANALYSIS).read_text(encoding="utf-8"))["c_by_height"]["cam0"]
    camera = photocal.read_result(run).camera()
    error, sigma = abs(camera.value("c") - true), camera.sigma_of("c")
    assert error > 1.96 * sigma
    assert error < 1.96 * np.hypot(sigma, LOWER_M * by_height)
    page = _certified(run, f"[uncertainty]\ncommon_height_m = {LOWER_M}\n")
    assert "of a height error of 5 cm common to all positions" in page
    assert "95 %" in page
    assert "of a height error of 2 cm common to all positions" in _certified(run)
    assert "common to all positions" not in _certified(run, "[uncertainty]\nof_c = { datum = 1.5 }\n")


def test_without_an_analysis_no_probability_is_claimed(tmp_path: Path) -> None:
    run, _ = _run(tmp_path)
    page = _certified(run)
    assert "No probability is claimed" in page
    assert "95 %" not in page

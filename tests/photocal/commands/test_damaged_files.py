"""Damaged project files, blocks and tables through the commands: one line, and the exit code of its class."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from photocal.base.errors import PhotocalError
from photocal.commands.cli import app
from tests.photocal.commands.mutations import versions

DCS460 = Path(__file__).parents[3] / "photocal/demo/dcs460"
# Missing or empty, malformed, wrong keys or values, not determined, not converged.
CLASSES = {3, 4, 5, 6, 7}
PROJECT = """
[project]
name = "field"
crs = "local"
height = "local"
output = "work"
refraction = 0.13
[measurements]
block = "block"
[judgement]
scale = "1:1000"
contour_interval_m = 1.0
standards = ["pec-pcd"]
[certificate]
client = "x"
language = "en"
"""
MOST = 25


def answered(*words: str) -> tuple[int, str]:
    """Exit code and line of a command; what is no failure of ours goes through."""
    result = CliRunner().invoke(app, list(words))
    if isinstance(result.exception, PhotocalError):
        return result.exception.exit_code, str(result.exception)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["block.toml", "images.csv", "points.csv", "observations.csv"])
def test_a_block(name: str, tmp_path: Path) -> None:
    """A block is adjusted as it is damaged: those that are still whole give a calibration."""
    shutil.copytree(DCS460, tmp_path / "block")
    path = tmp_path / "block" / name
    chosen = list(versions(path))
    chance = random.Random(name)  # noqa: S311 - a choice, no keys
    for what, content in chance.sample(chosen, min(MOST, len(chosen))):
        path.write_bytes(content)
        code, line = answered("adjust", str(tmp_path / "block"), "-o", str(tmp_path / "run"))
        assert code in CLASSES | {0}, (what, code, line)
        assert "\n" not in line, what
        assert bool(line) == (code != 0), what
        assert not list(tmp_path.glob(".run*")), what


@pytest.mark.slow
def test_a_project(tmp_path: Path) -> None:
    """A run stops before its first stage: the block that it names lies elsewhere."""
    path = tmp_path / "project.toml"
    path.write_text(PROJECT, encoding="utf-8")
    for what, content in list(versions(path)):
        path.write_bytes(content)
        code, line = answered("run", str(path), "--until", "block")
        assert code in CLASSES | {8}, (what, code, line)
        assert line, what
        assert "\n" not in line, what

"""What the documents say of files, commands and exit codes is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.main import get_command

from acquire.commands.cli import app as acquire_app
from photocal.base.checked_toml import read_toml
from photocal.block.camera_setup import make_camera
from photocal.block.folder import (
    EXPOSURE,
    IMAGE_COLUMNS,
    IMAGE_SIGMAS,
    OBSERVATION_COLUMNS,
    POINT_COLUMNS,
    POINT_CROSS,
    POINT_SIGMAS,
)
from photocal.block.motion import MOTION_COLUMNS
from photocal.block.setup import Setup
from photocal.commands.cli import app as photocal_app
from photocal.geometry.camera import PARAMETERS

ROOT = Path(__file__).parents[3]


def document(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_example_of_the_block_folder_is_a_block(tmp_path: Path) -> None:
    found = re.search(r"```toml\n(.*?)```", document("docs/block-folder.md"), re.DOTALL)
    assert found is not None
    (tmp_path / "block.toml").write_text(found.group(1))
    setup = read_toml(tmp_path / "block.toml", Setup)
    made = make_camera(setup.camera[0], "example")
    assert made.value("c") == 8.8
    assert made.estimated.sum() == 8


def test_columns_are_those_that_are_read() -> None:
    tables = document("docs/block-folder.md").partition("## The run folder")[0]
    rows = dict(re.findall(r"^\| `(\w+)\.csv`[^|]*\| (.+?) \|$", tables, re.MULTILINE))
    listed = {name: set(re.split(r"[,|\s]+", cells)) - {""} for name, cells in rows.items()}
    assert listed["images"] == {*IMAGE_COLUMNS, *IMAGE_SIGMAS, *MOTION_COLUMNS, EXPOSURE}
    assert listed["points"] == {*POINT_COLUMNS, *POINT_SIGMAS, *POINT_CROSS}
    assert listed["observations"] == {*OBSERVATION_COLUMNS, "sx", "sy"}


def test_every_camera_parameter_has_its_term() -> None:
    text = document("docs/nomenclature.md").replace("K1-K4", "K1 K2 K3 K4").replace("P1-P4", "P1 P2 P3 P4")
    for name in PARAMETERS:
        assert re.search(rf"\b{name}\b", text), name


@pytest.mark.parametrize("program", ["acquire", "photocal"])
def test_commands_of_the_readme_exist(program: str) -> None:
    app = {"acquire": acquire_app, "photocal": photocal_app}[program]
    known = set(get_command(app).commands)  # type: ignore[attr-defined]
    used = set(re.findall(rf"^    {program} (\w+)", document("README.md"), re.MULTILINE))
    assert used
    assert used <= known

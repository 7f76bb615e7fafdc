"""Wrong projects: the cause is the last line, before anything is computed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.project import read_project
from photocal.run.project_checks import check_project, check_rays
from tests.evidence.wrong_projects import CASES, Wrong, ending
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

PROJECT = """[project]
name = "practice"
crs = "EPSG:31982"
height = "ellipsoidal"
output = "work"
[flight]
logs = ["flight.mcap"]
base_position = [-25.4484624612, -49.2313485214, 912.4848]
[images]
times = "times.csv"
[rig]
camera_to_antenna_m = [0.08, 0.03, -0.24]
camera_to_antenna_sigma_m = [0.01, 0.01, 0.01]
boresight_sigma_deg = [1.0, 1.0, 1.0]
attitude_sigma_deg = [0.3, 0.3, 0.6]
time_offset_sigma_s = 0.005
[[camera]]
id = "SIM-0"
model = "brown-ideal"
unit = "mm"
size_px = [1024, 768]
pitch_mm = 0.0117
parameters = { "c" = 8.8 }
[control]
points = "control.csv"
[measurements]
observations = "observations.csv"
sigma_px = 0.4
"""
CONTROL = """point,X,Y,Z,sX,sY,sZ,role
GCP01,677857.0857,7184229.1439,911.5519,0.008,0.008,0.012,control
GCP02,677877.6259,7184220.2638,912.7110,0.008,0.008,0.012,control
GCP03,677875.3368,7184241.9258,910.1858,0.008,0.008,0.012,control
CHK01,677860.6903,7184241.4238,910.4197,0.008,0.008,0.012,check
GCP04,677850.5045,7184241.1260,911.3759,0.008,0.008,0.012,control
"""
# These need rays, and stand in the study.
LATER = (
    "heights in feet",
    "heights with a wrong sign",
    "other names",
    "heights of another",
    "control shifted",
)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "project.toml").write_text(PROJECT)
    (folder / "control.csv").write_text(CONTROL)
    for name in ("flight.mcap", "times.csv", "observations.csv"):
        (folder / name).write_text("x")
    return folder


def test_the_practice_project_is_right(site: Path) -> None:
    check_project(read_project(site / "project.toml"))


@pytest.mark.parametrize(
    "case", [case for case in CASES if not case.title.startswith(LATER)], ids=lambda case: case.title
)
def test_what_ends_a_run_names_the_cause(site: Path, tmp_path: Path, case: Wrong) -> None:
    line, traceback = ending(site, case, tmp_path / "wrong")
    assert not traceback
    assert re.search(case.named, line), line


def test_of_points_that_are_partly_exchanged_only_those_are_named(site: Path) -> None:
    """Whether they are the fewer or the more; a single one that no slip explains is left to its residual."""
    table = site / "control.csv"
    for rows in ((1, 3), (1, 2, 3)):
        lines = CONTROL.splitlines()
        for k in rows:
            cells = lines[k].split(",")
            lines[k] = ",".join([cells[0], cells[2], cells[1], *cells[3:]])
        table.write_text("\n".join(lines) + "\n")
        named = ", ".join(lines[k].split(",")[0] for k in rows)
        with pytest.raises(
            ConfigurationError, match=f"^[^:]*control.csv: E and N of control points {named} are exch"
        ):
            check_project(read_project(site / "project.toml"))
    table.write_text(CONTROL.replace("677857.0857,7184229.1439", "627857.0857,7084229.1439"))
    check_project(read_project(site / "project.toml"))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Block:
    """A flight whose images are oriented, with its control at 700 m height."""
    folder = tmp_path_factory.mktemp("flown") / "block"
    fly(folder, np.random.default_rng(1), Errors(), Plan(tie=5))
    return read_block(folder)


def spoiled(block: Block, factor: tuple[float, float, float], shift: tuple[float, float, float]) -> Block:
    values = block.points.values.copy()
    mine = ~block.points.of_role("tie")
    values[mine] = values[mine] * factor + shift
    return replace(block, points=replace(block.points, values=values))


def test_right_control_passes(flown: Block) -> None:
    check_rays(flown, None, alike=True)


def test_control_shifted_all_alike_is_told_when_asked(flown: Block) -> None:
    wrong = spoiled(flown, (1, 1, 1), (100.0, 0.0, 0.0))
    check_rays(wrong, None)
    with pytest.raises(
        ConfigurationError, match=r"all control points lie \+100 m east, .0 m north and .0 m up"
    ):
        check_rays(wrong, None, alike=True)


def test_control_in_feet_is_named(flown: Block) -> None:
    wrong = spoiled(flown, (3.28084, 3.28084, 3.28084), (0, 0, 0))
    with pytest.raises(ConfigurationError, match="the control points are in feet"):
        check_rays(wrong, None)


def test_a_system_of_another_place_is_refused_where_no_control_is_in_it(site: Path) -> None:
    """Nothing else would say so: the block is adjusted, turned by the meridians' convergence."""
    file = site / "project.toml"
    alone = PROJECT.replace('[control]\npoints = "control.csv"\n', "")
    # Its own zone, and the one beside it.
    for code in ("EPSG:31982", "EPSG:31983"):
        file.write_text(alone.replace("EPSG:31982", code))
        check_project(read_project(file))
    file.write_text(alone.replace("EPSG:31982", "EPSG:32614"))
    with pytest.raises(ConfigurationError, match=r"is the system of another place.*such as EPSG:32722"):
        check_project(read_project(file))

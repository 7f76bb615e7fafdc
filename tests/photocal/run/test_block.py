"""The block of a run: what was measured, what was observed, and what the errors of the positions share."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.adjustment.mounting import HEIGHT_SCALE, SHIFT
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.project import read_project
from photocal.run.block import block_stage
from tests.photocal.georeferencing.flights import Errors, Plan, fly

PROJECT = """
[project]
name = "field"
crs = "local"
height = "local"
output = "work"
[rig]
camera_to_antenna_m = [0.1, 0.0, -0.2]
camera_to_antenna_sigma_m = 0.01
boresight_sigma_deg = 1.0
attitude_sigma_deg = [0.3, 0.3, 0.6]
time_offset_sigma_s = 0.005
"""


def made(tmp_path: Path, figures: dict[str, Any], project: str = PROJECT) -> Block:
    measurements, exposures, made_in = tmp_path / "measurements", tmp_path / "exposures", tmp_path / "block"
    fly(measurements, np.random.default_rng(1), Errors(), Plan(heights_m=(80.0, 110.0), tie=5))
    exposures.mkdir()
    setup = measurements / "block.toml"
    setup.write_text(setup.read_text().replace("[mounting]", ""))
    for name in ("positions.csv", "attitudes.csv"):
        (measurements / name).rename(exposures / name)
    (exposures / "exposures.json").write_text(json.dumps(figures))
    (tmp_path / "project.toml").write_text(project)
    made_in.mkdir()

    @contextmanager
    def quiet(*_: object) -> Any:
        yield lambda _: None

    block_stage(read_project(tmp_path / "project.toml"), exposures, measurements).make(made_in, quiet)
    return read_block(made_in)


def test_what_the_positions_share_is_unknown_in_common(tmp_path: Path) -> None:
    common = {"shift_sigma_m": [0.002, 0.003, 0.005], "zenith_scale_sigma": 2e-5, "base_height_m": 12.5}
    block = made(tmp_path, {"common": common})
    assert block.mounting.sigma[SHIFT].tolist() == [0.002, 0.003, 0.005]
    assert block.mounting.sigma[HEIGHT_SCALE] == 2e-5
    assert block.positions.above == pytest.approx(block.positions.values[:, 2] - 12.5)


def test_positions_of_the_receiver_share_nothing(tmp_path: Path) -> None:
    block = made(tmp_path, {"common": None})
    assert not block.mounting.sigma[SHIFT].any()
    assert block.mounting.sigma[HEIGHT_SCALE] == 0.0


def test_refraction_is_what_the_project_states(tmp_path: Path) -> None:
    stated = PROJECT.replace('output = "work"', 'output = "work"\nrefraction = 0.13')
    assert made(tmp_path, {}, stated).refraction == 0.13

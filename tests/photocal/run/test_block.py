"""The block of a run: what was measured, what was observed, and what the errors of the positions share."""

from __future__ import annotations

import csv
import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Transformer

from photocal.adjustment.mounting import HEIGHT_SCALE, SHIFT
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.project import read_project
from photocal.navigation.attitude import from_angles
from photocal.navigation.common_errors import CommonErrors, DelayLapse
from photocal.navigation.exposures import Exposures
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import InterpolatedPositions
from photocal.run.block import block_stage
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

PROJECT = """
[project]
name = "field"
crs = "EPSG:32722"
height = "ellipsoidal"
output = "work"
[rig]
camera_to_antenna_m = [0.1, 0.0, -0.2]
camera_to_antenna_sigma_m = 0.01
boresight_sigma_deg = 1.0
attitude_sigma_deg = [0.3, 0.3, 0.6]
time_offset_sigma_s = 0.005
"""


EAST_M, NORTH_M = 500_000.0, 7_000_000.0


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def exposures_of(measurements: Path) -> Exposures:
    """What the tables of a local block say of antenna and vehicle, as exposures in UTM zone 22 south."""
    positions, attitudes = rows_of(measurements / "positions.csv"), rows_of(measurements / "attitudes.csv")

    def numbers(rows: list[dict[str, str]], *names: str) -> Any:
        return np.array([[float(row[name]) for name in names] for row in rows])

    xyz = numbers(positions, "X", "Y", "Z") + np.array([EAST_M, NORTH_M, 0.0])
    lon, lat, height = Transformer.from_crs("EPSG:32722", "EPSG:4979", always_xy=True).transform(*xyz.T)
    sigma = numbers(positions, "sX", "sY", "sZ")
    placed = InterpolatedPositions.stated(
        np.stack([lat, lon, height], axis=1), sigma, ["fixed"] * len(positions)
    )
    placed = replace(placed, velocity_m_s=numbers(positions, "vX", "vY", "vZ"))
    flown = from_angles(
        np.radians(numbers(attitudes, "roll", "pitch", "yaw")),
        np.radians(numbers(attitudes, "sroll", "spitch", "syaw")),
    )
    # Strips are told by a pause.
    strip = np.unique([row["strip"] for row in positions], return_inverse=True)[1]
    time = GpsTime(np.cumsum(np.where(np.diff(strip, prepend=strip[0]) != 0, 60, 2)) * 10**9)
    images = [(row["image"],) for row in positions]
    cross, number = np.zeros((len(images), 3, 3)), np.arange(len(images))
    return Exposures(time, number, placed, flown, cross, images, "ellipsoidal")


def made(tmp_path: Path, figures: dict[str, Any], project: str = PROJECT) -> tuple[Block, Block]:
    measurements, exposures, made_in = tmp_path / "measurements", tmp_path / "exposures", tmp_path / "block"
    fly(measurements, np.random.default_rng(1), Errors(), Plan(heights_m=(80.0, 110.0), tie=5))
    exposures.mkdir()
    setup = measurements / "block.toml"
    setup.write_text(setup.read_text().replace("[mounting]", ""))
    given = read_block(measurements)
    exposures_of(measurements).write(exposures / "exposures.parquet")
    for name in ("positions.csv", "attitudes.csv"):
        (measurements / name).unlink()
    (exposures / "exposures.json").write_text(json.dumps(figures))
    (tmp_path / "project.toml").write_text(project)
    made_in.mkdir()

    @contextmanager
    def quiet(*_: object) -> Any:
        yield lambda _: None

    block_stage(read_project(tmp_path / "project.toml"), exposures, measurements).make(made_in, quiet)
    return given, read_block(made_in)


def test_what_the_positions_share_is_unknown_in_common(tmp_path: Path) -> None:
    base_m, moved = np.array([0.002, 0.003, 0.005]), np.array([0.0, 0.0, -4.0])
    common = CommonErrors(base_m, None, np.zeros(3), 12.5, DelayLapse(0.0, 5e-6, "test"), moved)
    _, block = made(tmp_path, {"common": common.as_json()})
    assert block.mounting.sigma[SHIFT].tolist() == [0.002, 0.003, 0.005]
    assert block.mounting.sigma[HEIGHT_SCALE] == 2e-5
    assert block.positions.above == pytest.approx(block.positions.values[:, 2] - 12.5)


def test_what_was_observed_comes_through_without_loss(tmp_path: Path) -> None:
    given, block = made(tmp_path, {})
    assert [block.images.names[k] for k in block.positions.image] == [
        given.images.names[k] for k in given.positions.image
    ]
    away = block.positions.values - given.positions.values
    assert np.abs(away - [EAST_M, NORTH_M, 0.0]).max() < 1e-6
    # Within 300 m of the central meridian the grid's north departs from true north by less than 0.1 degree.
    assert np.abs(block.positions.covariance - given.positions.covariance).max() < 1e-5
    assert np.abs(block.positions.velocity - given.positions.velocity).max() < 0.03
    assert np.unique(block.positions.strip).tolist() == np.unique(given.positions.strip).tolist()
    assert np.abs(block.attitudes.rotation - given.attitudes.rotation).max() < 1e-12
    assert np.abs(block.attitudes.covariance / given.attitudes.covariance[0, 0, 0]).max() == pytest.approx(
        np.abs(given.attitudes.covariance / given.attitudes.covariance[0, 0, 0]).max(), rel=1e-9
    )


def test_positions_of_the_receiver_share_nothing(tmp_path: Path) -> None:
    _, block = made(tmp_path, {"common": None})
    assert not block.mounting.sigma[SHIFT].any()
    assert block.mounting.sigma[HEIGHT_SCALE] == 0.0


def test_refraction_is_what_the_project_states(tmp_path: Path) -> None:
    stated = PROJECT.replace('output = "work"', 'output = "work"\nrefraction = 0.13')
    assert made(tmp_path, {}, stated)[1].refraction == 0.13

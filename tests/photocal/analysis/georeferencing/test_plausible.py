"""Mistakes of frames, found before anything is adjusted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from photocal.analysis.georeferencing.causes import ground_findings
from photocal.block.folder import read_block
from photocal.block.model import Block
from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.findings.english import english

# A field near Presidente Prudente, UTM zone 22 S.
LATITUDE, LONGITUDE = -22.12, -51.41


@pytest.fixture
def block(tmp_path: Path) -> Block:
    return read_block(fly(tmp_path / "flight", np.random.default_rng(1), plan=Plan(tie=0)))


def placed(block: Block, frame: str, images: np.ndarray, points: np.ndarray) -> Block:
    """The block moved to places in a frame, each given by its middle."""
    moved = block.images.values.copy()
    moved[:, 3:5] = images
    positions = block.positions.values.copy()
    positions[:, :2] = images
    xyz = block.points.values.copy()
    xyz[:, :2] = points
    return replace(
        block,
        frame=frame,
        images=replace(block.images, values=moved),
        points=replace(block.points, values=xyz),
        positions=replace(block.positions, values=positions),
    )


def utm(zone: int) -> np.ndarray:
    back = Transformer.from_crs("EPSG:4326", f"EPSG:{32700 + zone}", always_xy=True)
    return np.array(back.transform(LONGITUDE, LATITUDE))


def found(block: Block) -> set[str]:
    return {finding.code for finding in ground_findings(block)}


def test_nothing_to_say(block: Block) -> None:
    assert found(block) == set()
    assert found(placed(block, "EPSG:32722", utm(22), utm(22))) == set()


def test_wrong_utm_zone(block: Block) -> None:
    said = ground_findings(placed(block, "EPSG:32722", utm(22), utm(23)))
    assert [finding.code for finding in said] == ["wrong-utm-zone"]
    assert "in zone 23 S" in english(said[0])


def test_latitude_and_longitude_swapped(block: Block) -> None:
    here, there = np.array([LONGITUDE, LATITUDE]), np.array([LATITUDE, LONGITUDE])
    assert found(placed(block, "EPSG:4326", here, here)) == set()
    assert found(placed(block, "EPSG:4326", here, there)) == {"latitude-longitude-swapped"}


def test_east_and_north_swapped(block: Block) -> None:
    here = utm(22)
    assert found(placed(block, "local", here, here[::-1])) == {"east-north-swapped"}
    assert found(placed(block, "local", here, here / 0.3048)) == {"feet-for-metres-plane"}
    assert found(placed(block, "local", here, here + 9e5)) == {"points-far-from-flight"}

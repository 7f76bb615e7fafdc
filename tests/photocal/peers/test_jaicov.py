"""JAICOV's example: 115 images of an industrial object, free network, against AICON's listing."""

from __future__ import annotations

import html
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.exchange.formats import read_foreign_block
from photocal.exchange.jaicov import read_jaicov
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles

pytestmark = pytest.mark.shared

# The listing's names, and ours.
NAMES = {"Ck": "c", "Xh": "x0", "Yh": "y0", "A1": "K1", "A2": "K2", "B1": "P1", "B2": "P2"}


@pytest.fixture(scope="module")
def example(shared: Path) -> Path:
    return shared / "data" / "jaicov-aicon-block" / "example.ior"


@pytest.fixture(scope="module")
def listing(example: Path) -> str:
    text = example.with_suffix(".htm").read_bytes().decode("latin-1")
    return html.unescape(re.sub(r"<[^>]*>", "", text))


@pytest.fixture(scope="module")
def found(example: Path, adjusted: Any) -> Any:
    block = read_foreign_block(example)
    return block, *adjusted(block)


def test_residuals_of_the_files(example: Path) -> None:
    """The files' own orientation, camera and points give the residuals that the .phc lists."""
    block = read_jaicov(example)
    o = block.observations
    turn = matrix_from_angles(block.images.values[:, :3])[o.image]
    q = np.einsum("nij,nj->ni", turn, block.points.values[o.point] - block.images.values[o.image, 3:])
    v = projected(block.cameras[0], q) - o.values
    listed = []
    images, points = set(block.images.names), set(block.points.names)
    for line in example.with_suffix(".phc").read_text(encoding="ascii").splitlines():
        cells = line.split()
        if cells[9] == "1" and cells[0] in images and cells[1] in points:
            listed.append([float(cells[6]), float(cells[7])])
    assert len(listed) == len(v) == 9972
    # The .ior has the camera to five digits of a mm: up to 0.1 um at the edge.
    assert np.abs(v - listed).max() < 1e-4


def test_counts_and_sum_of_squares(found: Any, listing: str) -> None:
    _, _, solution = found
    for label, value in (
        ("Anzahl der Beobachtungen", solution.observations),
        ("Anzahl der Unbekannten", solution.unknowns),
        ("Gesamtredundanz", solution.degrees_of_freedom),
    ):
        assert int(re.search(label + r"\s*:\s*(\d+)", listing)[1]) == value  # type: ignore[index]
    # The listing stopped early at 12410.5; this is the minimum of the same system.
    assert solution.chi_squared == pytest.approx(12374.16, abs=0.02)


def test_camera(found: Any, listing: str) -> None:
    _, _, solution = found
    factor = math.sqrt(solution.variance_factor)
    covariance = solution.camera_covariance[0]
    for theirs, ours in NAMES.items():
        row = re.search(rf"^\s*{theirs}\s+:\s+(\S+)\s+(\S+)", listing, flags=re.MULTILINE)
        assert row
        value, sigma = float(row[1]), float(row[2])
        k = PARAMETERS.index(ours)
        assert abs(solution.cameras[0, k] - (abs(value) if ours == "c" else value)) < 0.25 * sigma, ours
        assert math.sqrt(covariance[k, k]) * factor == pytest.approx(sigma, rel=5e-3)


def test_correlations(found: Any, listing: str) -> None:
    _, _, solution = found
    covariance = solution.camera_covariance[0]
    rows = list(NAMES)
    table = listing.split("Korrelation:")[1].splitlines()
    compared = 0
    for line in table[:10]:
        cells = line.split()
        if len(cells) < 2 or cells[0] not in NAMES or cells[1] in NAMES:
            continue
        for other, cell in zip(rows, cells[1:], strict=False):
            i, j = PARAMETERS.index(NAMES[cells[0]]), PARAMETERS.index(NAMES[other])
            correlation = covariance[i, j] / math.sqrt(covariance[i, i] * covariance[j, j])
            # Ck is our -c.
            sign = -1 if (cells[0] == "Ck") != (other == "Ck") else 1
            assert sign * correlation == pytest.approx(float(cell), abs=0.01)
            compared += 1
    assert compared == 28

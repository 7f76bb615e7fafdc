"""Repeated readings of a point in an image: mean, standard deviation, rejection limit, what stays."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.folder import read_block
from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.conftest import Answer

SIGMA, LIMIT = 0.4, 2.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A flight whose points are read five times each, every tenth of the first readings wrong by 5 px."""
    rng = np.random.default_rng(8)
    block = fly(tmp_path / "flight", rng, plan=Plan(tie=20))
    rows = rows_of(block)
    lines = ["image,point,x,y"]
    for k, row in enumerate(rows):
        for reading in range(5):
            x, y = np.array([float(row["x"]), float(row["y"])]) + rng.normal(0.0, SIGMA, 2)
            x += 5.0 * (k % 10 == 0 and reading == 0)
            lines.append(f"{row['image']},{row['point']},{x:.5f},{y:.5f}")
    (block / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = (block / "block.toml").read_text(encoding="utf-8")
    text = text.replace("sigma = 0.4", f"sigma = 0.4\nrejection_limit = {LIMIT}")
    (block / "block.toml").write_text(text, encoding="utf-8")
    return block


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "observations.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_mean_of_what_agrees_is_the_observation(folder: Path) -> None:
    rows = rows_of(folder)
    block = read_block(folder)
    assert block.repetition is not None
    wrong = len(rows) // 50 + (len(rows) // 5 % 10 > 0)
    # Four sigmas and more from the median by chance happens once in thousands.
    assert wrong <= block.repetition.rejected <= wrong + 5
    assert (block.repetition.readings, block.repetition.least) == (len(rows), 4)
    assert block.repetition.sigma == pytest.approx((SIGMA, SIGMA), rel=0.05)
    at = {name: k for k, name in enumerate(block.points.names)}
    images = {name: k for k, name in enumerate(block.images.names)}
    seen = block.observations
    for first in (0, 5, 50):
        five = np.array([[float(row["x"]), float(row["y"])] for row in rows[first : first + 5]])
        kept = five[(np.abs(five - np.median(five, axis=0)) <= LIMIT).all(axis=1)]
        row = rows[first]
        (k,) = np.flatnonzero((seen.image == images[row["image"]]) & (seen.point == at[row["point"]]))
        assert seen.values[k] == pytest.approx(kept.mean(axis=0))
        assert seen.sigma[k] == pytest.approx([SIGMA / np.sqrt(len(kept))] * 2)


def test_the_result_says_how_readings_agree(folder: Path, photocal: Callable[..., Answer]) -> None:
    """And the global test is the one that was asked for."""
    text = (folder / "block.toml").read_text(encoding="utf-8")
    asked = text.replace('datum = "control"', 'datum = "control"\nglobal_test = "one-sided"\nlevel = 0.9')
    (folder / "block.toml").write_text(asked, encoding="utf-8")
    said = photocal("adjust", folder, "-o", folder / "run")
    assert said.code == 0, said.err
    assert "readings" in said.out
    content = json.loads((folder / "run" / "result.json").read_text(encoding="utf-8"))
    assert content["repetition"]["most"] == 5
    assert (content["global_test"]["lower"], content["global_test"]["probability"]) == (0.0, 0.9)


def test_readings_that_do_not_agree_are_named(folder: Path) -> None:
    text = (folder / "observations.csv").read_text(encoding="utf-8").splitlines()
    image, point, x, y = text[1].split(",")
    pair = [f"{image},{point},{float(x) + d},{y}" for d in (-9.0, 9.0)]
    (folder / "observations.csv").write_text("\n".join([text[0], *pair, *text[6:]]) + "\n", encoding="utf-8")
    with pytest.raises(InputMalformedError, match=f"point {point} in image {image}"):
        read_block(folder)

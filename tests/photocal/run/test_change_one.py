"""One thing is changed in a project: the next run gives what a run from nothing gives."""

from __future__ import annotations

import csv
import datetime as dt
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.base.arrays import Floats
from photocal.base.progress import quiet
from photocal.block.project import read_project
from photocal.block.results.folder import read_result
from photocal.run.campaign import run_project
from tests.evidence.judging import fly
from tests.independent.flights import Design, Errors

PROJECT = """
[project]
name = "field"
crs = "local"
height = "local"
output = "work"
[measurements]
block = "ready"
"""
LEFT_OUT = """
[[leave_out]]
image = "IMG_0003"
reason = "blurred"
"""


def ran(folder: Path) -> tuple[Floats, Floats]:
    """Values and standard deviations of the camera and the exposures after a run up to the adjustment."""
    run_project(read_project(folder / "project.toml"), dt.date(2026, 1, 1), quiet, until="calibration")
    made = folder / "work" / "calibration"
    (camera,) = read_result(made).cameras.values()
    with (made / "images.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    value = [camera.value(name) for name in camera.free] + [
        float(row[axis]) for row in rows for axis in "XYZ"
    ]
    sigma = [camera.sigma_of(name) for name in camera.free]
    sigma += [float(row[f"s{axis}"]) for row in rows for axis in "XYZ"]
    return np.array(value), np.array(sigma)


def moved(folder: Path) -> None:
    path = folder / "ready" / "observations.csv"
    head, first, *others = path.read_text().splitlines()
    image, point, x, *rest = first.split(",")
    path.write_text("\n".join([head, ",".join([image, point, str(float(x) + 0.5), *rest]), *others]) + "\n")


def promoted(folder: Path) -> None:
    path = folder / "ready" / "points.csv"
    path.write_text(path.read_text().replace(",check", ",control", 1))


def left_out(folder: Path) -> None:
    with (folder / "project.toml").open("a") as file:
        file.write(LEFT_OUT)


@pytest.mark.parametrize("change", [moved, promoted, left_out])
def test_what_changes_ends_as_a_run_from_nothing(change: Callable[[Path], None], tmp_path: Path) -> None:
    site, new = tmp_path / "site", tmp_path / "new"
    fly(site / "ready", Design("small", images=12, per_image=60), Errors(), 0)
    (site / "project.toml").write_text(PROJECT)
    before, _ = ran(site)
    change(site)
    shutil.copytree(site, new, ignore=shutil.ignore_patterns("work"))
    (value, sigma), (expected, expected_sigma) = ran(site), ran(new)
    assert np.all(np.abs(value - expected) <= 0.01 * expected_sigma)
    assert sigma == pytest.approx(expected_sigma, rel=0.01)
    assert len(value) < len(before) or np.any(np.abs(value - before) > 0.01 * sigma)

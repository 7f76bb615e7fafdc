"""Observations that were measured elsewhere, of a flight whose recording has a gap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError
from photocal.block.folder import read_images
from photocal.block.model import Images
from photocal.block.project import Project, read_project
from photocal.run.measurements import given_block

PROJECT = """
[project]
name = "field"
crs = "local"
height = "local"
output = "work"
[[camera]]
id = "cam"
model = "brown-ideal"
unit = "mm"
size_px = [6000, 4000]
pitch_mm = 0.004
parameters = { c = 12.0 }
[control]
points = "control.csv"
[measurements]
observations = "observations.csv"
sigma_px = 0.5
"""
LINES = ("a,P1,10,20", "a,T1,900.5,30", "b,P1,11,21", "b,T1,700,35", "b,T2,41,50", "c,P1,12,22", "c,T2,40,50")


@pytest.fixture
def project(tmp_path: Path) -> Project:
    (tmp_path / "project.toml").write_text(PROJECT)
    (tmp_path / "control.csv").write_text("point,X,Y,Z,sX,sY,sZ,role\nP1,0,0,0,0.01,0.01,0.02,control\n")
    (tmp_path / "observations.csv").write_text("\n".join(("image,point,x,y", *LINES)) + "\n")
    (tmp_path / "images.csv").write_text(
        "image,camera,X,Y,Z,omega,phi,kappa\na,cam,0,0,80,0,0,0\nb,cam,20,0,80,0,0,0\n"
    )
    return read_project(tmp_path / "project.toml")


@pytest.fixture
def images(project: Project, tmp_path: Path) -> Images:
    return read_images(tmp_path / "images.csv", project.cameras)


def test_images_of_the_gap_are_left_out(project: Project, images: Images) -> None:
    block = given_block(project, images, ["c", "d"])
    seen = block.observations
    assert block.images.names == ("a", "b")
    assert [block.images.names[i] for i in seen.image] == ["a", "a", "b", "b"]
    assert [block.points.names[j] for j in seen.point] == ["P1", "T1", "P1", "T1"]
    assert np.array_equal(seen.values[:, 0], [10, 900.5, 11, 700])


def test_other_images_are_refused(project: Project, images: Images) -> None:
    with pytest.raises(InputMalformedError, match="image c has no exposure"):
        given_block(project, images, ["d"])

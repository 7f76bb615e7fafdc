"""Sigmas of the exterior orientation after adjustment: single photos over held control, in closed form."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from tests.photocal.blocks import table
from tests.photocal.conftest import Answer

Photocal = Callable[..., Answer]
Floats = NDArray[np.float64]
C_MM, SIGMA_MM = 20.0, 0.004
GROUND = np.array([(x, y, 3.0 * ((x + y) % 40 == 0)) for x in (-40.0, 0.0, 40.0) for y in (-30.0, 0.0, 30.0)])
POSES = np.array([[0.02, -0.03, 0.4, -5.0, 2.0, 100.0], [-0.01, 0.02, 1.2, 6.0, -3.0, 104.0]])


def seen(pose: Floats) -> Floats:
    """Collinearity from omega, phi, kappa."""
    o, p, k = pose[:3]
    first = np.array([[1, 0, 0], [0, np.cos(o), np.sin(o)], [0, -np.sin(o), np.cos(o)]])
    second = np.array([[np.cos(p), 0, -np.sin(p)], [0, 1, 0], [np.sin(p), 0, np.cos(p)]])
    third = np.array([[np.cos(k), np.sin(k), 0], [-np.sin(k), np.cos(k), 0], [0, 0, 1]])
    q = (GROUND - pose[3:]) @ (third @ second @ first).T
    return np.asarray(-C_MM * q[:, :2] / q[:, 2:])


def normal_matrix(pose: Floats) -> Floats:
    """Of a resection, by differences."""
    columns = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        columns.append(((seen(pose + step) - seen(pose - step)) / 2e-6).ravel())
    design = np.column_stack(columns)
    return np.asarray(design.T @ design / SIGMA_MM**2)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    block, random = tmp_path / "block", np.random.default_rng(2)
    block.mkdir()
    (block / "block.toml").write_text(
        '[block]\nname = "pair"\nframe = "local"\ndatum = "control"\n[observations]\nunit = "mm"\n'
        f'axes = "photo"\nsigma = {SIGMA_MM}\n[[camera]]\nid = "main"\nmodel = "brown-ideal"\nunit = "mm"\n'
        f"size_px = [6000, 4000]\npitch_mm = 0.004\nparameters = {{ c = {C_MM} }}\n"
    )
    noisy = POSES + random.normal(0, 1, POSES.shape) * np.repeat([np.radians(0.02), 0.08], 3)
    rows = (
        [str(k), "main", *p[3:], *np.degrees(p[:3]), *[0.08] * 3, *[0.02] * 3] for k, p in enumerate(noisy)
    )
    table(block / "images.csv", "image,camera,X,Y,Z,omega,phi,kappa,sX,sY,sZ,so,sp,sk", rows)
    points = ([f"p{k}", *xyz, 0, 0, 0, "control"] for k, xyz in enumerate(GROUND.tolist()))
    table(block / "points.csv", "point,X,Y,Z,sX,sY,sZ,role", points)
    rays = [(i, f"p{k}", *xy) for i, p in enumerate(POSES)
            for k, xy in enumerate(seen(p) + random.normal(0, SIGMA_MM, (9, 2)))]  # fmt: skip
    table(block / "observations.csv", "image,point,x,y", rays)
    return tmp_path


def test_sigmas_after_adjustment_in_closed_form(photocal: Photocal, folder: Path) -> None:
    positions, attitudes = (0.001, 0.08, 50.0), (0.0005, 0.02, 20.0)
    (folder / "experiment.toml").write_text(
        'block = "block"\nmethods = []\n[prior]\n'
        f"position_m = {list(positions)}\nattitude_deg = {list(attitudes)}\n"
    )
    said = photocal("check", "--experiment", folder / "experiment.toml", "-o", folder / "out", "--json")
    assert said.code == 0, said.err
    runs = json.loads(said.out)["prior"]["runs"]
    assert [(run["position_m"], round(run["attitude_deg"], 9)) for run in runs] == [
        (p, a) for p in positions for a in attitudes
    ]
    for run in runs:
        prior = np.diag(np.repeat([np.radians(run["attitude_deg"]), run["position_m"]], 3) ** -2.0)
        covariance = [np.linalg.inv(normal_matrix(pose) + prior) for pose in POSES]
        sigma = np.sqrt(np.mean([np.diag(one) for one in covariance], axis=0))
        angles = [run[f"sigma_{name}_deg"] for name in ("omega", "phi", "kappa")]
        places = [run[f"sigma_{name}_m"] for name in "xyz"]
        assert angles == pytest.approx(np.degrees(sigma[:3]), rel=2e-3)
        assert places == pytest.approx(sigma[3:], rel=2e-3)
    # Stated as it was drawn, the factor is that of chance (36 degrees of freedom); far too well, it is not.
    low, high = chi2(36).ppf([0.0005, 0.9995]) / 36
    assert low < runs[4]["variance_factor"] < high < runs[0]["variance_factor"]
    with (folder / "out" / "priors.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 9
    assert (folder / "out" / "priors.pdf").stat().st_size > 1000
    assert (
        "sigma of the exterior orientation after adjustment"
        in photocal("check", "--experiment", folder / "experiment.toml").out
    )


def test_a_block_that_observes_no_exposure(photocal: Photocal, folder: Path) -> None:
    lines = (folder / "block" / "images.csv").read_text().splitlines()
    (folder / "block" / "images.csv").write_text(
        "\n".join(",".join(line.split(",")[:8]) for line in lines) + "\n"
    )
    (folder / "experiment.toml").write_text(
        'block = "block"\nmethods = []\n[prior]\nposition_m = [1]\nattitude_deg = [1]\n'
    )
    said = photocal("check", "--experiment", folder / "experiment.toml")
    assert said.code != 0
    assert "no exposure of the block is observed" in said.err

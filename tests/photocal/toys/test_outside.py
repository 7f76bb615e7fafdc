"""Standard, stage and lens from installed packages: one file and one entry each, used by commands."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import photocal
from photocal.base.extensions import HYPOTHESES, LENSES, STAGES, STANDARDS
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

ROOT, HERE = Path(__file__).parents[3], Path(__file__).parent
SIZE = 1200
PROJECT = """
[project]
name = "ready"
crs = "local"
height = "local"
output = "work"
[measurements]
block = "block"
[judgement]
standards = ["toy"]
scale = "1:1000"
"""


def installed(folder: Path, **entries: str) -> dict[str, str]:
    """The environment with a package that has these modules, as pip lays it down: group and object each."""
    info = folder / "toys-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toys\nVersion: 1.0\n", encoding="utf-8")
    lines = []
    for module, entry in entries.items():
        group, _, name = entry.partition(" ")
        shutil.copy(HERE / f"{module}.py", folder)
        lines.append(f"[{group}]\ntoy = {module}:{name}\n")
    (info / "entry_points.txt").write_text("".join(lines), encoding="utf-8")
    return {**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))}


def run(environment: dict[str, str], *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "photocal", *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=280, check=False)


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("toys") / "site"
    return installed(folder, toy_standard=f"{STANDARDS} TEXT", toy_stage=f"{STAGES} STAGE")


def test_a_stage_and_a_standard_take_part_in_a_run(tmp_path: Path, toys: dict[str, str]) -> None:
    fly(tmp_path / "block", np.random.default_rng(4), Errors(), Plan(tie=20))
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    for kept in (False, True):
        told = run(toys, "run", tmp_path / "project.toml", "--json", "--until", "toy")
        assert told.returncode == 0, told.stderr
        stages = {one["stage"]: one["kept"] for one in json.loads(told.stdout)["stages"]}
        assert list(stages) == ["block", "calibration", "georeferencing", "analysis", "toy"]
        assert stages["toy"] is kept
    made = json.loads((tmp_path / "work/toy/count.json").read_text(encoding="utf-8"))
    assert made == {"project": "ready", "images": len(photocal.read_block(tmp_path / "block").images.names)}
    check = json.loads((tmp_path / "work/georeferencing/check.json").read_text(encoding="utf-8"))
    judged = check["methods"]["integrated"]["assessment"]["standards"]
    assert {one["standard"] for one in judged} == {"toy-standard"}
    # A stage whose file changes is made again.
    site = Path(toys["PYTHONPATH"].split(os.pathsep)[0])
    module = site / "toy_stage.py"
    module.write_text(module.read_text(encoding="utf-8") + "\n# changed\n", encoding="utf-8")
    again = run(toys, "run", tmp_path / "project.toml", "--json", "--until", "toy")
    assert json.loads(again.stdout)["stages"][-1]["kept"] is False


def test_a_hypothesis_is_sought_and_said_by_both_commands(tmp_path: Path) -> None:
    environment = installed(tmp_path / "site", toy_hypothesis=f"{HYPOTHESES} FAULT")
    fly(tmp_path / "block", np.random.default_rng(4), Errors(datum_m=(0.0, 0.4, 0.0)), Plan(tie=40))
    told = run(environment, "check", tmp_path / "block", "--json")
    first = json.loads(told.stdout)["findings"][0]
    assert first["code"] == "north-shift", told.stderr
    assert first["text"].startswith("All positions lie too far north")
    assert "Read the northing" in json.loads(told.stdout)["verdict"]["paragraph"]
    assert run(environment, "adjust", tmp_path / "block", "-o", tmp_path / "run").returncode == 0
    analysed = json.loads(run(environment, "analyse", tmp_path / "run", "--json").stdout)
    assert analysed["findings"][0]["code"] == "north-shift"
    # Without the package the same error has the name that the program knows.
    without = run({**os.environ, "PYTHONPATH": str(ROOT)}, "check", tmp_path / "block", "--json")
    assert json.loads(without.stdout)["findings"][0]["code"] == "base-position"


def test_what_cannot_be_loaded_is_named(tmp_path: Path) -> None:
    broken = installed(tmp_path / "site", toy_standard=f"{STANDARDS} NOTHING", toy_stage=f"{STAGES} make")
    told = run(broken, "run", tmp_path)
    assert "Traceback" not in told.stderr
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    (tmp_path / "block").mkdir()
    told = run(broken, "run", tmp_path / "project.toml")
    assert told.returncode == photocal.ConfigurationError.exit_code
    assert "the stage toy is not a photocal.run.stage.AddedStage" in told.stderr


def test_without_the_package_its_names_are_unknown() -> None:
    with pytest.raises(photocal.InputNotFoundError, match="unknown standard 'toy'"):
        photocal.assess(
            {"point": ["a"], "dE": [0.0], "dN": [0.0]}, photocal.JudgementOptions(standard=("toy",))
        )


def stereographic(points: np.ndarray, c: float, k1: float) -> np.ndarray:
    """Column and row of points in camera axes (x right, y up, z backwards), by the angle off the axis."""
    half = np.tan(np.arctan2(np.hypot(points[:, 0], points[:, 1]), -points[:, 2]) / 2)
    direction = points[:, :2] / np.hypot(points[:, 0], points[:, 1])[:, None]
    plane = c * (2 * half * (1 + k1 * half**2))[:, None] * direction
    return np.asarray(plane * [1, -1] + (SIZE - 1) / 2)


@pytest.mark.slow
def test_a_lens_calibrates_a_camera(tmp_path: Path) -> None:
    """All kernels are compiled anew with it, once."""
    rng, c, k1 = np.random.default_rng(7), 420.0, 0.08
    environment = installed(tmp_path / "site", toy_lens=f"{LENSES} LENS")
    points = rng.uniform([-3, -3, 0], [3, 3, 1.5], (60, 3))
    rows, images = [], []
    for k in range(8):
        centre = np.array([2.0 * np.cos(k), 2.0 * np.sin(k), 2.5 + 0.2 * k])
        angles = np.array([rng.normal(0, 0.2), rng.normal(0, 0.2), k * np.pi / 4])
        turn = Rotation.from_euler("XYZ", angles).as_matrix().T
        pixels = stereographic((points - centre) @ turn.T, c, k1) + rng.normal(0, 0.2, (60, 2))
        seen = (np.abs(pixels - SIZE / 2) < SIZE / 2).all(axis=1)
        rows += [f"i{k},p{j},{pixels[j, 0]:.4f},{pixels[j, 1]:.4f}" for j in np.flatnonzero(seen)]
        images.append(f"i{k},one,{','.join(map(repr, [*centre.tolist(), *np.degrees(angles).tolist()]))}")
    block = tmp_path / "block"
    block.mkdir()
    tables = {
        "images.csv": ("image,camera,X,Y,Z,omega,phi,kappa", images),
        "points.csv": (
            "point,X,Y,Z,sX,sY,sZ,role",
            [f"p{j},{x!r},{y!r},{z!r},1e-3,1e-3,1e-3,control" for j, (x, y, z) in enumerate(points.tolist())],
        ),
        "observations.csv": ("image,point,x,y", rows),
    }
    for name, (head, lines) in tables.items():
        (block / name).write_text("\n".join([head, *lines]), encoding="utf-8")
    (block / "block.toml").write_text(
        '[block]\nframe = "local"\ndatum = "control"\n'
        '[observations]\nunit = "px"\naxes = "pixel"\nsigma = 0.2\n'
        f'[[camera]]\nid = "one"\nmodel = "toy"\nunit = "px"\nsize_px = [{SIZE}, {SIZE}]\n'
        'parameters = {c = 400.0}\nestimate = ["c", "x0", "y0", "K1"]\n',
        encoding="utf-8",
    )
    told = run(environment, "adjust", block, "-o", tmp_path / "run")
    assert told.returncode == 0, told.stderr
    camera = json.loads((tmp_path / "run/result.json").read_text(encoding="utf-8"))["cameras"]["one"]
    for name, truth in (("c", c), ("K1", k1), ("x0", 0.0), ("y0", 0.0)):
        found = camera["parameters"][name]
        assert abs(found["value"] - truth) < 4 * found["sigma"], name
    assert camera["parameters"]["K1"]["sigma"] < 0.01
    # Without the package the block is refused by the names of the models that are known.
    alone = run({**os.environ, "PYTHONPATH": str(ROOT)}, "adjust", block, "-o", tmp_path / "none")
    assert alone.returncode == photocal.ConfigurationError.exit_code
    assert "must be one of brown-observed, brown-ideal" in alone.stderr

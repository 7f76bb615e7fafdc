"""Experiments: interior orientations weighted and fixed, control patterns, leave one out."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.photocal.analysis.georeferencing.flights import FOCAL_MM, Plan, fly
from tests.photocal.conftest import Answer

Photocal = Callable[..., Answer]

# Seven calibrations as in the canon-elph study; the first is the true one, the fifth stands apart.
OFFSETS_MM = (0.0, 0.006, -0.006, 0.012, 0.06, -0.012, 0.009)


def write_cameras(path: Path, block_toml: str) -> None:
    line = next(row for row in block_toml.splitlines() if row.startswith("parameters"))
    given = dict(part.split(" = ") for part in line.split("{ ")[1].rstrip(" }").split(", "))
    entries = []
    for k, offset in enumerate(OFFSETS_MM, start=1):
        values = given | {"c": repr(FOCAL_MM + offset)}
        entries.append(
            f'[[camera]]\nid = "{k}"\nmodel = "brown-ideal"\nunit = "mm"\nsize_px = [3000, 2000]\n'
            f"pitch_mm = 0.0045\nparameters = {{ {', '.join(f'{n} = {v}' for n, v in values.items())} }}\n"
            "sigma = { c = 0.05, x0 = 0.002, y0 = 0.002 }\n"
        )
    path.write_text("\n".join(entries), encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    plan = Plan(tie=45, position_sigma_m=0.02, attitude_sigma_deg=0.02)
    block = fly(tmp_path / "flight", np.random.default_rng(41), plan=plan)
    write_cameras(tmp_path / "sets.toml", (block / "block.toml").read_text(encoding="utf-8"))
    return tmp_path


def test_fourteen_runs(photocal: Photocal, folder: Path) -> None:
    (folder / "experiment.toml").write_text(
        'block = "flight"\nmethods = ["integrated"]\n[interior]\ncameras = "sets.toml"\n', encoding="utf-8"
    )
    said = photocal("check", "--experiment", folder / "experiment.toml", "-o", folder / "out", "--json")
    assert said.code == 0, said.err
    content = json.loads(said.out)
    runs = {(run["interior"], run["use"]): run for run in content["runs"]}
    assert len(runs) == 14
    assert all(run["check"] == 20 and not run["failure"] for run in runs.values())
    fixed = [runs[str(k), "fixed"]["rmse_z_m"] for k in range(1, 8)]
    weighted = [runs[str(k), "weighted"]["rmse_z_m"] for k in range(1, 8)]
    # A wrong principal distance that is held spoils the heights; one that may move does not.
    assert int(np.argmax(fixed)) == 4
    assert fixed[4] > 3 * fixed[0]
    assert max(weighted) < 1.3 * min(weighted)
    assert runs["5", "fixed"]["biased_z"]
    assert runs["5", "fixed"]["rmse_without_trend_z_m"] < runs["5", "fixed"]["rmse_z_m"]
    with (folder / "out" / "runs.csv").open(encoding="utf-8", newline="") as text:
        assert len(list(csv.DictReader(text))) == 14
    # Residuals have the noise that was put in, less what the unknowns took up; a held wrong c adds to it.
    assert 0.28 < runs["1", "weighted"]["residual_x_px"] < 0.4
    assert runs["5", "fixed"]["residual_y_px"] > runs["1", "fixed"]["residual_y_px"]
    exterior = {k: runs[str(k), "fixed"]["exterior_rmse_z_m"] for k in (1, 5)}
    assert exterior[5] > 3 * exterior[1]
    # 0.06 mm of 12 mm at 90 to 130 m, of which the observed positions let through a part.
    assert exterior[5] < 0.06 / 12 * 130
    pairs = {(pair["first"], pair["second"], pair["use"]): pair for pair in content["pairs"]}
    assert len(pairs) == 2 * 21
    d = {k: np.array([point["d_m"] for point in runs[k, "fixed"]["points"]]) for k in "15"}
    rmse = np.sqrt(np.mean((d["1"] - d["5"]) ** 2, axis=0))
    assert [pairs["1", "5", "fixed"][f"check_rmse_{a}_m"] for a in "xyz"] == pytest.approx(rmse.tolist())
    with (folder / "out" / "pairs.csv").open(encoding="utf-8", newline="") as text:
        assert len(list(csv.DictReader(text))) == 2 * 21
    assert (folder / "out" / "rmse.pdf").read_bytes().startswith(b"%PDF")


def test_control_counts_patterns_and_leave_one_out(photocal: Photocal, folder: Path) -> None:
    (folder / "experiment.toml").write_text(
        'block = "flight"\nmethods = ["indirect"]\n[control]\ncounts = [4, 9]\nleave_one_out = true\n'
        '[[control.pattern]]\nname = "one corner"\npoints = ["p0", "p1", "p3", "p4"]\n',
        encoding="utf-8",
    )
    said = photocal("check", "--experiment", folder / "experiment.toml", "-o", folder / "out", "--json")
    assert said.code == 0, said.err
    content = json.loads(said.out)
    assert (folder / "out/rmse_by_control.pdf").read_bytes().startswith(b"%PDF")
    runs = {run["pattern"]: run for run in content["runs"]}
    assert list(runs) == ["one corner", "4 control", "9 control"]
    assert runs["one corner"]["check"] == runs["4 control"]["check"] == 25
    assert runs["9 control"]["check"] == 20
    # Control spread to the corners beats control in one corner, and more control beats less.
    assert runs["4 control"]["predicted_z_m"] < runs["one corner"]["predicted_z_m"]
    assert runs["9 control"]["predicted_z_m"] < runs["4 control"]["predicted_z_m"]
    left = content["leave_one_out"]
    assert [one["point"] for one in left] == [f"p{k}" for k in range(9)]
    w = np.array([[one["wx"], one["wy"], one["wz"]] for one in left])
    assert 0.5 < np.sqrt(np.mean(w**2)) < 1.6


def test_simulated_direct_orientation(photocal: Photocal, folder: Path) -> None:
    """The study's own way: refined orientation with 0.08 m and 0.02 degrees taken as direct."""
    (folder / "experiment.toml").write_text(
        'block = "flight"\nmethods = ["direct", "integrated"]\n[simulated_direct]\nposition_m = 0.08\n'
        "attitude_deg = 0.02\nseed = 3\n",
        encoding="utf-8",
    )
    said = photocal("check", "--experiment", folder / "experiment.toml", "--json")
    assert said.code == 0, said.err
    direct, integrated = json.loads(said.out)["runs"]
    assert (direct["method"], integrated["method"]) == ("direct", "integrated")
    assert 0.6 < direct["errors_over_prediction"] < 1.5
    assert integrated["rmse_z_m"] < direct["rmse_z_m"]


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("block = 3", 5, "block"),
        ('block = "flight"\nmethods = ["guess"]', 5, "methods"),
        ('block = "flight"\n[control]\ncounts = [400]', 5, "400 control points"),
        ('block = "flight"\n[[control.pattern]]\nname = "a"\npoints = ["nobody"]', 5, "nobody"),
        ('block = "flight"\n[[control.pattern]]\nname = "a"\npoints = ["p40"]', 5, "cannot be control"),
        (
            'block = "flight"\n[interior]\ncameras = "sets.toml"\ncamera = "other"',
            5,
            "camera other is not in the block",
        ),
        ('block = "nowhere"', 3, "does not exist"),
        ("block = ", 5, "not valid TOML"),
    ],
)
def test_wrong_files(photocal: Photocal, folder: Path, text: str, code: int, words: str) -> None:
    (folder / "experiment.toml").write_text(text, encoding="utf-8")
    said = photocal("check", "--experiment", folder / "experiment.toml")
    assert said.code == code
    assert words in said.err
    assert said.err.count("\n") == 1


def test_one_camera_of_several_is_exchanged(photocal: Photocal, folder: Path) -> None:
    """The images of the second half have a camera of their own, whose interior orientation stays as given."""
    toml = (folder / "flight/block.toml").read_text(encoding="utf-8")
    entry = toml[toml.index("[[camera]]") : toml.index("[mounting]")]
    second = entry.replace('id = "cam"', 'id = "other"')
    (folder / "flight/block.toml").write_text(toml.replace(entry, entry + second), encoding="utf-8")
    path = folder / "flight/images.csv"
    rows = path.read_text(encoding="utf-8").splitlines()
    half = len(rows) // 2
    path.write_text(
        "\n".join(rows[:half] + [row.replace(",cam,", ",other,") for row in rows[half:]]) + "\n",
        encoding="utf-8",
    )
    text = 'block = "flight"\nmethods = ["integrated"]\n[interior]\ncameras = "sets.toml"\n'
    (folder / "experiment.toml").write_text(text, encoding="utf-8")
    said = photocal("check", "--experiment", folder / "experiment.toml")
    assert (said.code, "several cameras" in said.err) == (5, True)
    (folder / "experiment.toml").write_text(text + 'camera = "other"\nuse = ["fixed"]\n', encoding="utf-8")
    said = photocal("check", "--experiment", folder / "experiment.toml", "--json")
    assert said.code == 0, said.err
    runs = json.loads(said.out)["runs"]
    rmse = [run["rmse_z_m"] for run in runs]
    # The fifth set stands apart, and only half of the images carry it.
    assert int(np.argmax(rmse)) == 4

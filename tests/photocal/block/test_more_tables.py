"""Tables that a run has when they are asked for, and cameras whose lens varies."""

from __future__ import annotations

import csv
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from photocal.base.errors import ConfigurationError
from photocal.block.camera_setup import CameraKeys, make_camera
from photocal.block.options import Wanted, parse_joint
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result
from photocal.products.oriented import oriented
from tests.photocal.blocks import adjusted_json

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as text:
        return list(csv.DictReader(text))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("more") / "run"
    wanted = Wanted(ellipses=0.95, reliability=True, joint="image:3,camera:dcs460,point:1")
    adjusted_json(DEMO, folder, wanted=wanted)
    return folder


def test_the_joint_covariance_holds_the_blocks_of_the_others(run: Path) -> None:
    found = rows(run / "joint_covariance.csv")
    matrix = np.array([[float(row[name["unknown"]]) for name in found] for row in found])
    assert np.array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))).min() > 0
    table = pyarrow.parquet.read_table(run / "covariance.parquet").to_pylist()
    at = 0
    for kind, name in (("image", "3"), ("camera", "dcs460"), ("point", "1")):
        (row,) = (row for row in table if (row["kind"], row["id"]) == (kind, name))
        n = len(row["names"])
        block = matrix[at : at + n, at : at + n]
        assert block[np.tril_indices(n)] == pytest.approx(np.array(row["lower"]), rel=1e-6, abs=1e-12)
        at += n
    assert at == len(matrix)


def test_ellipses_have_the_size_of_their_probability(run: Path) -> None:
    """By hand: a circle of sigma s holds 95 % within s sqrt(-2 ln 0.05); axes and azimuth give back C."""
    table = pyarrow.parquet.read_table(run / "covariance.parquet").to_pylist()
    points = {row["id"]: row["lower"] for row in table if row["kind"] == "point"}
    for row in rows(run / "ellipses.csv"):
        a, b, azimuth = float(row["a"]), float(row["b"]), math.radians(float(row["azimuth"]))
        axes = np.array([[math.sin(azimuth), math.cos(azimuth)], [math.cos(azimuth), -math.sin(azimuth)]])
        xx, xy, yy = points[row["point"]][:3]
        covariance = axes.T @ np.diag([a**2, b**2]) @ axes / (-2 * math.log(0.05))
        assert covariance == pytest.approx(np.array([[xx, xy], [xy, yy]]), rel=1e-6, abs=1e-12)


def test_reliability_follows_from_the_redundancy(run: Path) -> None:
    """Baarda's 4.13 sigma over the root of the redundancy number."""
    redundancy = {(row["image"], row["point"]): float(row["rx"]) for row in rows(run / "residuals.csv")}
    found = rows(run / "reliability.csv")
    assert len(found) == len(redundancy)
    for row in found:
        expected = 4.132 * 0.003 / math.sqrt(redundancy[row["image"], row["point"]])
        assert float(row["mdb_x"]) == pytest.approx(expected, rel=1e-3)


def edited(tmp_path: Path, old: str, new: str) -> Path:
    folder = tmp_path / "block"
    shutil.copytree(DEMO, folder)
    text = (folder / "block.toml").read_text("utf-8")
    assert old in text
    (folder / "block.toml").write_text(text.replace(old, new), "utf-8")
    return folder


def test_photo_variant_principal_points_lower_the_residuals_as_published(tmp_path: Path) -> None:
    """The study's 24 extra parameters, of which two replace x0 and y0, take the rms to 1.1 micrometres."""
    estimate = 'estimate = ["c", "x0", "y0", "K1", "K2", "K3", "P1", "P2"]'
    varied = 'estimate = ["c", "K1", "K2", "K3", "P1", "P2"]\nphoto_variant = { x0 = "free", y0 = "free" }'
    block = edited(tmp_path, estimate, varied)
    text = (block / "block.toml").read_text("utf-8").replace(" x0 = 1.0, y0 = 1.0,", "")
    (block / "block.toml").write_text(text, "utf-8")
    result = adjusted_json(block, tmp_path / "run")
    plain = adjusted_json(DEMO, tmp_path / "plain")
    images = plain["images"]["n"]
    assert result["unknowns"] == plain["unknowns"] - 2 + 2 * images
    rays = sum(image["rays"] for image in result["images"]["rms"])
    squares = sum(
        image["rays"] * (image["rms_x"] ** 2 + image["rms_y"] ** 2) for image in result["images"]["rms"]
    )
    assert 1000 * math.sqrt(squares / (2 * rays)) == pytest.approx(1.1, abs=0.05)
    # A format with one lens for all images would lose them without a word.
    with pytest.raises(ConfigurationError, match="x0, y0 from image to image"):
        adjusted_block(read_result(tmp_path / "run"))[0]
    with pytest.raises(ConfigurationError, match="vary from image to image"):
        oriented(block, tmp_path / "run")
    table = rows(tmp_path / "run" / "photo_variant.csv")
    assert [row["parameter"] for row in table] == ["x0", "y0"] * images


def test_estimated_components_are_reported_and_used(tmp_path: Path) -> None:
    result = adjusted_json(DEMO, tmp_path / "run", wanted=Wanted(components=True))
    factor = {one["name"]: one["factor"] for one in result["variance_components"]}
    assert set(factor) == {"image dcs460", "control", "camera"}
    # With its own components every group's v'Pv equals its redundancy.
    for group in result["groups"]:
        assert group["chi_squared"] == pytest.approx(group["redundancy"], rel=1e-3)
    json.dumps(result, allow_nan=False)


def keys(**changes: Any) -> CameraKeys:
    return CameraKeys.model_validate(
        {"id": "a", "model": "brown-ideal", "unit": "mm", "size_px": [3000, 2000], "pitch_mm": 0.009,
         "parameters": {"c": 50.0}} | changes
    )  # fmt: skip


def test_a_focus_between_two_calibrations() -> None:
    calibrations = [{"distance_m": math.inf, "K1": -0.9e-4}, {"distance_m": 1.0, "K1": -1.2e-4}]
    own = make_camera(keys(focus={"distance_m": 2.0, "calibrations": calibrations}), "block.toml")
    a = (1 - 0.05) / (2 - 0.05)
    expected = (1 - 0.025) ** 3 * (a * -1.2e-4 / 0.95**3 + (1 - a) * -0.9e-4)
    assert own.value("K1") == pytest.approx(expected, rel=1e-12)
    assert own.focus_m == 2.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"photo_variant": {"k1": 1.0}}, "k1, which is not a camera parameter"),
        ({"photo_variant": {"c": "free"}, "estimate": ["c"]}, "free in every image"),
        ({"focus": {"distance_m": 0.04}}, "not beyond c"),
        ({"focus": {"distance_m": 2.0}, "unit": "px", "pitch_mm": None}, "needs c in mm"),
        ({"focus": {"distance_m": 2.0, "calibrations": [{"distance_m": 1.0}]}}, "give two calibrations"),
    ],
)
def test_what_cannot_be(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        make_camera(keys(**changes), "block.toml")


def test_names_of_joint_unknowns() -> None:
    assert parse_joint("image:12, camera:a,mounting") == (
        ("image", "12"),
        ("camera", "a"),
        ("mounting", ""),
    )
    for wrong in ("images:12", "image", "mounting:x"):
        with pytest.raises(ConfigurationError, match="names no unknowns"):
            parse_joint(wrong)

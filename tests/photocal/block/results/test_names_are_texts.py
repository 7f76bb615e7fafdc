"""Names that look like numbers come through every reader, writer and export as they were."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

import photocal
from photocal.base.codec import same
from photocal.base.errors import PhotocalError
from photocal.base.geodesy import GeodeticPlace
from photocal.block.model import Block
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result, write_result
from photocal.block.results.result import Result
from photocal.block.writer import write_block
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import FORMATS, read_foreign_block
from photocal.navigation.image_checks import oriented_images

NAMES = ("00001", "1e5", "NaN", "TRUE", "007", "null", "1.0", "-0", "1_000", "2026-11-22", "0x10", "inf")
# These number their points and images, or give images numbers of their own.
NUMBERED = {
    "colmap": "points",
    "colmap-binary": "points",
    "jaicov": "both",
    "opf": "points",
    "photomodeler": "points",
    "dbat": "both",
}
CHOICES = Choices("deg", GeodeticPlace(-22.0, -51.0, 400.0))


def simulated() -> Block:
    rng = np.random.default_rng(4)
    count = len(NAMES)
    points = rng.uniform([-2, -2, 0], [2, 2, 1], (count, 3))
    lens = photocal.camera(
        "007", "brown-ideal", "mm", (4000, 3000), (0.004, 0.004), {"c": 14.6}, estimate=("c",)
    )
    angles = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), np.arange(count) * np.pi / 6])
    places = np.column_stack([6 * np.sin(angles[:, 1]), -6 * np.sin(angles[:, 0]), np.full(count, 7.0)])
    poses = np.hstack([angles, places])
    images = photocal.OrientedImages(NAMES, (lens,), np.zeros(count, int), poses)
    pixels = np.array([images.project(np.full(count, k), points) for k in range(count)])
    pixels += rng.normal(0, 0.3, pixels.shape)
    block = photocal.block_of_arrays(
        points,
        pixels,
        lens,
        sigma_px=0.3,
        sigma_m=0.001,
        point_names=NAMES,
        image_names=NAMES,
    )
    return replace(block, images=replace(block.images, values=poses))


@pytest.fixture(scope="module")
def result() -> Result:
    return photocal.adjust(simulated())


def test_a_block_folder_keeps_them(tmp_path: Path) -> None:
    cross = np.zeros((len(NAMES), 3))
    cross[0] = 2e-7, -1e-7, 3e-7
    block = replace(simulated(), points=replace(simulated().points, cross=cross))
    for kind, value in (("distance", 2.5), ("azimuth", 0.1), ("height_difference", -0.25)):
        block = photocal.with_relations(block, kind, [(NAMES[0], NAMES[-1], value, 0.001)])
    for kind, value in (("vertical_angle", -0.2), ("horizontal_angle", 1.5), ("line", 0.0)):
        ends = (NAMES[0], NAMES[-1]) if kind == "vertical_angle" else (NAMES[0], NAMES[-1], NAMES[1])
        block = photocal.with_relations(block, kind, [(*ends, value, 0.001)])
    write_block(tmp_path, block)
    for again in (photocal.read_block(tmp_path), _of_parquet(tmp_path)):
        assert again.images.names == again.points.names == NAMES
        assert again.cameras[0].id == "007"
        assert np.array_equal(again.observations.image, block.observations.image)
        assert np.array_equal(again.observations.point, block.observations.point)
        assert again.points.cross is not None
        assert np.array_equal(again.points.cross, cross)
        order = np.argsort(again.relations.kind)
        for name in ("ends", "values", "sigma"):
            ours = getattr(block.relations, name)[np.argsort(block.relations.kind)]
            # Tables have eight decimals, angles in degrees.
            np.testing.assert_allclose(getattr(again.relations, name)[order], ours, atol=1e-9)


def test_adjusted_cameras_are_equal_when_they_are_read_again(result: Result, tmp_path: Path) -> None:
    photocal.write_cameras(tmp_path / "cameras.toml", tuple(result.cameras.values()))
    assert same(photocal.read_cameras(tmp_path / "cameras.toml"), tuple(result.cameras.values()))
    result.write(tmp_path / "run")
    again = Result.read(tmp_path / "run")
    # Gusts act on rolling shutters only, and stand in the result of these.
    assert same(again.cameras, result.cameras, but=("gust",))
    assert (again.chi_squared, again.images.names) == (result.chi_squared, result.images.names)


def _of_parquet(folder: Path) -> Block:
    """Observations as a program writes them that knows texts, and one that made them categories."""
    text = pyarrow.csv.ConvertOptions(
        column_types={"image": "string", "point": "string"}, strings_can_be_null=False
    )
    table = pyarrow.csv.read_csv(folder / "observations.csv", convert_options=text)
    column = table["image"].dictionary_encode()
    pyarrow.parquet.write_table(table.set_column(0, "image", column), folder / "observations.parquet")
    (folder / "observations.csv").unlink()
    return photocal.read_block(folder)


def test_a_run_folder_keeps_them(result: Result, tmp_path: Path) -> None:
    write_result(tmp_path, result)
    again = read_result(tmp_path)
    assert list(again.cameras) == ["007"]
    assert again.images.names == again.points.names == NAMES
    np.testing.assert_allclose(again.images.covariances, result.images.covariances, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(again.points.covariance, result.points.covariance, rtol=1e-12)
    for name in ("images.csv", "points.csv"):
        with (tmp_path / name).open(encoding="utf-8", newline="") as stream:
            assert tuple(row[0] for row in list(csv.reader(stream))[1:]) == NAMES
    found = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert tuple(row["image"] for row in found["images"]["rms"]) == NAMES
    assert oriented_images(tmp_path, list(NAMES)).names == NAMES
    # Written again it is the same to the last byte, but for angles that went to radians and back.
    (tmp_path / "again").mkdir()
    write_result(tmp_path / "again", again)
    for name in ("points.csv", "residuals.csv", "result.json"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / name).read_bytes(), name
    np.testing.assert_allclose(read_result(tmp_path / "again").images.values, again.images.values, rtol=1e-15)


@pytest.mark.parametrize("form", [form for form in FORMATS if form.writes], ids=lambda form: form.name)
def test_exports_keep_them(form: object, result: Result, tmp_path: Path) -> None:
    assert isinstance(form, type(FORMATS[0]))
    given = adjusted_block(result)[0]
    if form.name == "odm":
        given = replace(given, frame="EPSG:32722", height="ellipsoidal")
    if form.name in NUMBERED:
        # What has numbers for names refuses others, or keeps them apart: never turns one into another.
        _refused_or_apart(form, given, tmp_path)
        return
    form.write(tmp_path, given, CHOICES)
    if not form.reads:
        files = [path for path in tmp_path.rglob("*") if path.is_file()]
        text = "".join(path.name + path.read_bytes().decode("latin-1") for path in files)
        wanted = ("007",) if form.holds == ("cameras",) else NAMES
        assert all(name in text for name in wanted)
        return
    again = form.read(tmp_path).block
    if "orientations" in form.holds:
        assert again.images.names == NAMES
    if "points" in form.holds:
        assert set(again.points.names) == set(NAMES)
    taken = [path for path in sorted(tmp_path.rglob("*")) if form.detect(path)]
    if len(taken) == 1:
        assert set(read_foreign_block(taken[0]).points.names) == set(NAMES)


def _refused_or_apart(form: object, given: Block, folder: Path) -> None:
    assert isinstance(form, type(FORMATS[0]))
    try:
        form.write(folder, given, CHOICES)
        again = form.read(folder).block
    except PhotocalError:
        return
    assert len(set(again.points.names)) == len(NAMES)
    if NUMBERED[form.name] == "points":
        assert again.images.names == NAMES

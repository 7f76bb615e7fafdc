"""Machine readings become image coordinates over the corners of the frame: DCS460, photo 1."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError
from photocal.block.folder import read_block
from tests.photocal.blocks import adjusted_json

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "photocal" / "demo" / "dcs460"
PUBLISHED = ROOT / "tests" / "reference" / "dcs460"
CORNERS = {"1": (-13.8, 9.2), "2": (13.8, 9.2), "3": (13.8, -9.2), "4": (-13.8, -9.2)}


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def write(path: Path, header: str, rows: list[tuple[object, ...]]) -> None:
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The published readings of photo 1 in its place, the other photos as hundredths of its pixels."""
    block = tmp_path / "block"
    shutil.copytree(DEMO, block)
    text = (block / "block.toml").read_text("utf-8")
    (block / "block.toml").write_text(text.replace('axes = "photo"', 'axes = "photo"\nreadings = "affine"'))
    first = table(PUBLISHED / "photo01_reading_1a_machine.csv")
    read = {row["id"]: (row["col_centipx"], row["row_centipx"]) for row in first if row["kind"] == "point"}
    corner = {row["id"]: (row["col_centipx"], row["row_centipx"]) for row in first if row["kind"] != "point"}
    rows: list[tuple[object, ...]] = []
    for row in table(block / "observations.csv"):
        x, y = float(row["x"]), float(row["y"])
        own = ((x + 13.8) * 306005 / 27.6 - 6, (y - 9.2) * 203607 / 18.4 + 9)
        # Point 27 of the first reading is a slip of the reader.
        published = row["image"] == "1" and row["point"] in read and row["point"] != "27"
        rows.append((row["image"], row["point"], *(read[row["point"]] if published else own)))
    write(block / "observations.csv", "image,point,x,y", rows)
    names = [row["image"] for row in table(block / "images.csv")]
    write(
        block / "fiducials.csv",
        "camera,fiducial,x,y",
        [("dcs460", name, *xy) for name, xy in CORNERS.items()],
    )
    write(
        block / "fiducial_readings.csv",
        "image,fiducial,x,y",
        [(image, name, *corner[name]) for image in names for name in CORNERS],
    )
    return block


def test_photo_1_comes_out_as_published(folder: Path) -> None:
    """One reading against the printed means of three: 1.6 and 1.9 micrometres."""
    block = read_block(folder)
    mean = {row["point"]: (row["x_mm"], row["y_mm"]) for row in table(PUBLISHED / "photo01_mean_mm.csv")}
    reading = {row["id"] for row in table(PUBLISHED / "photo01_reading_1a_machine.csv")}
    image = block.images.names.index("1")
    away = [
        values - np.array(mean[block.points.names[j]], dtype=float)
        for i, j, values in zip(
            block.observations.image, block.observations.point, block.observations.values, strict=True
        )
        if i == image and block.points.names[j] in reading & set(mean) - {"27"}
    ]
    assert len(away) > 30
    assert 1000 * np.sqrt(np.mean(np.square(away), axis=0)) == pytest.approx([1.6, 1.9], abs=0.1)
    assert {file.path for file in block.inputs} >= {"fiducials.csv", "fiducial_readings.csv"}


def test_the_adjustment_says_how_the_fiducials_fit(folder: Path, tmp_path: Path) -> None:
    result = adjusted_json(folder, tmp_path / "run")
    plain = adjusted_json(DEMO, tmp_path / "plain")
    c = [one["cameras"]["dcs460"]["parameters"]["c"] for one in (result, plain)]
    # One of three readings instead of their mean, in one photo of twelve or so.
    assert abs(c[0]["value"] - c[1]["value"]) < 0.5 * c[1]["sigma"]
    assert len(result["fiducials"]) == result["images"]["n"]
    fit = result["fiducials"][0]
    assert fit["sigma0"] < 1e-3
    assert [row["fiducial"] for row in fit["residuals"]] == ["1", "2", "3", "4"]


def test_what_cannot_be(folder: Path) -> None:
    readings = (folder / "fiducial_readings.csv").read_text("utf-8")
    (folder / "fiducial_readings.csv").write_text(readings.replace("3,4,", "3,9,", 1), "utf-8")
    with pytest.raises(InputMalformedError, match="no such fiducial"):
        read_block(folder)
    lines = readings.splitlines()
    (folder / "fiducial_readings.csv").write_text(
        "\n".join(line for line in lines if not line.startswith("3,")) + "\n", "utf-8"
    )
    with pytest.raises(IllPosedError, match="image 3"):
        read_block(folder)
    text = (folder / "block.toml").read_text("utf-8")
    (folder / "block.toml").write_text(text.replace('unit = "mm"\naxes', 'unit = "px"\naxes', 1), "utf-8")
    with pytest.raises(ConfigurationError, match="in mm"):
        read_block(folder)

"""Pictures in several plain folders, by `photocal new`: one flight, two flights, copies, another camera."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from photocal.block.project import read_project
from photocal.measurement.image_file import list_images
from photocal.measurement.marks import read_marks
from tests.photocal.run.test_exported_tables import Photocal

START = dt.datetime(2025, 6, 15, 14, 0, 0)


def picture(
    path: Path,
    number: int,
    *,
    hours: float = 0.0,
    serial: str = "S1",
    software: str = "",
    size: tuple[int, int] = (160, 120),
) -> None:
    """Write the picture that a camera takes as its nth: 2 s and 10 m after the one before."""
    exif, taken = Image.Exif(), START + dt.timedelta(hours=hours, seconds=2 * number)
    exif[0x010F], exif[0x0110] = "Maker", "TestCam"
    if software:
        exif[0x0131] = software
    own, gps = exif.get_ifd(0x8769), exif.get_ifd(0x8825)
    own[0x9003], own[0xA431] = taken.strftime("%Y:%m:%d %H:%M:%S"), serial
    for key, value in ((2, 25.4483 - number * 1e-4), (4, 49.2311)):
        gps[key] = (IFDRational(int(value)), IFDRational(0), IFDRational(value % 1 * 3600))
    gps[1], gps[3], gps[6] = "S", "W", IFDRational(1000)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((size[1], size[0]), number, dtype=np.uint8)).save(path, exif=exif)


def put(folder: Path, numbers: Sequence[int], prefix: str = "IMG_", **how: Any) -> None:
    for number in numbers:
        picture(folder / f"{prefix}{number:04}.jpg", number, **how)


def new(photocal: Photocal, folder: Path) -> tuple[dict[str, list[str]], list[Path]]:
    """What is said of a folder, and the pictures of its project."""
    said = photocal("new", folder, "--json")
    assert said.code == 0, said.err
    found: dict[str, list[str]] = json.loads(said.out)
    return found, list(list_images(read_project(folder / "project.toml").picture_folder))


def test_folders_of_one_flight_are_used_together(tmp_path: Path, photocal: Photocal) -> None:
    put(tmp_path / "IMG 1", range(5))
    put(tmp_path / "IMG 2", range(5, 8))
    (tmp_path / "gcps.csv").write_text("name,E,N,h ell\nG1,677864,7184231,912\n")
    (tmp_path / "marks.txt").write_text("IMG_0001.jpg,G1,20.5,30.5\nIMG_0006.jpg,G1,21.5,31.5\n")
    found, pictures = new(photocal, tmp_path)
    assert [path.parent.name for path in pictures] == ["IMG 1"] * 5 + ["IMG 2"] * 3
    assert "pictures of one camera and flight in 2 folders (IMG 1, IMG 2): used together" in found["found"]
    assert [mark.image for mark in read_marks(tmp_path / "marks.csv")] == ["IMG_0001.jpg", "IMG_0006.jpg"]


def test_another_flight_is_named_with_what_would_use_both(tmp_path: Path, photocal: Photocal) -> None:
    put(tmp_path / "a", range(5))
    put(tmp_path / "b", range(5, 8), hours=1.5)
    found, pictures = new(photocal, tmp_path)
    assert {path.parent.name for path in pictures} == {"a"}
    (told,) = (line for line in found["missing"] if "another flight" in line)
    assert "3 pictures of the same camera in b, taken 1.5 h apart" in told
    pattern = told.split('"')[1]
    assert len(list_images(tmp_path / pattern)) == 8


def test_another_camera_of_the_model_is_named(tmp_path: Path, photocal: Photocal) -> None:
    put(tmp_path / "a", range(5))
    put(tmp_path / "b", range(5, 8), serial="S2")
    found, pictures = new(photocal, tmp_path)
    assert {path.parent.name for path in pictures} == {"a"}
    assert any("another camera (TestCam S2) in b" in line for line in found["missing"])


@pytest.mark.parametrize("prefix", ["IMG_", "copy_"])
def test_edited_copies_give_way_to_originals(tmp_path: Path, photocal: Photocal, prefix: str) -> None:
    put(tmp_path / "edited", range(5), prefix, software="Adobe Photoshop Lightroom 6.0 (Windows)")
    put(tmp_path / "originals", range(5))
    found, pictures = new(photocal, tmp_path)
    assert {path.parent.name for path in pictures} == {"originals"}
    assert any("5 pictures in edited are the same exposures" in line for line in found["missing"])


def test_edited_pictures_are_told(tmp_path: Path, photocal: Photocal) -> None:
    put(tmp_path, range(5))
    put(tmp_path, range(3, 5), software="GIMP 2.10.34")
    found, _ = new(photocal, tmp_path)
    assert any("2 of 5 pictures were saved by GIMP 2.10.34" in line for line in found["missing"])


def test_thumbnails_are_no_second_head(tmp_path: Path, photocal: Photocal) -> None:
    put(tmp_path / "originals", range(12))
    put(tmp_path / "small", range(12), "t_", size=(80, 60))
    found, pictures = new(photocal, tmp_path)
    assert {path.parent.name for path in pictures} == {"originals"}
    assert not any("on one frame" in line for line in found["found"])

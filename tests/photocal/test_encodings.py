"""Marks of editors before UTF-8, other encodings, and names that are in none."""

from __future__ import annotations

import codecs
import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner

from acquire.commands.cli import app as acquire
from acquire.recording.configuration import read_configuration
from photocal.analysis.accuracy.standard import load_standard
from photocal.base.checked_toml import read_tables
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.text_tables import read_columns
from photocal.block.folder import read_block
from photocal.block.project import read_project
from photocal.measurement.image_file import list_images
from photocal.measurement.image_metadata import read_images
from photocal.run.calibrations import is_camera_file
from photocal.run.new_project import new_project

DCS460 = Path(__file__).parents[2] / "photocal/demo/dcs460"
PROJECT = '[project]\nname = "á"\ncrs = "local"\nheight = "local"\noutput = "work"\n'
RECORDER = '[recording]\noutput = "logs"\n[[link]]\nname = "v"\nprotocol = "mavlink"\nurl = "udp://:1"\n'


def marked(path: Path, text: str) -> Path:
    path.write_bytes(codecs.BOM_UTF8 + text.encode())
    return path


def test_a_project_with_a_mark_is_read(tmp_path: Path) -> None:
    assert read_project(marked(tmp_path / "project.toml", PROJECT)).name == "á"


def test_the_recorder_takes_a_mark(tmp_path: Path) -> None:
    read_configuration(marked(tmp_path / "flight.toml", RECORDER))
    answer = CliRunner().invoke(acquire, ["check", str(tmp_path / "nothing.toml")])
    assert answer.exit_code != 0


def test_a_block_whose_every_file_has_a_mark_is_the_same(tmp_path: Path) -> None:
    copy = tmp_path / "block"
    shutil.copytree(DCS460, copy)
    for path in copy.iterdir():
        if path.suffix in (".toml", ".csv"):
            path.write_bytes(codecs.BOM_UTF8 + path.read_bytes())
    ours, plain = read_block(copy), read_block(DCS460)
    assert ours.points.names == plain.points.names
    assert ours.images.names == plain.images.names
    assert (ours.observations.values == plain.observations.values).all()


def test_a_table_of_times_a_standard_and_a_file_of_cameras_take_a_mark(tmp_path: Path) -> None:
    times = marked(tmp_path / "times.csv", "image,taken\na.jpg,2026-05-01T10:00:00\n")
    assert [image.name for image in read_images(times)] == ["a.jpg"]
    shipped = DCS460.parents[1] / "analysis/accuracy/standards/pec-pcd.toml"
    assert load_standard(str(marked(tmp_path / "own.toml", shipped.read_text(encoding="utf-8"))))
    assert not is_camera_file(marked(tmp_path / "other.toml", PROJECT))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_named_with_the_remedy(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "project.toml"
    path.write_bytes(PROJECT.encode(encoding))
    with pytest.raises(ConfigurationError, match=r"project\.toml: is UTF-16, not UTF-8; save it as UTF-8"):
        read_tables(path)


def test_tables_of_utf_16_are_read(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes("point,X\ná,1.5\n".encode("utf-16"))
    assert read_columns(path).texts("point") == ("á",)


def test_formulas_stay_as_data(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("image,x\n=cmd|x!A1.jpg,1\n", encoding="utf-8")
    assert read_columns(path).texts("image") == ("=cmd|x!A1.jpg",)


def picture(folder: Path, name: bytes) -> Path:
    folder.mkdir(exist_ok=True)
    Image.new("L", (64, 48)).save(folder / "made.png")
    path = folder / os.fsdecode(name)
    (folder / "made.png").rename(path)
    return path


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no names that are not in Unicode")
def test_a_picture_whose_name_is_not_utf_8_is_refused_when_it_is_listed(tmp_path: Path) -> None:
    picture(tmp_path, b"x\xff.png")
    with pytest.raises(InputMalformedError, match="the name of this picture is not in UTF-8"):
        list_images(tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no names that are not in Unicode")
def test_a_new_project_names_it_and_goes_on(tmp_path: Path) -> None:
    picture(tmp_path, b"x\xff.png")
    picture(tmp_path, "á =cmd|x!A1.png".encode())
    made = new_project(tmp_path)
    assert any("not in UTF-8" in line for line in made.missing)
    assert any("1 picture" in line for line in made.known)


def test_names_that_no_text_can_hold_are_refused_in_json(tmp_path: Path) -> None:
    from photocal.exchange.source import read_json

    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"name": "\ud800"}), encoding="ascii")
    with pytest.raises(InputMalformedError, match="surrogates not allowed"):
        read_json(path)


@pytest.mark.parametrize(
    "size", ["[2000000000, 2000000000]", "[100001, 10]", "[0, 10]", "[1.5, 2]", "[nan, 1]"]
)
def test_impossible_sizes_are_refused_with_their_limit(size: str, tmp_path: Path) -> None:
    copy = tmp_path / "block"
    shutil.copytree(DCS460, copy)
    text = (copy / "block.toml").read_text(encoding="utf-8")
    (copy / "block.toml").write_text(
        "\n".join(f"size_px = {size}" if line.startswith("size_px") else line for line in text.splitlines()),
        encoding="utf-8",
    )
    with pytest.raises(ConfigurationError, match="size_px") as refused:
        read_block(copy)
    if size[1:4] in ("200", "100"):
        assert "less than or equal to 100000" in str(refused.value)

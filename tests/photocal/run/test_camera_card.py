"""`photocal new` on the card of a DJI camera, as it comes out of the aircraft."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from photocal.block.project import read_project
from photocal.measurement.image_file import list_images

DATA = Path(__file__).parents[4] / "shared" / "data" / "dji-xmp"
THERMAL = sorted((DATA / "h20t").glob("*.JPG"))
MULTISPECTRAL = sorted((DATA / "p4m").glob("*.JPG"))
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="recorded pictures are not here")
MISSIONS = ("DJI_202206021430_001_roof", "DJI_202206021500_002_roof")


def copied(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def new(folder: Path) -> dict[str, Any]:
    """Look at a folder through the command line."""
    done = subprocess.run(
        [sys.executable, "-m", "photocal", "new", str(folder), "--json"],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def card_of_two_lenses(card: Path) -> None:
    """Two missions of a gimbal with two lenses, and all that such a card holds beside them."""
    for k, path in enumerate(THERMAL):
        mission = card / "DCIM" / MISSIONS[k // 3]
        copied(path, mission / path.name)
        copied(path, mission / path.name.replace("_T.", "_W."))
        (mission / f"{path.stem}.SRT").write_text("1\n00:00:00,000 --> 00:00:00,033\n")
    copied(THERMAL[0], card / "DCIM" / MISSIONS[0] / "DJI_20220602143700_0216_S.JPG")
    copied(THERMAL[0], card / "DCIM" / "PANORAMA" / "100_0001" / "DJI_0001.JPG")
    copied(THERMAL[0], card / "MISC" / "THM" / "100" / "DJI_0001.JPG")
    (card / "DCIM" / MISSIONS[0] / "DJI_202206021430_001_roof_PPKRAW.bin").write_bytes(b"\xd3\x00\x13" * 9)


def test_pictures_are_sorted_by_lens_and_flight(tmp_path: Path) -> None:
    card_of_two_lenses(tmp_path)
    answer = new(tmp_path)
    assert len(answer["asked"]) <= 2
    known = "\n".join(answer["found"])
    assert "lens W (wide): 6 pictures of 2 flights (3 from 2022-06-02 14:36:04; 3 from" in known
    assert "lens T (thermal): 6 pictures of 2 flights" in known
    assert "1 panoramas: left out" in known
    assert "1 thumbnails: left out" in known
    assert "1 pictures of the screen: left out" in known
    pictures = list_images(read_project(tmp_path / "project.toml").picture_folder)
    assert [path.name for path in pictures] == [path.name.replace("_T.", "_W.") for path in THERMAL]


def test_a_list_of_exposures_goes_to_its_own_flight_alone(tmp_path: Path) -> None:
    """Both missions may count from 1: the list of one says nothing of the pictures of the other."""
    card_of_two_lenses(tmp_path)
    event = "{}\t394562.1\t[2212]\t1,N\t1,E\t1,V\t47.1,Lat\t11.2,Lon\t900.0,Ellh\t0.01, 0.01, 0.02\t50,Q\n"
    rows = "".join(event.format(k) for k in range(210, 213))
    (tmp_path / "DCIM" / MISSIONS[0] / f"{MISSIONS[0]}_Timestamp.MRK").write_text(rows)
    answer = new(tmp_path)
    assert any("each flight numbers its exposures anew" in line for line in answer["missing"])
    assert read_project(tmp_path / "project.toml").images.positions is None


def test_folders_whose_names_come_twice_are_not_mixed(tmp_path: Path) -> None:
    for path in MULTISPECTRAL:
        copied(path, tmp_path / "DCIM" / "100MEDIA" / path.name)
    copied(MULTISPECTRAL[0], tmp_path / "DCIM" / "101MEDIA" / MULTISPECTRAL[0].name)
    answer = new(tmp_path)
    assert any("DCIM/101MEDIA" in line and "names that come twice" in line for line in answer["missing"])
    pictures = list_images(read_project(tmp_path / "project.toml").picture_folder)
    assert [path.parent.name for path in pictures] == ["100MEDIA"] * len(MULTISPECTRAL)


def test_a_card_of_one_lens_in_two_folders_is_one_project(tmp_path: Path) -> None:
    for k, path in enumerate(MULTISPECTRAL):
        copied(path, tmp_path / "DCIM" / f"{100 + k % 2}MEDIA" / path.name)
    new(tmp_path)
    pictures = list_images(read_project(tmp_path / "project.toml").picture_folder)
    assert [path.name for path in pictures] == [path.name for path in MULTISPECTRAL]


def test_a_folder_of_one_flight_stays_what_it_is(tmp_path: Path) -> None:
    for path in MULTISPECTRAL:
        copied(path, tmp_path / "100MEDIA" / path.name)
    new(tmp_path)
    assert 'folder = "100MEDIA"' in (tmp_path / "project.toml").read_text(encoding="utf-8")

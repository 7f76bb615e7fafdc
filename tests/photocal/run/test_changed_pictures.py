"""Pictures that are not as their camera wrote them: reduced, cropped, turned, copied, or of another kind."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from PIL import Image

from tests.photocal.run.test_exported_tables import Photocal

# A Phantom 4 Multispectral: c and middle of the picture as its tag has them, px of 1600 x 1300.
DEWARP = "2022-03-02;1956.0,1956.0,-12.0,-11.4,-0.42,0.37,0.0,0.0,-0.26"
XMP = 'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:DewarpFlag="0" '
XMP += f'drone-dji:DewarpData="{DEWARP}"'
PLAIN = 'xmlns:x="x"'
# 5 mm at 1.5 um: c = 3333.3 px of 4000 x 3000.
FULL, FOCAL_MM, PER_CM, C_PX = (4000, 3000), 5, 6666.667, 3333.3


def write(
    path: Path, size: tuple[int, int], xmp: str = PLAIN, full: tuple[int, int] = FULL, second: int = 0
) -> None:
    """Write a picture of one size that says that its camera wrote another."""
    exif = Image.Exif()
    exif[0x0110] = "FC6360" if "drone-dji" in xmp else "TestCam"
    own = exif.get_ifd(0x8769)
    own[0xA002], own[0xA003] = full
    own[0x9003] = f"2026:03:02 10:00:{second:02}"
    if "drone-dji" in xmp:
        own[0xA405] = 40
    else:
        own[0x920A], own[0xA20E], own[0xA210] = FOCAL_MM, PER_CM, 3
    packet = f"<x:xmpmeta><rdf:Description {xmp}/></x:xmpmeta>".encode()
    path.parent.mkdir(exist_ok=True)
    Image.effect_noise(size, 9).save(path, exif=exif, xmp=packet)


def found(photocal: Photocal, folder: Path) -> tuple[str, list[float]]:
    """What `photocal new` says, and the c of the cameras."""
    said = photocal("new", folder, "--json")
    assert said.code == 0, said.err
    parts = json.loads(said.out)
    text = (folder / "project.toml").read_text()
    return "\n".join(parts["found"] + parts["missing"]), [
        float(c) for c in re.findall(r"parameters = { c = ([\d.]+)", text)
    ]


@pytest.mark.parametrize(
    ("size", "c", "told"),
    [
        (FULL, C_PX, ""),
        ((2000, 1500), C_PX / 2, "2000 x 1500 px stored, 4000 x 3000 px written by the camera: reduced"),
        ((3600, 2800), C_PX, "3600 x 2800 px stored, 4000 x 3000 px written by the camera: cropped"),
        # Turned by a quarter, with its pixels: the lens is as long as before.
        ((3000, 4000), C_PX, ""),
    ],
)
def test_c_is_in_the_pixels_that_are_stored(
    tmp_path: Path, photocal: Photocal, size: tuple[int, int], c: float, told: str
) -> None:
    for k in range(2):
        write(tmp_path / f"a{k}.jpg", size, second=k)
    text, lengths = found(photocal, tmp_path)
    assert lengths == [pytest.approx(c, rel=1e-3)]
    assert told in text
    assert bool(told) == ("written by the camera" in text)


@pytest.mark.parametrize("full", [(1600, 1300), (800, 650)])
def test_a_makers_tag_is_of_the_whole_picture(
    tmp_path: Path, photocal: Photocal, full: tuple[int, int]
) -> None:
    """Of a picture of half the size, whether EXIF still says the size that was written or not."""
    for k in range(2):
        write(tmp_path / f"a{k}.jpg", (800, 650), XMP, full, second=k)
    _, lengths = found(photocal, tmp_path)
    # Of the equivalent, 40 mm, without a tag that may be right.
    assert lengths == [pytest.approx(978.0 if full == (1600, 1300) else 952.9, rel=1e-3)]


def test_copies_in_another_format_are_no_second_camera(tmp_path: Path, photocal: Photocal) -> None:
    for k in range(3):
        write(tmp_path / "jpg" / f"a{k}.jpg", (400, 300), second=10 * k)
        write(tmp_path / "tif" / f"a{k}.tif", (400, 300), second=10 * k)
    text, lengths = found(photocal, tmp_path)
    assert "are the same exposures" in text
    assert len(lengths) == 1


def test_pictures_that_are_not_read_are_named(tmp_path: Path, photocal: Photocal) -> None:
    """A raw picture beside its own JPEG needs no word."""
    write(tmp_path / "a0.jpg", (400, 300))
    for name in ("a0.DNG", "b1.HEIC", "b2.HEIC"):
        (tmp_path / name).write_bytes(bytes(100))
    text, _ = found(photocal, tmp_path)
    assert "2 pictures are not read (.heic)" in text
    assert ".dng" not in text


def test_a_folder_of_raw_pictures_alone_is_told(tmp_path: Path, photocal: Photocal) -> None:
    (tmp_path / "a0.CR2").write_bytes(bytes(100))
    said = photocal("new", tmp_path)
    assert said.code == 3
    assert "1 picture is not read (.cr2): save them as JPEG or TIFF" in said.err

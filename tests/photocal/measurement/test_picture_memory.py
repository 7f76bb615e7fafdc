"""Pictures against the memory of the computer, and heads that are read without the pixels."""

from __future__ import annotations

import struct
import sys
import zlib
from pathlib import Path

import pytest
from PIL import Image

from photocal.base.operating_system import available_memory
from photocal.measurement import image_file
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import PictureTooLargeError, each_picture, read_grey

XMP = '<x:xmpmeta><rdf:Description drone-dji:RelativeAltitude="+61.5"/></x:xmpmeta>'


@pytest.mark.skipif(sys.platform != "linux", reason="reads what Linux says of its memory")
def test_the_memory_that_is_free_is_less_than_all() -> None:
    told = dict(line.split(":") for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines())
    free = available_memory()
    assert free is not None
    assert 1 << 20 < free < 1024 * int(told["MemTotal"].split()[0])


def test_a_picture_beyond_the_memory_is_named_and_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large.png"
    Image.new("L", (2000, 1000)).save(path)
    assert read_grey(path).shape == (1000, 2000)
    # 2 million pixels of 1 byte, with 4 bytes of work each.
    monkeypatch.setattr(image_file, "available_memory", lambda: 9_999_999)
    with pytest.raises(PictureTooLargeError, match=r"large\.png: its 2000 x 1000 pixels take about 0\.0 GB"):
        read_grey(path)
    with pytest.raises(PictureTooLargeError):
        each_picture([path], read_grey)
    monkeypatch.setattr(image_file, "available_memory", lambda: 10_000_000)
    assert read_grey(path).shape == (1000, 2000)
    monkeypatch.setattr(image_file, "available_memory", lambda: None)
    assert read_grey(path).shape == (1000, 2000)


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@pytest.mark.parametrize("behind", [True, False])
def test_a_png_is_not_decoded_for_its_notes(
    behind: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """EXIF and XMP stand before the pixels or, as some programs write them, behind."""
    path = tmp_path / "noted.png"
    exif = Image.Exif()
    exif[0x0110] = "FC6310"
    notes = chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0"))
    notes += chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + XMP.encode())
    Image.new("L", (640, 480)).save(path)
    whole = path.read_bytes()
    place = len(whole) - 12 if behind else 33
    path.write_bytes(whole[:place] + notes + whole[place:])
    original = Image.open(path)
    original.load()
    assert original.getexif()[0x0110] == "FC6310"

    sizes: list[tuple[int, int]] = []
    load = type(original).load

    def counted(picture: Image.Image) -> object:
        sizes.append(picture.size)
        return load(picture)  # type: ignore[arg-type]

    monkeypatch.setattr(type(original), "load", counted)
    facts = read_facts(path)
    assert (facts.model, facts.relative_altitude_m, facts.size_px) == ("FC6310", 61.5, (640, 480))
    assert (640, 480) not in sizes


def test_damaged_notes_tell_nothing(tmp_path: Path) -> None:
    path = tmp_path / "noted.png"
    Image.new("L", (640, 480)).save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-12] + b"\0\0\0\x04eXIfabcdwrong" + whole[-12:])
    assert read_facts(path).model == ""

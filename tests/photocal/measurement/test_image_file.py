"""Images of every kind: read on their stored grid, or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import as_eight_bit, list_images, read_grey

RAMP = np.add.outer(np.arange(40) * 3, np.arange(60) * 2).astype(np.uint8)


def test_stored_grid_is_kept_whatever_the_exif_orientation(tmp_path: Path) -> None:
    plain, turned = tmp_path / "plain.png", tmp_path / "turned.png"
    Image.fromarray(RAMP).save(plain)
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(RAMP).save(turned, exif=exif)
    assert np.array_equal(read_grey(plain), RAMP)
    assert np.array_equal(read_grey(turned), RAMP)
    assert read_facts(turned).orientation == 6
    assert read_facts(turned).size_px == (60, 40)


def test_first_element_is_the_upper_left_pixel(tmp_path: Path) -> None:
    grey = np.zeros((32, 48), dtype=np.uint8)
    grey[0, 0], grey[31, 47], grey[0, 47] = 255, 200, 100
    path = tmp_path / "corner.png"
    Image.fromarray(grey).save(path)
    read = read_grey(path)
    assert (read[0, 0], read[31, 47], read[0, 47]) == (255, 200, 100)


def test_sixteen_bits_stay(tmp_path: Path) -> None:
    deep = (RAMP.astype(np.uint16) * 257).astype(np.uint16)
    for name in ("deep.png", "deep.tif"):
        Image.fromarray(deep).save(tmp_path / name)
        read = read_grey(tmp_path / name)
        assert read.dtype == np.uint16
        assert np.array_equal(read, deep)
        assert np.ptp(as_eight_bit(read)) == 255


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "F", "I"])
def test_modes_give_a_grey_image_of_the_same_size(tmp_path: Path, mode: str) -> None:
    path = tmp_path / "image.tif"
    Image.fromarray(RAMP).convert(mode).save(path)
    assert read_grey(path).shape == RAMP.shape


@pytest.mark.shared
def test_jpeg_as_opencv_decodes_it(shared: Path) -> None:
    path = shared / "data/micmac-saisies-gcp/IMGP4167.JPG"
    peer = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    assert peer is not None
    assert np.abs(read_grey(path).astype(int) - peer.astype(int)).max() <= 2


def test_damaged_files_are_named(tmp_path: Path) -> None:
    whole = tmp_path / "whole.jpg"
    Image.fromarray(np.tile(RAMP, (5, 5))).save(whole)
    cut = tmp_path / "cut.jpg"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with pytest.raises(InputMalformedError, match=r"cut\.jpg: cannot be read"):
        read_grey(cut)
    (tmp_path / "empty.jpg").touch()
    with pytest.raises(InputNotFoundError, match=r"empty\.jpg: is empty"):
        read_grey(tmp_path / "empty.jpg")
    (tmp_path / "text.jpg").write_text("no image")
    with pytest.raises(InputMalformedError, match=r"text\.jpg: is not an image"):
        read_grey(tmp_path / "text.jpg")
    with pytest.raises(InputNotFoundError, match="does not exist"):
        read_grey(tmp_path / "missing.jpg")
    Image.fromarray(RAMP[:8, :8]).save(tmp_path / "tiny.png")
    with pytest.raises(InputMalformedError, match="only 8 x 8"):
        read_grey(tmp_path / "tiny.png")


def test_folders_without_images(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError, match="has no image"):
        list_images(tmp_path)
    with pytest.raises(InputNotFoundError, match="is not a folder"):
        list_images(tmp_path / "none")


@given(st.integers(0, 600), st.binary(min_size=1, max_size=30))
@settings(max_examples=30)
def test_overwritten_files_never_give_a_traceback(
    tmp_path_factory: pytest.TempPathFactory, offset: int, junk: bytes
) -> None:
    folder = tmp_path_factory.mktemp("fuzz")
    for name in ("a.jpg", "a.png", "a.tif"):
        path = folder / name
        exif = Image.Exif()
        exif[0x0110] = "camera"
        Image.fromarray(RAMP).save(path, exif=exif)
        content = bytearray(path.read_bytes())
        content[offset : offset + len(junk)] = junk
        path.write_bytes(content)
        for read in (read_grey, read_facts):
            said = _complaint(read, path)
            assert said is None or (name in said and "\n" not in said)


def _complaint(read: Callable[[Path], object], path: Path) -> str | None:
    try:
        read(path)
    except PhotocalError as refusal:
        return str(refusal)
    return None

"""Hostile images through the commands that measure: handled or named, never a traceback, never moved."""

from __future__ import annotations

import json
import struct
import warnings
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
import rasterio  # type: ignore[import-untyped]
from numpy.typing import NDArray
from PIL import Image
from rasterio.errors import NotGeoreferencedWarning  # type: ignore[import-untyped]

from photocal.base.errors import InputNotFoundError, PhotocalError
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import list_images, read_grey
from photocal.measurement.markers import dictionary, find_board, find_markers, parse_board
from photocal.measurement.marking.service import MarkingService
from photocal.measurement.marking.store import MarkStore, scene_of_folder
from photocal.measurement.marking.tiles import Tiles
from photocal.measurement.target_centre import TargetImage
from photocal.measurement.target_search import find_targets

from .rendering import warped

SIZE = (480, 360)
# Where the picture shows the middles of a coded target and of a disc.
CODE, DISC = (140.25, 120.75), (340.5, 230.25)


class Answer(Protocol):
    """What a command said."""

    code: int
    out: str
    err: str


def picture() -> NDArray[np.uint8]:
    plate = np.full((400, 400), 255, np.uint8)
    plate[50:350, 50:350] = dictionary("apriltag_36h11").generateImageMarker(3, 300)
    scene = warped(plate, np.array([[0.2, 0, CODE[0] - 39.9], [0, 0.2, CODE[1] - 39.9], [0, 0, 1]]), SIZE)
    y, x = np.mgrid[: SIZE[1] * 4, : SIZE[0] * 4] / 4 - 0.375
    disc = np.hypot(x - DISC[0], y - DISC[1]).reshape(SIZE[1], 4, SIZE[0], 4) < 15
    covered = disc.mean(axis=(1, 3))
    return np.asarray(np.round(scene * (1 - covered) + 40 * covered), np.uint8)


def save(folder: Path) -> dict[str, Path]:
    """The same picture in every form that is read, and wrecks of it."""
    grey = picture()
    for orientation in range(1, 9):
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.fromarray(grey).convert("RGB").save(folder / f"turned{orientation}.jpg", quality=95, exif=exif)
        tags = {0x0112: orientation}
        Image.fromarray(grey).save(folder / f"turned{orientation}.tif", tiffinfo=tags)
        Image.fromarray(grey).save(folder / f"packed{orientation}.tif", tiffinfo=tags, compression="tiff_lzw")
    Image.fromarray(grey).save(folder / "grey.png")
    Image.fromarray(grey.astype(np.uint16) * 200 + 900).save(folder / "deep.tif")
    Image.fromarray(grey.astype(np.float32) / 255).save(folder / "reflectance.tif")
    Image.fromarray(grey).convert("RGBA").save(folder / "alpha.png")
    Image.fromarray(grey).convert("CMYK").save(folder / "print.tif")
    Image.fromarray(grey).convert("CMYK").save(folder / "print.jpg", quality=95)
    Image.fromarray(grey).convert("P").save(folder / "palette.png")
    pages = [Image.new("L", (100, 80))]
    Image.fromarray(grey).save(folder / "açúcar e 空 1.tif", save_all=True, append_images=pages)
    shape = {"driver": "GTiff", "width": SIZE[0], "height": SIZE[1], "count": 1}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(folder / "tiled.tif", "w", **shape, dtype="uint8", tiled=True) as file:
            file.write(grey[None])
        with rasterio.open(folder / "twelve.tif", "w", **shape, dtype="uint16", nbits=12) as file:
            file.write(grey[None].astype(np.uint16) * 16)
        with rasterio.open(folder / "double.tif", "w", **shape, dtype="float64") as file:
            file.write(grey[None] / 255)
    whole = (folder / "turned1.jpg").read_bytes()
    (folder / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    (folder / "empty.jpg").touch()
    (folder / "text.png").write_text("no image")
    damaged = bytearray(whole)
    damaged[2:40] = bytes(38)
    (folder / "damaged.jpg").write_bytes(damaged)
    Image.new("L", (8, 8)).save(folder / "tiny.png")
    (folder / "telephone.jpg").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(99))
    # A header that claims what no memory holds.
    header = struct.pack(">IIBBBBB", 400_000, 400_000, 8, 0, 0, 0, 0)
    pieces = ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(9999))), (b"IEND", b""))
    made = [struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in pieces]
    (folder / "bomb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(made))
    # Not files: a folder, a loop and a link to nothing are no pictures, whatever they are called.
    (folder / "folder.jpg").mkdir()
    (folder / "loop.jpg").symlink_to("loop.jpg")
    (folder / "gone.jpg").symlink_to("nowhere.jpg")
    return {path.name: path for path in list_images(folder)}


GOOD = [f"{name}{k}.{end}" for k in range(1, 9) for name, end in (("turned", "jpg"), ("turned", "tif"))]
GOOD += [f"packed{k}.tif" for k in range(1, 9)]
GOOD += ["grey.png", "deep.tif", "reflectance.tif", "alpha.png", "print.tif", "print.jpg", "palette.png"]
GOOD += ["açúcar e 空 1.tif", "tiled.tif", "twelve.tif"]
BAD = [
    "cut.jpg",
    "empty.jpg",
    "text.png",
    "damaged.jpg",
    "tiny.png",
    "telephone.jpg",
    "bomb.png",
    "double.tif",
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("hostile")
    assert sorted(save(made)) == sorted(GOOD + BAD)
    return made


@pytest.mark.parametrize("name", GOOD)
def test_targets_lie_on_the_stored_grid(folder: Path, name: str) -> None:
    grey = read_grey(folder / name)
    (marker,) = find_markers(grey, "apriltag_36h11")
    assert (marker.centre.column, marker.centre.row) == pytest.approx(CODE, abs=0.05)
    service = MarkingService(scene_of_folder(folder, None, None), MarkStore(folder.parent / "m.csv"))
    question = {"image": name, "point": "P", "x": DISC[0] + 2, "y": DISC[1] - 3, "kinds": ["circle"]}
    assert read_facts(folder / name).size_px == SIZE
    if name in ("turned6.tif", "packed8.tif", "turned6.jpg", "palette.png"):
        tile = Image.open(BytesIO(Tiles(folder.parent).tile(folder / name, 0, 0, 0))).convert("L")
        assert np.abs(np.asarray(tile, float) - picture()).mean() < 2
    answer = service.mark(json.dumps(question).encode())
    assert answer["snapped"] == "circle"
    (mark,) = (m for m in answer["marks"] if m["image"] == name)
    assert (mark["x"], mark["y"]) == pytest.approx(DISC, abs=0.05)


def test_sixteen_bits_have_the_same_uncoded_targets(folder: Path) -> None:
    for name in ("grey.png", "deep.tif"):
        look = TargetImage("disc", 15 * np.eye(2), 1.0)
        (centre,) = find_targets(read_grey(folder / name), (342.0, 229.0), 4 * np.eye(2), look)
        assert (centre.column, centre.row) == pytest.approx(DISC, abs=0.05)


@pytest.mark.parametrize("name", BAD)
def test_wrecks_are_named_on_the_page(folder: Path, tmp_path: Path, name: str) -> None:
    """A picture whose head is whole is listed; a click in it, or a look at it, says what is wrong."""
    scene = scene_of_folder(folder, None, None)
    service = MarkingService(scene, MarkStore(tmp_path / "marks.csv"))
    question = {"image": name, "point": "P", "x": 5, "y": 5}
    for act in (
        lambda: service.mark(json.dumps(question).encode()),
        lambda: Tiles(tmp_path).tile(folder / name, 0, 0, 0),
    ):
        with pytest.raises(PhotocalError, match=name.replace(".", r"\.")):
            act()
    assert not (tmp_path / "marks.csv").exists()
    assert scene.pictures[name].reason or name == "cut.jpg"


def test_boards_in_all_depths(tmp_path: Path) -> None:
    cells = np.indices((7, 10)).sum(axis=0) % 2 * 200 + 30
    grey = warped(
        np.pad(cells.repeat(20, axis=0).repeat(20, axis=1), 40, constant_values=230).astype(np.uint8),
        np.eye(3),
        (280, 220),
    )
    board = parse_board("10x7", 0.03)
    deep, real = np.asarray(grey, np.uint16) * np.uint16(200), np.asarray(grey / 255, np.float32)
    found = [find_board(grey, board), find_board(deep, board), find_board(real, board)]
    assert all(view is not None for view in found)
    for view in found[1:]:
        assert view is not None
        assert found[0] is not None
        assert view[1] == pytest.approx(found[0][1], abs=0.02)


def test_a_folder_of_wrecks_is_measured_without_a_traceback(
    folder: Path, tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    said = photocal("measure", "--images", folder, "--board", "10x7", "-o", tmp_path / "board")
    assert said.code != 0
    assert f"0 of {len(GOOD + BAD)} images show a board" in said.err
    said = photocal("mark", "--images", folder, "-o", tmp_path / "marks.csv", "--json")
    assert said.code == 0, said.err
    left = {entry["image"]: entry["reason"] for entry in json.loads(said.out)["left_out"]}
    assert left.keys() == set(BAD) - {"cut.jpg"}
    assert "Traceback" not in said.err


def test_pictures_of_other_kinds_are_named(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "IMG_1.HEIC").write_bytes((folder / "telephone.jpg").read_bytes())
    with pytest.raises(InputNotFoundError, match=r"cannot be read \(\.HEIC\).*save them as JPEG"):
        list_images(tmp_path)
    with pytest.raises(PhotocalError, match=r"telephone\.jpg: is a HEIC"):
        read_grey(folder / "telephone.jpg")
    with pytest.raises(PhotocalError, match=r"double\.tif: is a TIFF of an unsupported kind.*16 bits"):
        read_grey(folder / "double.tif")

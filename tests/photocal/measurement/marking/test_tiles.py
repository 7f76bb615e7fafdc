"""Tiles: every pixel where it belongs, whatever the format, depth, turn and scale."""

from __future__ import annotations

import math
import os
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.measurement.features import sweep, touch
from photocal.measurement.marking.tiles import TILE_PX, Tiles, coarsest_level

Floats = NDArray[np.float64]
# No multiple of 2 or 8, and several tiles wide and high.
WIDTH, HEIGHT = 1237, 709


def pixels(tile: bytes) -> Floats:
    return np.asarray(Image.open(BytesIO(tile)).convert("L"), dtype=float)


def whole(tiles: Tiles, path: Path, level: int) -> Floats:
    """All tiles of a level put together."""
    across, down = (math.ceil(n / 2**level / TILE_PX) for n in (WIDTH, HEIGHT))
    rows = [np.hstack([pixels(tiles.tile(path, level, c, r)) for c in range(across)]) for r in range(down)]
    return np.vstack(rows)


def smooth() -> NDArray[np.uint8]:
    """Grey values from which both coordinates of a pixel can be read."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.asarray(127 + 60 * np.sin(x / 40) + 60 * np.sin(y / 33), dtype=np.uint8)


def save(path: Path, kind: str) -> None:
    grey = smooth()
    if kind == "16 bit":
        Image.fromarray(grey.astype(np.uint16) * 200 + 1000).save(path)
    elif kind == "colour":
        Image.fromarray(np.dstack([grey] * 3)).save(path, quality=95)
    elif kind == "turned":
        exif = Image.Exif()
        exif[0x0112] = 6
        Image.fromarray(grey).save(path, quality=95, exif=exif)
    else:
        Image.fromarray(grey).save(path, quality=95)


@pytest.mark.parametrize(
    ("kind", "suffix"),
    [("grey", ".jpg"), ("grey", ".png"), ("colour", ".jpg"), ("16 bit", ".tif"), ("turned", ".jpg")],
)
def test_tiles_show_the_stored_grid(tmp_path: Path, kind: str, suffix: str) -> None:
    path = tmp_path / f"picture{suffix}"
    save(path, kind)
    truth = smooth().astype(float)
    tiles = Tiles(tmp_path / "cache")
    assert coarsest_level((WIDTH, HEIGHT)) == 2
    for level in (2, 1, 0):
        shown = whole(tiles, path, level)
        step = 1 << level
        assert shown.shape == (-(-HEIGHT // step), -(-WIDTH // step))
        # Means of whole cells; how far the tile lies beside them is estimated by least squares.
        h, w = HEIGHT // step, WIDTH // step
        cells = truth[: h * step, : w * step].reshape(h, step, w, step).mean(axis=(1, 3))
        part = shown[:h, :w]
        if kind == "16 bit":
            gain, offset = np.polyfit(cells.ravel(), part.ravel(), 1)
            part = (part - offset) / gain
        gradient = np.stack(np.gradient(cells), axis=-1).reshape(-1, 2)
        moved, *_ = np.linalg.lstsq(gradient, (part - cells).ravel(), rcond=None)
        assert np.abs(moved * step).max() < 0.06, level
        assert np.abs(part - cells).mean() < 2


def test_tiles_are_kept_by_content(tmp_path: Path) -> None:
    path, twin = tmp_path / "a.png", tmp_path / "b.png"
    save(path, "grey")
    twin.write_bytes(path.read_bytes())
    cache = tmp_path / "cache"
    first = Tiles(cache).tile(path, 1, 0, 0)
    assert Tiles(cache).tile(twin, 1, 0, 0) == first
    assert len(list(cache.rglob("*.jpg"))) == 1
    Image.fromarray(255 - smooth()).save(path)
    assert np.abs(pixels(Tiles(cache).tile(path, 1, 0, 0)) - pixels(first)).mean() > 20


@pytest.mark.parametrize("address", [(0, 3, 0), (0, 0, 2), (3, 0, 0), (0, -1, 0), (2, 1, 0), (40, 0, 0)])
def test_tiles_that_do_not_exist_are_refused(tmp_path: Path, address: tuple[int, int, int]) -> None:
    path = tmp_path / "a.png"
    save(path, "grey")
    with pytest.raises(InputNotFoundError, match=r"a\.png: has no such tile"):
        Tiles(tmp_path / "cache").tile(path, *address)


def test_bad_pictures_are_named(tmp_path: Path) -> None:
    tiles = Tiles(tmp_path / "cache")
    path = tmp_path / "a.jpg"
    save(path, "grey")
    path.write_bytes(path.read_bytes()[:9000])
    with pytest.raises(InputMalformedError, match=r"a\.jpg"):
        tiles.tile(path, 0, 0, 0)
    path.unlink()
    with pytest.raises(InputNotFoundError, match=r"a\.jpg"):
        tiles.tile(path, 0, 0, 0)
    assert not list((tmp_path / "cache").rglob("*.jpg"))


def test_the_disk_keeps_what_was_used_last(tmp_path: Path) -> None:
    for k in range(10):
        path = tmp_path / f"{k % 3}" / f"{k}.jpg"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(bytes(100))
        os.utime(path, (1000.0 + k, 1000.0 + k))

    def left() -> set[int]:
        return {int(path.stem) for path in tmp_path.rglob("*.jpg")}

    assert sweep(tmp_path, 1000, 100.0, 1010.0) == 1000
    assert left() == set(range(10))
    touch(tmp_path / "0" / "0.jpg", 9000.0)
    assert sweep(tmp_path, 450, 9000.0, 9000.0) == 400
    assert left() == {0, 9, 8, 7}
    assert sweep(tmp_path, 450, 100.0, 9000.0) == 100
    assert left() == {0}
    assert sweep(tmp_path, 99, 100.0, 9000.0) == 0
    assert sweep(tmp_path / "nothing", 99, 100.0, 9000.0) == 0


def test_tiles_stay_within_their_bounds(tmp_path: Path) -> None:
    path, cache = tmp_path / "a.png", tmp_path / "cache"
    save(path, "grey")
    other = cache / "ab" / "features.npz"
    other.parent.mkdir(parents=True)
    other.write_bytes(bytes(100_000))
    size = len(Tiles(tmp_path / "free").tile(path, 0, 0, 0))
    tiles = Tiles(cache, most_bytes=3 * size)
    for _ in range(2):
        for column, row in ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)):
            assert len(pixels(tiles.tile(path, 0, column, row)))
            tiles.tidy()
            assert sum(one.stat().st_size for one in cache.rglob("*.jpg")) <= 3 * size
    assert 0 < len(list(cache.rglob("*.jpg"))) < 6
    # What else is kept there is not the tiles' business.
    assert other.exists()

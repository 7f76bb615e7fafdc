"""Tiles: every pixel where it belongs, whatever the format, depth, turn and scale."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.measurement.marking.tiles import TILE_PX, TileAddress, Tiles, coarsest_level

Floats = NDArray[np.float64]
# No multiple of 2 or 8, and several tiles wide and high.
WIDTH, HEIGHT = 1237, 709


def pixels(tile: bytes) -> Floats:
    return np.asarray(Image.open(BytesIO(tile)).convert("L"), dtype=float)


def whole(tiles: Tiles, path: Path, level: int) -> Floats:
    """All tiles of a level put together."""
    across, down = (math.ceil(n / 2**level / TILE_PX) for n in (WIDTH, HEIGHT))
    rows = [
        np.hstack([pixels(tiles.tile(path, TileAddress(level, c, r))) for c in range(across)])
        for r in range(down)
    ]
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
    first = Tiles(cache).tile(path, TileAddress(1, 0, 0))
    assert Tiles(cache).tile(twin, TileAddress(1, 0, 0)) == first
    assert len(list(cache.rglob("*.jpg"))) == 1
    Image.fromarray(255 - smooth()).save(path)
    assert np.abs(pixels(Tiles(cache).tile(path, TileAddress(1, 0, 0))) - pixels(first)).mean() > 20


@pytest.mark.parametrize("address", [(0, 3, 0), (0, 0, 2), (3, 0, 0), (0, -1, 0), (2, 1, 0), (40, 0, 0)])
def test_tiles_that_do_not_exist_are_refused(tmp_path: Path, address: tuple[int, int, int]) -> None:
    path = tmp_path / "a.png"
    save(path, "grey")
    with pytest.raises(InputNotFoundError, match=r"a\.png: has no such tile"):
        Tiles(tmp_path / "cache").tile(path, TileAddress(*address))


def test_bad_pictures_are_named(tmp_path: Path) -> None:
    tiles = Tiles(tmp_path / "cache")
    path = tmp_path / "a.jpg"
    save(path, "grey")
    path.write_bytes(path.read_bytes()[:9000])
    with pytest.raises(InputMalformedError, match=r"a\.jpg"):
        tiles.tile(path, TileAddress(0, 0, 0))
    path.unlink()
    with pytest.raises(InputNotFoundError, match=r"a\.jpg"):
        tiles.tile(path, TileAddress(0, 0, 0))
    assert not list((tmp_path / "cache").rglob("*.jpg"))

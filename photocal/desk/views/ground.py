"""The orthophoto beneath the map: the newest in the folder of the project, in tiles of bounded size."""

from __future__ import annotations

from contextlib import suppress
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.base.errors import InputNotFoundError, PhotocalError
from photocal.desk.views.shown import Shown

if TYPE_CHECKING:
    from photocal.products.raster import RasterFile

TILE_PX = 512
_MOST_FILES = 200


def _levels(ground: RasterFile) -> int:
    """Halvings until all of it is one tile."""
    return ((max(ground.columns, ground.rows) - 1) // TILE_PX).bit_length()


def ground_told(ground: RasterFile, name: str) -> dict[str, Any]:
    """What the map has to know of an orthophoto to ask for its tiles."""
    cell, _, west, *_, north = ground.transform
    place = {"corner": [west, north], "cell_m": cell, "size": [ground.columns, ground.rows]}
    return {"name": name, **place, "levels": _levels(ground), "tile_px": TILE_PX}


def ground_of(shown: Shown, folder: Path) -> RasterFile | None:
    """Find the newest orthophoto in a project's folder and one below that lies where the stations are."""
    found = chain.from_iterable(folder.glob(f"{depth}*.tif*") for depth in ("", "*/", "*/*/"))
    inside = [path for path in found if path.is_file() and path.resolve().is_relative_to(folder.resolve())]
    for path in sorted(inside[:_MOST_FILES], key=lambda path: path.stat().st_mtime, reverse=True):
        with suppress(PhotocalError):
            if (ground := _beneath(shown, path)) is not None:
                return ground
    return None


def _beneath(shown: Shown, path: Path) -> RasterFile | None:
    """One file as an orthophoto of this block, north up with square cells; None for something else."""
    from photocal.products.raster import describe, same_system, system_wkt

    raster, block = describe(path), shown.block
    a, b, _, d, e, _ = raster.transform
    # What has no place, is turned, or has heights in its cells lies under no map.
    if raster.dtype not in ("uint8", "uint16") or b or d or not np.isclose(a, -e) or not shown.in_metres:
        return None
    local = block.frame == "local"
    if bool(raster.crs) is local or (raster.crs and not same_system(raster.crs, system_wkt(block.frame))):
        return None
    x, y = np.median(shown.on_map(shown.result.images.station)[:, :2], axis=0)
    left, low, right, high = raster.bounds
    return raster if left <= x <= right and low <= y <= high else None


def ground_tile(ground: RasterFile, level: int, column: int, row: int) -> bytes:
    """Make a tile as PNG: each of its pixels is 2^level by 2^level cells; clear where nothing was seen.

    raises InputNotFoundError: beyond the orthophoto.
    """
    import rasterio  # type: ignore[import-untyped]
    from PIL import Image
    from rasterio.enums import Resampling  # type: ignore[import-untyped]
    from rasterio.windows import Window  # type: ignore[import-untyped]

    from photocal.products.raster import opened

    side = TILE_PX << max(level, 0)
    first, size = (column * side, row * side), (ground.columns, ground.rows)
    if (
        not 0 <= level <= _levels(ground)
        or min(column, row) < 0
        or first[0] >= size[0]
        or first[1] >= size[1]
    ):
        raise InputNotFoundError("has no such tile", "choose another place", where=ground.path)
    wide, high = (min(side, size[k] - first[k]) for k in (0, 1))
    shape = (-(-high >> level), -(-wide >> level))
    # The cache of GDAL is by default a share of the memory of the machine.
    cache_mb = 32
    with rasterio.Env(GDAL_CACHEMAX=cache_mb), opened(ground.path) as source:
        given = {"window": Window(*first, wide, high), "resampling": Resampling.average}
        bands = [1, 2, 3] if source.count >= 3 else [1]
        colours = source.read(bands, out_shape=(len(bands), *shape), **given)
        seen = source.dataset_mask(out_shape=shape, window=given["window"])
    if colours.dtype != np.uint8:
        colours = (colours >> 8).astype(np.uint8)
    # A map draws all tiles in one size: those at the edges are clear beyond it.
    tile = np.zeros((TILE_PX, TILE_PX, 4), np.uint8)
    tile[: shape[0], : shape[1]] = np.dstack([*np.broadcast_to(colours, (3, *shape)), seen])
    written = BytesIO()
    Image.fromarray(tile).save(written, "PNG", compress_level=1)
    return written.getvalue()

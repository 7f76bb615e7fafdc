"""Rasters in files: terrain in pieces, images whole, GeoTIFF out. The only module that calls rasterio."""

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio  # type: ignore[import-untyped]
import rasterio.errors  # type: ignore[import-untyped]
import rasterio.windows  # type: ignore[import-untyped]
from numpy.typing import NDArray

from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, OutputError
from photocal.base.files import output_file
from photocal.geometry.frames import level_of, system_of
from photocal.products.terrain import HEIGHT_KINDS, Bounds, Terrain, Transform

HEIGHT_TAG = "HEIGHT_KIND"


@dataclass(frozen=True)
class RasterFile:
    """What is known of a raster without reading it.

    crs: WKT; empty when the file names none.
    height_kind: of a terrain model, from its tag or its vertical system; empty when it does not say.
    """

    path: Path
    columns: int
    rows: int
    bands: int
    dtype: str
    transform: Transform
    crs: str
    height_kind: str

    @property
    def bounds(self) -> Bounds:
        """West, south, east, north."""
        a, b, c, d, e, f = self.transform
        corners = [(i, j) for i in (0, self.columns) for j in (0, self.rows)]
        x, y = [c + a * i + b * j for i, j in corners], [f + d * i + e * j for i, j in corners]
        return min(x), min(y), max(x), max(y)

    def stated_heights(self, stated: str | None) -> str:
        """Kind of the heights of a terrain model by itself or as it is said.

        raises ConfigurationError: when both differ, or neither tells.
        """
        wrong = ConfigurationError.at(self.path)
        if stated is not None and self.height_kind and stated != self.height_kind:
            raise wrong(f"has {self.height_kind} heights, not {stated} ones", "correct the kind")
        if kind := stated or self.height_kind:
            return kind
        raise wrong(
            "the height kind of the terrain model is not stated",
            "name it: ellipsoidal, orthometric or local",
        )


def describe(path: Path) -> RasterFile:
    """Read the header of any raster that GDAL knows.

    raises InputNotFoundError, InputMalformedError: when there is no such file, or it is no raster.
    """
    with opened(path) as source:
        return RasterFile(
            path,
            source.width,
            source.height,
            source.count,
            str(source.dtypes[0]),
            tuple(source.transform)[:6],
            source.crs.to_wkt() if source.crs else "",
            _height_kind(source),
        )


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a raster for reading; complaints become ours."""
    if not path.is_file():
        what = "is a folder, a raster was expected" if path.is_dir() else "does not exist"
        raise InputNotFoundError(what, "check the path", where=path)
    try:
        with warnings.catch_warnings():
            # A photo has no georeference, and needs none.
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(path) as source:
                yield source
    except rasterio.errors.RasterioError as failure:
        reason = str(failure).splitlines()[0] if str(failure) else "not a readable raster"
        raise InputMalformedError(
            f"cannot be read as a raster ({reason})", "is the file complete?", where=path
        ) from failure


def _height_kind(source: Any) -> str:
    tag = str(source.tags().get(HEIGHT_TAG, ""))
    if tag in HEIGHT_KINDS:
        return tag
    if source.crs:
        system = system_of(source.crs.to_wkt())
        if system.is_compound:
            return "orthometric"
        if len(system.axis_info) == 3:
            return "ellipsoidal"
    return ""


def terrain_source(raster: RasterFile, height_kind: str) -> Callable[[Bounds], Terrain]:
    """Give a reader of pieces of a terrain model; it may be called from several threads.

    raises InputMalformedError: for a raster without georeference, with more than one band, or of 8 bits.
    """
    a, b, c, d, e, f = raster.transform
    determinant = a * e - b * d
    malformed = InputMalformedError.at(raster.path)
    if determinant == 0 or (raster.transform == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0) and not raster.crs):
        raise malformed("has no georeference", "give a terrain model with its position")
    if raster.bands != 1:
        raise malformed(f"has {raster.bands} bands, a terrain model has one", "name the model")
    # Grey values of an orthophoto; heights need more than 256 of them.
    if raster.dtype == "uint8":
        raise malformed("has values of 8 bits: it is a picture, not a terrain model", "name the model")

    def piece(bounds: Bounds) -> Terrain:
        """Heights of a rectangle, with the cells around it that interpolation needs."""
        west, south, east, north = bounds
        corners = [(x - c, y - f) for x in (west, east) for y in (south, north)]
        columns = [(e * x - b * y) / determinant for x, y in corners]
        rows = [(a * y - d * x) / determinant for x, y in corners]
        first = (max(math.floor(min(columns)) - 2, 0), max(math.floor(min(rows)) - 2, 0))
        last = (min(math.ceil(max(columns)) + 2, raster.columns), min(math.ceil(max(rows)) + 2, raster.rows))
        wide, high = last[0] - first[0], last[1] - first[1]
        corner = (a, b, c + a * first[0] + b * first[1], d, e, f + d * first[0] + e * first[1])
        if wide <= 0 or high <= 0:
            return Terrain(np.full((1, 1), np.nan), corner, raster.crs, height_kind)
        window = rasterio.windows.Window(*first, wide, high)
        with opened(raster.path) as source:
            band = source.read(1, window=window, masked=True)
            # Scale and offset are part of what a value means.
            heights = band.astype(np.float64) * source.scales[0] + source.offsets[0]
        values = np.asarray(np.ma.filled(heights, np.nan))
        values[~np.isfinite(values)] = np.nan
        return Terrain(values, corner, raster.crs, height_kind)

    return piece


def read_image(path: Path) -> NDArray[Any]:
    """Read a photo whole."""
    # Lines that are read at a time.
    strip = 512
    with opened(path) as source:
        if str(source.dtypes[0]) not in ("uint8", "uint16", "float32"):
            raise InputMalformedError(
                f"has values of type {source.dtypes[0]}", "convert it to 8 or 16 bits", where=path
            )
        pixels = np.empty((source.height, source.width, source.count), dtype=source.dtypes[0])
        # By strips: the bands of a whole image beside the image would double its memory.
        for first in range(0, source.height, strip):
            count = min(strip, source.height - first)
            window = rasterio.windows.Window(0, first, source.width, count)
            pixels[first : first + count] = np.moveaxis(source.read(window=window), 0, 2)
    return pixels


def system_wkt(name: str) -> str:
    """Reference system as WKT; raises ConfigurationError for a name that is none."""
    from rasterio.crs import CRS  # type: ignore[import-untyped]

    try:
        return str(CRS.from_user_input(name).to_wkt())
    except rasterio.errors.CRSError as failure:
        raise ConfigurationError(
            f"{name!r} is not a known reference system", "give an EPSG code such as EPSG:31982"
        ) from failure


def same_system(first: str, second: str) -> bool:
    """Whether two reference systems (WKT) have the same horizontal part."""
    # Heights are compared by their kind, not here.
    one, other = (level_of(system_of(wkt)).to_2d() for wkt in (first, second))
    return bool(one.equals(other, ignore_axis_order=True))


@contextmanager
def geotiff(
    path: Path,
    *,
    size: tuple[int, int],
    bands: int,
    dtype: str,
    transform: Transform,
    crs: str,
    nodata: float,
    tags: dict[str, str],
) -> Iterator[Callable[[NDArray[Any], int, int], None]]:
    """Write a tiled, compressed GeoTIFF with overviews; it appears when it is whole.

    size: columns and rows.
    """
    columns, rows = size
    floating = dtype.startswith("float")
    # Sides of the blocks that it is stored in, px.
    tile = 256
    options = {
        "driver": "GTiff",
        "width": columns,
        "height": rows,
        "count": bands,
        "dtype": dtype,
        "transform": rasterio.Affine(*transform),
        "crs": crs or None,
        "nodata": nodata,
        "tiled": True,
        "blockxsize": tile,
        "blockysize": tile,
        "compress": "deflate",
        "predictor": 3 if floating else 2,
        "BIGTIFF": "IF_SAFER",
        "interleave": "pixel",
    }
    if bands == 3 and dtype == "uint8":
        options["photometric"] = "RGB"
    with output_file(path) as aside:
        try:
            # The cache of GDAL is by default a share of the memory of the machine.
            with rasterio.Env(GDAL_CACHEMAX=128, GDAL_TIFF_INTERNAL_MASK=True):
                with rasterio.open(aside, "w", **options) as target:
                    target.update_tags(**tags)

                    def write(pixels: NDArray[Any], column: int, row: int) -> None:
                        """Put bands, rows and columns of a tile where it begins."""
                        window = rasterio.windows.Window(column, row, pixels.shape[2], pixels.shape[1])
                        target.write(pixels, window=window)

                    yield write
                # Halved until everything fits into one tile.
                halvings = math.ceil(math.log2(max(columns, rows) / tile))
                if factors := [2**n for n in range(1, halvings + 1)]:
                    with rasterio.open(aside, "r+") as target:
                        target.build_overviews(factors, rasterio.enums.Resampling.average)
        except rasterio.errors.RasterioError as failure:
            raise OutputError(
                f"cannot be written ({str(failure).splitlines()[0]})",
                "check that the disk has free space",
                where=path,
            ) from failure


def write_terrain(terrain: Terrain, path: Path) -> None:
    """Write a terrain model as GeoTIFF with the kind of its heights.

    raises OutputError: when it cannot be written.
    """
    rows, columns = terrain.heights.shape
    tags = {HEIGHT_TAG: terrain.height_kind} if terrain.height_kind else {}
    with geotiff(
        path,
        size=(columns, rows),
        bands=1,
        dtype="float32",
        transform=terrain.transform,
        crs=terrain.crs,
        nodata=math.nan,
        tags=tags,
    ) as write:
        write(terrain.heights[np.newaxis].astype(np.float32), 0, 0)

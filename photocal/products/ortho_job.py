"""From a block, its images and a terrain model in files to an orthophoto in a file."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.base.files import output_picture
from photocal.block.model import Block
from photocal.geometry.frames import UNSTATED, LocalFrame
from photocal.geometry.oriented_images import OrientedImages
from photocal.products.kernels import BILINEAR, CUBIC, NEAREST
from photocal.products.oriented import best_places, lens_tables
from photocal.products.orthophoto import ImageStore, Recipe, footprints, orthophoto
from photocal.products.raster import RasterFile, describe, geotiff, read_image, same_system, system_wkt
from photocal.products.terrain import Bounds, Grid, Terrain, TerrainSource

METHODS = {"nearest": NEAREST, "bilinear": BILINEAR, "cubic": CUBIC}


def image_files(block: Block, folder: Path, wanted: tuple[str, ...]) -> dict[int, RasterFile]:
    """Find the image files of a block; raises InputNotFoundError, InputMalformedError, ConfigurationError."""
    unknown = sorted(set(wanted) - set(block.images.names))
    if unknown:
        raise ConfigurationError(f"image {unknown[0]} is not in the block", "correct its name")
    if not folder.is_dir():
        raise InputNotFoundError("is not a folder", "name the folder of the images", where=folder)
    inside = {file.name: file for file in sorted(folder.iterdir()) if file.is_file()}
    files: dict[int, RasterFile] = {}
    for number, name in enumerate(block.images.names):
        if wanted and name not in wanted:
            continue
        file = describe(_image_path(inside, name, folder))
        size = block.cameras[block.images.camera[number]].size_px
        malformed = InputMalformedError.at(file.path)
        if (file.columns, file.rows) != size:
            raise malformed(
                f"is {file.columns} x {file.rows} px, its camera {size[0]} x {size[1]}",
                "use the image as the camera wrote it, not turned and not resized",
            )
        first = next(iter(files.values()), file)
        if (file.bands, file.dtype) != (first.bands, first.dtype):
            raise malformed(
                f"has {file.bands} band(s) of {file.dtype}, {first.path.name} has {first.bands} of "
                f"{first.dtype}",
                "make the images alike",
            )
        files[number] = file
    return files


def _image_path(inside: dict[str, Path], name: str, folder: Path) -> Path:
    if name in inside:
        return inside[name]
    alike = [file for file in inside.values() if file.stem == name]
    if len(alike) != 1:
        what = f"has no file of image {name}" if not alike else f"has several files of image {name}"
        raise InputNotFoundError(what, "keep one file of this name", where=folder)
    return alike[0]


def heights_of(raster: RasterFile, block: Block, stated: str | None) -> str:
    """Kind of the heights of a terrain model, which must be that of the block.

    raises ConfigurationError: when it is not known, or another one.
    """
    kind = raster.stated_heights(stated)
    if block.height in ("", UNSTATED) and block.frame != "local":
        raise ConfigurationError(
            "the block does not state its height kind",
            'give height = "ellipsoidal" or height = "orthometric"',
            where="block.toml",
        )
    if block.height and block.height != kind:
        raise ConfigurationError(
            f"the block has {block.height} heights, the terrain model {kind} ones",
            "convert one of them with its geoid",
            where=raster.path,
        )
    return kind


def system_of(raster: RasterFile, block: Block, crs: str | None) -> str:
    """Reference system of the product as WKT, empty for a local frame.

    raises ConfigurationError: when block, terrain model and wish do not agree.
    """
    named = None if block.frame == "local" else system_wkt(block.frame)
    wished = None if crs is None else system_wkt(crs)
    known = [(who, wkt) for who, wkt in (("--crs", wished), ("block.toml", named),
                                         (str(raster.path), raster.crs or None)) if wkt]  # fmt: skip
    for who, wkt in known[1:]:
        if not same_system(known[0][1], wkt):
            raise ConfigurationError(
                f"{known[0][0]} and {who} name different reference systems", "reproject one of them"
            )
    return known[0][1] if known else ""


def overview(terrain: TerrainSource, raster: RasterFile, bounds: Bounds) -> Terrain:
    """Terrain of a rectangle, thinned out where it is large.

    raises InputMalformedError: when it has no height there.
    """
    west, south = max(bounds[0], raster.bounds[0]), max(bounds[1], raster.bounds[1])
    east, north = min(bounds[2], raster.bounds[2]), min(bounds[3], raster.bounds[3])
    malformed = InputMalformedError.at(raster.path)
    if west >= east or south >= north:
        raise malformed("does not reach the images", "do block and terrain share a system?")
    cell = math.sqrt(
        abs(raster.transform[0] * raster.transform[4] - raster.transform[1] * raster.transform[3])
    )
    # A terrain model is sampled at most so densely to learn its mean height.
    sample = 512
    step = max(cell, max(east - west, north - south) / sample)
    columns, rows = max(int((east - west) / step), 1), max(int((north - south) / step), 1)
    heights = np.full((rows, columns), np.nan)
    x = west + (np.arange(columns) + 0.5) * step
    # By strips, so that a model of any size fits.
    for first in range(0, rows, 4):
        y = north - (np.arange(first, min(first + 4, rows)) + 0.5) * step
        heights[first : first + len(y)] = terrain((x[0], y[-1], x[-1], y[0])).at(*np.meshgrid(x, y))
    if not np.isfinite(heights).any():
        raise malformed("has no height where the images are", "do they belong together?")
    return Terrain(heights, (step, 0.0, west, 0.0, -step, north), raster.crs, raster.height_kind)


def plan_grid(
    shots: OrientedImages, frame: LocalFrame, terrain: TerrainSource, raster: RasterFile, cell: float | None,
    bounds: Bounds | None,
) -> tuple[Grid, float]:  # fmt: skip
    """Choose the cells of an orthophoto.

    cell: wished size, m; None for the pixel of the images on the ground.
    bounds: wished rectangle; None for all that the images show of the terrain.
    returns pixel: median size of an image's pixel on the ground, m.
    raises ConfigurationError, InputMalformedError.
    """
    if cell is not None and not (math.isfinite(cell) and cell > 0):
        raise ConfigurationError(f"the cell is {cell:g} m", "give a positive length in metres")
    given = frame.to_given(shots.station)
    around = (*given[:, :2].min(axis=0) - 1, *given[:, :2].max(axis=0) + 1) if bounds is None else bounds
    near = overview(terrain, raster, raster.bounds if bounds is None else around)
    low, mean = float(np.nanmin(near.heights)), float(np.nanmean(near.heights))
    if (given[:, 2] <= low).any():
        raise ConfigurationError(
            f"image {shots.names[int(np.argmin(given[:, 2]))]} lies below the terrain",
            "are the heights of one kind, and Z up?",
        )
    pitch = np.array([max(camera.pitch) / camera.value("c") for camera in shots.cameras])[shots.camera]
    pixel = float(np.median(pitch * (given[:, 2] - mean)))
    if cell is None:
        # Two digits, so that nobody reads 0.083461.
        power = 10.0 ** (math.floor(math.log10(pixel)) - 1)
        cell = math.ceil(pixel / power) * power
    # So much finer, every pixel would be repeated hundreds of times: the length has another unit.
    if cell < pixel / 20.0:
        raise ConfigurationError(
            f"a cell of {cell:g} m is far finer than the images, whose pixel is {pixel:.2g} m on the ground",
            "give --cell in metres",
        )
    if bounds is None:
        shown = footprints(shots, frame, low)
        reach = raster.bounds
        west, south, east, north = (
            max(shown[0], reach[0]), max(shown[1], reach[1]), min(shown[2], reach[2]), min(shown[3], reach[3])
        )  # fmt: skip
    else:
        west, south, east, north = bounds
    if not (west < east and south < north):
        raise ConfigurationError(
            "the rectangle of the orthophoto is empty", "give WEST,SOUTH,EAST,NORTH on the terrain"
        )
    left, top = math.floor(west / cell + 1e-9) * cell, math.ceil(north / cell - 1e-9) * cell
    columns, rows = math.ceil((east - left) / cell - 1e-9), math.ceil((top - south) / cell - 1e-9)
    return Grid(left, top, cell, columns, rows), pixel


def write_orthophoto(
    path: Path,
    recipe: Recipe,
    files: dict[int, RasterFile],
    crs: str,
    tags: dict[str, str],
    workers: int,
    advance: Callable[[float], None],
) -> tuple[float, dict[str, int]]:
    """Make an orthophoto and write it as GeoTIFF; raises OutputError, InputMalformedError."""
    grid, paths = recipe.grid, [file.path for file in files.values()]
    count = np.zeros(len(paths) + 1, dtype=np.int64)

    def read(number: int) -> NDArray[Any]:
        """Pixels of an image by its number, as the store of images asks for them."""
        return read_image(paths[number])

    with geotiff(
        path,
        size=(grid.columns, grid.rows),
        bands=recipe.bands,
        dtype=recipe.dtype,
        transform=grid.transform,
        crs=crs,
        nodata=recipe.nodata,
        tags=tags,
    ) as write:
        for column, row, pixels, chosen in orthophoto(recipe, ImageStore(read), workers):
            write(pixels, column, row)
            count += np.bincount(chosen.ravel() + 1, minlength=len(count))
            advance(float(chosen.size))
    shown = {name: int(n) for name, n in zip(recipe.shots.names, count[1:], strict=True)}
    return float(count[1:].sum() / count.sum()), shown


def displacement_field(
    right: OrientedImages,
    wrong: OrientedImages,
    terrain: Terrain,
    frame: LocalFrame,
    grid: Grid,
) -> "Displacement":
    """Displacement over a lattice within a grid."""
    # At most so many points a side: more arrows hide each other.
    arrows = 25
    step = max(grid.columns, grid.rows) * grid.cell / arrows
    x = np.arange(grid.west + step / 2, grid.west + grid.columns * grid.cell, step)
    y = np.arange(grid.north - step / 2, grid.north - grid.rows * grid.cell, -step)
    xs, ys = np.meshgrid(x, y)
    return displacement(right, wrong, terrain, frame, xs.ravel(), ys.ravel())


def terrain_points(
    shots: OrientedImages, number: int, pixel: Floats, terrain: Terrain, frame: LocalFrame
) -> Floats:
    """Intersect the rays of image points with the terrain."""
    image = np.full(len(pixel), number)
    ideal, c = shots.ideal(image, pixel)
    rotation, station = shots.at_lines(image, pixel)
    rays = np.einsum("ni,nij->nj", np.column_stack([ideal, -c]), rotation)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    height = float(np.nanmean(terrain.heights))
    above = frame.to_given(shots.station[number : number + 1])[0, 2] - height
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(rays[:, 2] < 0, -above / rays[:, 2], np.nan)
    passes = 100
    # A hundredth of a millimetre: nothing is left to correct.
    close_m = 1e-5
    for _ in range(passes):
        given = frame.to_given(station + along[:, None] * rays)
        gap = given[:, 2] - terrain.at(given[:, 0], given[:, 1])
        step = -gap / rays[:, 2]
        along = along + step
        if not np.any(np.abs(step) > close_m):
            break
    given = frame.to_given(station + along[:, None] * rays)
    gap = given[:, 2] - terrain.at(given[:, 0], given[:, 1])
    given[~(np.abs(gap) < 100 * close_m)] = np.nan
    return given


@dataclass(frozen=True)
class Displacement:
    """How far apart two orthophotos of the same images put the same thing.

    position (n, 3): where the first one has it, m.
    shift (n, 2): second minus first, east and north, m.
    """

    position: Floats
    shift: Floats

    @property
    def rms(self) -> float:
        """Root mean square of the length of the shifts, m."""
        return float(np.sqrt(np.mean((self.shift**2).sum(axis=1))))

    @property
    def largest(self) -> float:
        """Length of the largest shift, m."""
        return float(np.sqrt((self.shift**2).sum(axis=1).max()))


def displacement(
    right: OrientedImages, wrong: OrientedImages, terrain: Terrain, frame: LocalFrame, x: Floats, y: Floats
) -> Displacement:
    """Follow ground points through the right image geometry and back through the wrong one."""
    given = np.column_stack([x, y, terrain.at(x, y)])
    given = given[np.isfinite(given[:, 2])]
    local = frame.to_local(given)
    every = np.arange(len(right.names), dtype=np.int64)
    place, chosen = best_places(local, lens_tables(right.cameras), right, every)
    shift = np.full((len(local), 2), np.nan)
    for number in np.unique(chosen[chosen >= 0]):
        in_image = chosen == number
        ground = terrain_points(wrong, int(number), place[:, in_image].T, terrain, frame)
        shift[in_image] = ground[:, :2] - given[in_image, :2]
    seen = np.isfinite(shift).all(axis=1)
    if not seen.any():
        raise ConfigurationError("no image shows the terrain", "do block and terrain share a system?")
    return Displacement(given[seen], shift[seen])


def draw_displacement(field: Displacement, title: str, path: Path) -> None:
    """Draw the shifts as arrows on a map, with their scale beside its own; errors as of `output_picture`."""
    x, y = field.position[:, 0], field.position[:, 1]
    length = np.hypot(*field.shift.T)
    extent = max(float(np.ptp(x)), float(np.ptp(y)), 1e-9)
    # As high as the map is, beside its colours and below its title.
    high = 5.0 * float(np.ptp(y)) / max(float(np.ptp(x)), 1e-9)
    with output_picture(path, (6.7, min(max(high, 1.8), 8.0) + 1.2)) as figure:
        ax = figure.add_subplot()
        scale = max(field.largest, 1e-12) / (0.06 * extent)
        arrows = ax.quiver(x, y, field.shift[:, 0], field.shift[:, 1], length, angles="xy", scale=scale,
                           scale_units="xy", width=0.002, cmap="viridis")  # fmt: skip
        figure.colorbar(arrows, ax=ax, label="displacement, m")
        ax.margins(0.08)
        ax.quiverkey(arrows, 0.1, 1.02, field.largest, f"{field.largest:.3g} m", labelpos="E")
        ax.set_aspect("equal")
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.set_xlabel("E, m")
        ax.set_ylabel("N, m")
        ax.set_title(f"{title}: rms {field.rms:.3g} m, largest {field.largest:.3g} m", fontsize=9, pad=22)

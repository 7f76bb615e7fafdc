"""`photocal ortho`: orthophotos and mosaics from oriented images and a terrain model."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

from acquire.console import answer, numbers_of, progress
from drivers.errors import ConfigurationError
from photocal.commands.options import AsJson, argument, option

# Cells so many pixels wide leave pixels out.
_COARSE = 2.0


def ortho(
    block: Annotated[Path, argument("Block folder, or a set-up file of another program.")],
    images: Annotated[Path, option("Folder of the image files.")],
    dtm: Annotated[
        Path,
        option(
            "Terrain model: any raster that GDAL reads, or a CSV of points or contours (X, Y, Z, "
            "optional line), such as points.csv of an adjustment, all in metres."
        ),
    ],
    output: Annotated[Path, option("GeoTIFF to write.", "-o", "--output")],
    run: Annotated[Path | None, option("Adjustment of the block; without: orientations as given.")] = None,
    image: Annotated[list[str] | None, option("Only this image; may be repeated.")] = None,
    cell: Annotated[float | None, option("Size of a cell, m; without: the pixel on the ground.")] = None,
    bounds: Annotated[str | None, option("Rectangle: WEST,SOUTH,EAST,NORTH in metres.")] = None,
    resampling: Annotated[str, option("nearest, bilinear or cubic.")] = "bilinear",
    crs: Annotated[str | None, option("Reference system of block and terrain model.")] = None,
    heights: Annotated[str | None, option("Kind of heights of a terrain model that does not say it.")] = None,
    dtm_cell: Annotated[
        float | None, option("Size of the cells that a CSV of terrain points is put on, m.")
    ] = None,
    dtm_output: Annotated[Path | None, option("GeoTIFF of the terrain model made from a CSV.")] = None,
    nodata: Annotated[
        float, option("Value of cells without image; real grey levels keep clear of it.")
    ] = 0.0,
    compare: Annotated[
        Path | None, option("Another adjustment of the block, with another interior orientation.")
    ] = None,
    displacement: Annotated[
        Path | None, option("Map (.pdf, .svg, .png) of how far --compare would put things elsewhere.")
    ] = None,
    workers: Annotated[int, option("Threads; 0 for all cores.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Make an orthophoto: every cell takes its grey value from the image that sees it best from above.

    The terrain hides nothing from the images here: houses that are not in the model lean.

    Example: `photocal ortho block --run run --images photos --dtm dtm.tif --cell 0.1 -o ortho.tif`
    """
    from photocal.products.oriented import oriented
    from photocal.products.ortho_job import (
        METHODS,
        displacement_field,
        heights_of,
        image_files,
        overview,
        plan_grid,
        system_of,
        write_orthophoto,
    )
    from photocal.products.orthophoto import Recipe
    from photocal.products.raster import HEIGHT_TAG, describe, terrain_source
    from photocal.products.terrain import HEIGHT_KINDS

    if resampling not in METHODS:
        raise ConfigurationError(
            f"--resampling {resampling} is not known", remedy=f"use {', '.join(METHODS)}"
        )
    if heights is not None and heights not in HEIGHT_KINDS:
        raise ConfigurationError(f"--heights {heights} is not known", remedy=f"use {', '.join(HEIGHT_KINDS)}")
    if (compare is None) != (displacement is None):
        raise ConfigurationError("--compare and --displacement go together", remedy="give both or none")
    dtm, notes = _terrain_file(dtm, dtm_cell, dtm_output, crs, heights)
    model, frame, shots = oriented(block, run)
    files = image_files(model, images, tuple(image or ()))
    shots = shots.only(list(files))
    raster = describe(dtm)
    kind, system = heights_of(raster, model, heights), system_of(raster, model, crs)
    terrain = terrain_source(raster, kind)
    grid, pixel = plan_grid(
        shots, frame, terrain, raster, cell, None if bounds is None else _rectangle(bounds)
    )
    first = next(iter(files.values()))
    recipe = Recipe(shots, frame, terrain, grid, METHODS[resampling], first.bands, first.dtype, nodata)
    recipe.require_nodata()
    tags = {HEIGHT_TAG: kind, "SEAMS": "best nadir", "RESAMPLING": resampling}
    with progress("orthophoto", grid.columns * grid.rows) as advance:
        threads = workers or os.cpu_count() or 1
        share, shown = write_orthophoto(output, recipe, files, system, tags, threads, advance)
    figures: dict[str, Any] = {
        "schema": "photocal.ortho/1",
        "output": str(output),
        "columns": grid.columns,
        "rows": grid.rows,
        "cell_m": grid.cell,
        "image_pixel_m": pixel,
        "west": grid.west,
        "north": grid.north,
        "height_kind": kind,
        "covered": share,
        "cells": shown,
    }
    size = f"{grid.columns} x {grid.rows} cells of {grid.cell:g} m"
    lines = [*notes, f"{output}: {size}, {resampling}, {100 * share:.1f} % covered, {kind} heights"]
    lines += [f"  {name}: {100 * n / (grid.columns * grid.rows):.1f} %" for name, n in shown.items()]
    if grid.cell > _COARSE * pixel:
        lines.append(
            f"a cell is {grid.cell / pixel:.1f} pixels wide and takes the value of one place, no mean: fine "
            f"patterns alias; {pixel:.2g} m cells show all that the images do"
        )
    if compare is not None and displacement is not None:
        from photocal.products.displacement import draw_displacement

        other = oriented(block, compare)[2].only(list(files))
        south, east = grid.north - grid.rows * grid.cell, grid.west + grid.columns * grid.cell
        near = overview(terrain, raster, (grid.west, south, east, grid.north))
        field = displacement_field(shots, other, near, frame, grid)
        draw_displacement(field, f"{compare.name} against {run.name if run else block.name}", displacement)
        figures["displacement_m"] = {"rms": field.rms, "largest": field.largest}
        lines.append(f"displacement by {compare}: rms {field.rms:.4g} m, largest {field.largest:.4g} m")
    answer(as_json, lambda: figures, lambda: "\n".join(lines))


def _terrain_file(
    dtm: Path, cell: float | None, output: Path | None, crs: str | None, heights: str | None
) -> tuple[Path, list[str]]:
    """Make a raster of terrain points; a raster stays as it is."""
    from photocal.products.raster import system_wkt, write_terrain
    from photocal.products.terrain import grid_of_points, read_terrain_points

    if dtm.suffix.lower() != ".csv":
        if cell is not None or output is not None:
            raise ConfigurationError("--dtm-cell and --dtm-output are for a CSV of terrain points")
        return dtm, []
    if cell is None or output is None or heights is None:
        raise ConfigurationError(
            f"{dtm} is a table of points", remedy="give --dtm-cell, --dtm-output and --heights with it"
        )
    points = read_terrain_points(dtm)
    terrain, triangles, flat = grid_of_points(points, cell, "" if crs is None else system_wkt(crs), heights)
    write_terrain(terrain, output)
    note = f"{output}: {len(points.xyz)} points, {triangles} triangles"
    if flat:
        note += f", {flat} of them level within one contour (summits and hollows are cut off)"
    return output, [note]


def _rectangle(text: str) -> tuple[float, float, float, float]:
    form = "WEST,SOUTH,EAST,NORTH: a rectangle in metres"
    west, south, east, north = numbers_of(text, "--bounds", form)
    if not (west < east and south < north):
        raise ConfigurationError(f"--bounds {text} is empty", remedy="write WEST,SOUTH,EAST,NORTH in metres")
    return west, south, east, north

"""`photocal ortho`, `volume`: orthophotos and mosaics of oriented images, and the volume of a round tank."""

import os
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from photocal.base.console import AsJson, answer, argument, numbers_of, option, progress
from photocal.base.errors import ConfigurationError

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
    from photocal.products import ortho_job
    from photocal.products.oriented import oriented
    from photocal.products.orthophoto import Recipe
    from photocal.products.raster import HEIGHT_TAG, describe, terrain_source
    from photocal.products.terrain import HEIGHT_KINDS

    methods = ortho_job.METHODS
    if resampling not in methods:
        raise ConfigurationError(f"--resampling {resampling} is not known", f"use {', '.join(methods)}")
    if heights is not None and heights not in HEIGHT_KINDS:
        raise ConfigurationError(f"--heights {heights} is not known", f"use {', '.join(HEIGHT_KINDS)}")
    if (compare is None) != (displacement is None):
        raise ConfigurationError("--compare and --displacement go together", "give both or none")
    dtm, notes = _terrain_file(dtm, dtm_cell, dtm_output, crs, heights)
    model, frame, shots = oriented(block, run)
    files = ortho_job.image_files(model, images, tuple(image or ()))
    shots = shots.only(list(files))
    raster = describe(dtm)
    kind, system = ortho_job.heights_of(raster, model, heights), ortho_job.system_of(raster, model, crs)
    terrain, rectangle = terrain_source(raster, kind), None if bounds is None else _rectangle(bounds)
    grid, pixel = ortho_job.plan_grid(shots, frame, terrain, raster, cell, rectangle)
    first = next(iter(files.values()))
    recipe = Recipe(shots, frame, terrain, grid, methods[resampling], first.bands, first.dtype, nodata)
    recipe.require_nodata()
    tags = {HEIGHT_TAG: kind, "SEAMS": "best nadir", "RESAMPLING": resampling}
    with progress("orthophoto", grid.columns * grid.rows) as advance:
        threads = workers or os.cpu_count() or 1
        share, shown = ortho_job.write_orthophoto(output, recipe, files, system, tags, threads, advance)
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
        other = oriented(block, compare)[2].only(list(files))
        south, east = grid.north - grid.rows * grid.cell, grid.west + grid.columns * grid.cell
        near = ortho_job.overview(terrain, raster, (grid.west, south, east, grid.north))
        field = ortho_job.displacement_field(shots, other, near, frame, grid)
        title = f"{compare.name} against {run.name if run else block.name}"
        ortho_job.draw_displacement(field, title, displacement)
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
            f"{dtm} is a table of points", "give --dtm-cell, --dtm-output and --heights with it"
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
        raise ConfigurationError(f"--bounds {text} is empty", "write WEST,SOUTH,EAST,NORTH in metres")
    return west, south, east, north


def volume(
    sections: Annotated[
        Path | None,
        argument(
            "CSV of the points on the shell: section, point, X, Y, Z in metres, optional standard "
            "deviations sX, sY, sZ and correlations rXY, rXZ, rYZ."
        ),
    ] = None,
    radius: Annotated[float | None, option("Mean radius, m, in place of sections.")] = None,
    radius_sigma: Annotated[float | None, option("Its standard deviation, m.")] = None,
    height: Annotated[
        float | None, option("Measured height, m; with sections: volume by their mean radius too.")
    ] = None,
    height_sigma: Annotated[float | None, option("Its standard deviation, m.")] = None,
    sigma: Annotated[
        float | None, option("Standard deviation of all coordinates of a table without, m.")
    ] = None,
    vertical: Annotated[str, option("Axis of the table that points up: X, Y or Z.")] = "Z",
    shape: Annotated[
        str,
        option(
            "circle; or a curve or a polygon through the points of a section in their order around it: "
            "areas and volume by quadrature."
        ),
    ] = "circle",
    wall_thickness: Annotated[
        float, option("Taken from the measured radii, m, where the points lie outside.")
    ] = 0.0,
    plot: Annotated[Path | None, option("Residual ring plot to write: .pdf, .svg, .png.")] = None,
    as_json: AsJson = False,
) -> None:
    """Volume of a tank, round or of any closed shape, with its standard deviation.

    A circle is fitted to every section with the covariance of its points, a cylinder to all of them.

    Example: `photocal volume sections.csv --sigma 0.014 --height 9.5 --height-sigma 0.004 --plot rings.pdf`
    or `photocal volume --radius 6.479 --radius-sigma 0.003 --height 9.5 --height-sigma 0.004`
    """
    from photocal.products import sections as tanks
    from photocal.products.closed_sections import measure_closed

    if (radius is None) != (radius_sigma is None) or (height is None) != (height_sigma is None):
        raise ConfigurationError(
            "a length stands without its standard deviation, or the other way round",
            "give --radius with --radius-sigma and --height with --height-sigma",
        )
    if sections is not None and radius is not None:
        raise ConfigurationError("both a table of sections and --radius are given", "give one of them")
    if sections is None and (radius is None or height is None):
        raise ConfigurationError(
            "there is nothing to compute from",
            "name a table of sections, or give --radius and --height with their sigmas",
        )
    figures: dict[str, Any] = {"schema": tanks.SCHEMA}
    lines: list[str] = []
    if sections is not None:
        if vertical not in ("X", "Y", "Z"):
            raise ConfigurationError(f"--vertical {vertical} is no axis", "use X, Y or Z")
        points = tanks.read_ring_points(sections, cast("Literal['X', 'Y', 'Z']", vertical), sigma)
        if shape != "circle":
            if shape not in ("curve", "polygon") or plot or height or wall_thickness:
                raise ConfigurationError(
                    f"--shape {shape} with --plot, --height or --wall-thickness makes no sense",
                    "use circle, or curve or polygon without them",
                )
            closed, text = measure_closed(points, cast("Literal['curve', 'polygon']", shape))
            answer(as_json, lambda: figures | closed, lambda: text)
            return
        tank = tanks.measure_tank(points, wall_thickness)
        figures |= tanks.tank_json(tank, points.axes, wall_thickness)
        lines.append(tanks.tank_text(tank, points.axes, wall_thickness))
        radius, radius_sigma = tank.radius, tank.radius_sigma
        if plot is not None:
            tanks.draw_rings(tank, points.axes, plot)
    elif sigma is not None or plot is not None or wall_thickness != 0.0:
        raise ConfigurationError("--sigma, --plot and --wall-thickness need a table of sections")
    if height is not None:
        # The pairs were checked: with a height there are all four.
        whole = tanks.cylinder_volume(radius or 0.0, radius_sigma or 0.0, height, height_sigma or 0.0)
        figures["by_mean_radius"] = tanks.volume_json(whole)
        lines.append(f"by mean radius and height: {tanks.volume_text(whole)}")
    answer(as_json, lambda: figures, lambda: "\n".join(lines))

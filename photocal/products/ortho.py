"""The step `ortho`: an orthophoto of a block, its images and a terrain model."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError
from photocal.base.files import refuse_input_as_output
from photocal.base.progress_bars import progress
from photocal.findings.texts import Catalogue, catalogue
from photocal.products import ortho_job
from photocal.products.options import OrthoOptions
from photocal.products.oriented import oriented
from photocal.products.orthophoto import Recipe
from photocal.products.raster import HEIGHT_TAG, describe, system_wkt, terrain_source, write_terrain
from photocal.products.terrain import HEIGHT_KINDS, Bounds, Grid, grid_of_points, read_terrain_points


@dataclass(frozen=True, kw_only=True)
class Orthophoto:
    """An orthophoto that was written.

    Attributes
    ----------
    path
        Its GeoTIFF.
    grid
        Its cells, m.
    pixel_m
        Median size of an image's pixel on the ground, m.
    height_kind
        Kind of the heights of the terrain model.
    resampling
        How grey values were taken from the images.
    covered
        Share of the cells that an image shows, 0 to 1.
    cells
        Number of cells that each image gives.
    displacement, compared_with
        How far another adjustment would put things elsewhere, and which; None where none was compared.
    remarks
        What was made on the way.
    """

    path: Path
    grid: Grid
    pixel_m: float
    height_kind: str
    resampling: str
    covered: float
    cells: dict[str, int]
    displacement: ortho_job.Displacement | None = None
    compared_with: Path | None = None
    remarks: list[str] = field(default_factory=list)

    def figures(self) -> dict[str, Any]:
        """Give its figures as a JSON value."""
        grid, field_ = self.grid, self.displacement
        figures: dict[str, Any] = {
            "schema": "photocal.ortho/1",
            "output": str(self.path),
            "columns": grid.columns,
            "rows": grid.rows,
            "cell_m": grid.cell,
            "image_pixel_m": self.pixel_m,
            "west": grid.west,
            "north": grid.north,
            "height_kind": self.height_kind,
            "covered": self.covered,
            "cells": self.cells,
        }
        if field_ is not None:
            figures["displacement_m"] = {"rms": field_.rms, "largest": field_.largest}
        return figures

    def __repr__(self) -> str:
        """Say it for people."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """Give it as a text in a language."""
        grid, field_ = self.grid, self.displacement
        count = grid.columns * grid.rows
        size = {"columns": grid.columns, "rows": grid.rows, "cell": float(grid.cell)}
        how = {"resampling": say.stored(self.resampling), "heights": say.stored(self.height_kind)}
        lines = [
            *map(say.stored, self.remarks),
            say.told("product.ortho", file=self.path, **size, **how, covered=100.0 * self.covered),
        ]
        lines += [f"  {name}: {say.row([100 * n / count], '.1f')} %" for name, n in self.cells.items()]
        # Cells so many pixels wide leave pixels out.
        coarse = 2.0
        if grid.cell > coarse * self.pixel_m:
            pixels = float(grid.cell / self.pixel_m)
            lines.append(say.told("product.coarse", pixels=pixels, size=float(self.pixel_m)))
        if field_ is not None:
            sizes = {"rms": float(field_.rms), "largest": float(field_.largest)}
            lines.append(say.told("product.displacement", other=self.compared_with, **sizes))
        return "\n".join(lines)


def ortho(
    block: str | Path,
    images: str | Path,
    dtm: str | Path,
    output: str | Path,
    *,
    options: OrthoOptions | None = None,
) -> Orthophoto:
    """Make an orthophoto: every cell takes its grey value from the image that sees it best from above.

    Occlusions are not modelled: houses that are missing from the terrain model lean.

    Parameters
    ----------
    block
        Block folder, or the set-up file of another program.
    images
        Folder of the image files.
    dtm
        Terrain model: a raster that GDAL reads, or a CSV of points or contours (X, Y, Z, optional line), m.
    output
        GeoTIFF to write.
    options
        Adjustment whose orientations are taken, cells (m), bounds (m), resampling, comparison.

    Returns
    -------
    Orthophoto
        Cells, coverage, and the share of each image.

    Raises
    ------
    ConfigurationError
        For missing or contradicting settings, other kinds of heights, or other reference systems.
    InputNotFoundError, InputMalformedError
        For images or models that cannot be read.
    OutputError
        When the GeoTIFF cannot be written.

    Examples
    --------
    >>> import photocal
    >>> cells = photocal.OrthoOptions(heights="local", cell=0.2)
    >>> made = photocal.ortho(
    ...     "orthophoto/block", "orthophoto/images", "orthophoto/dtm.tif", "ortho.tif", options=cells
    ... )
    >>> made.grid.cell
    0.2
    """
    asked, methods = options or OrthoOptions(), ortho_job.METHODS
    if asked.resampling not in methods:
        raise ConfigurationError(f"--resampling {asked.resampling} is not known", f"use {', '.join(methods)}")
    if asked.heights is not None and asked.heights not in HEIGHT_KINDS:
        raise ConfigurationError(f"--heights {asked.heights} is not known", f"use {', '.join(HEIGHT_KINDS)}")
    if Path(output).suffix.lower() not in (".tif", ".tiff"):
        raise ConfigurationError(f"{output} has no known extension", "use .tif, .tiff")
    refuse_input_as_output(Path(output), Path(dtm))
    model_of_terrain, remarks = _terrain_file(Path(dtm), asked)
    model, frame, shots = oriented(Path(block), asked.run)
    files = ortho_job.image_files(model, Path(images), tuple(asked.image))
    shots = shots.only(list(files))
    raster = describe(model_of_terrain)
    kind = ortho_job.heights_of(raster, model, asked.heights)
    system = ortho_job.system_of(raster, model, asked.crs)
    terrain = terrain_source(raster, kind)
    rectangle = None if asked.bounds is None else _rectangle(asked.bounds)
    grid, pixel = ortho_job.plan_grid(shots, frame, terrain, raster, asked.cell, rectangle)
    first = next(iter(files.values()))
    method = methods[asked.resampling]
    recipe = Recipe(shots, frame, terrain, grid, method, first.bands, first.dtype, asked.nodata)
    recipe.require_nodata()
    tags = {HEIGHT_TAG: kind, "SEAMS": "best nadir", "RESAMPLING": asked.resampling}
    with progress("orthophoto", grid.columns * grid.rows) as advance:
        threads = asked.workers or os.cpu_count() or 1
        share, shown = ortho_job.write_orthophoto(Path(output), recipe, files, system, tags, threads, advance)
    moved = None
    if asked.compare is not None and asked.displacement is not None:
        other = oriented(Path(block), asked.compare)[2].only(list(files))
        south, east = grid.north - grid.rows * grid.cell, grid.west + grid.columns * grid.cell
        near = ortho_job.overview(terrain, raster, (grid.west, south, east, grid.north))
        moved = ortho_job.displacement_field(shots, other, near, frame, grid)
        title = f"{Path(asked.compare).name} against {Path(asked.run or block).name}"
        ortho_job.draw_displacement(moved, title, asked.displacement)
    return Orthophoto(
        path=Path(output),
        grid=grid,
        pixel_m=pixel,
        height_kind=kind,
        resampling=asked.resampling,
        covered=share,
        cells=shown,
        displacement=moved,
        compared_with=asked.compare,
        remarks=remarks,
    )


def _terrain_file(dtm: Path, asked: OrthoOptions) -> tuple[Path, list[str]]:
    """Make a raster of terrain points; a raster stays as it is."""
    cell, output = asked.dtm_cell, asked.dtm_output
    if dtm.suffix.lower() != ".csv":
        if cell is not None or output is not None:
            raise ConfigurationError("--dtm-cell and --dtm-output are for a CSV of terrain points")
        return dtm, []
    if cell is None or output is None or asked.heights is None:
        raise ConfigurationError(
            f"{dtm} is a table of points", "give --dtm-cell, --dtm-output and --heights with it"
        )
    xyz, line = read_terrain_points(dtm)
    system = "" if asked.crs is None else system_wkt(asked.crs)
    terrain, triangles, flat = grid_of_points(xyz, line, cell, system, asked.heights)
    write_terrain(terrain, output)
    note = f"{output}: {len(xyz)} points, {triangles} triangles"
    if flat:
        note += f", {flat} of them level within one contour (summits and hollows are cut off)"
    return output, [note]


def _rectangle(text: str) -> Bounds:
    form = "WEST,SOUTH,EAST,NORTH: a rectangle in metres"
    west, south, east, north = numbers_of(text, "--bounds", form)
    if not (west < east and south < north):
        raise ConfigurationError(f"--bounds {text} is empty", "write WEST,SOUTH,EAST,NORTH in metres")
    return west, south, east, north

"""Options of orthophotos, of contours, of products under check, and of volumes."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options


@dataclass(frozen=True, kw_only=True)
class ProductOptions(Options):
    """Orthomosaic and terrain model that are read at check points."""

    points: Annotated[
        Path | None,
        Option(
            "Instead of a block: CSV of check points (point, E, N, h) for --ortho and --dtm, in their "
            "reference system."
        ),
    ] = None
    ortho: Annotated[Path | None, Option("Orthomosaic that shows the targets of the check points.")] = None
    target_diameter: Annotated[float | None, Option("Diameter of these round targets, metres.")] = None
    search_radius: Annotated[
        float, Option("Radius of the search around the expected place of a target, metres.")
    ] = 2.0
    dtm: Annotated[Path | None, Option("Terrain model that is read at the check points.")] = None
    height_kind: Annotated[
        str | None, Option("Height kind of the check points: ellipsoidal, orthometric or local.")
    ] = None
    dtm_height_kind: Annotated[
        str | None, Option("Height kind of a terrain model that does not state it.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class OrthoOptions(Options):
    """Orientation, images, cells, terrain and comparison of an orthophoto."""

    run: Annotated[Path | None, Option("Adjustment of the block; without: orientations as given.")] = None
    image: Annotated[tuple[str, ...], Option("Only this image; may be repeated.")] = ()
    cell: Annotated[float | None, Option("Size of a cell, m; without: the ground sample distance.")] = None
    bounds: Annotated[str | None, Option("Rectangle: WEST,SOUTH,EAST,NORTH in metres.")] = None
    resampling: Annotated[str, Option("nearest, bilinear or cubic.")] = "bilinear"
    crs: Annotated[str | None, Option("Reference system of block and terrain model.")] = None
    heights: Annotated[str | None, Option("Height kind of a terrain model that does not state it.")] = None
    dtm_cell: Annotated[float | None, Option("Cell size for gridding a CSV of terrain points, m.")] = None
    dtm_output: Annotated[Path | None, Option("GeoTIFF of the terrain model made from a CSV.")] = None
    nodata: Annotated[
        float, Option("Value of cells without image; equal grey values of images are changed by one.")
    ] = 0.0
    compare: Annotated[
        Path | None, Option("Another adjustment of the block, with another interior orientation.")
    ] = None
    displacement: Annotated[
        Path | None, Option("Map (.pdf, .svg, .png) of the displacements that --compare would cause.")
    ] = None
    workers: Annotated[int, Option("Number of threads; 0: all cores.")] = 0

    def __post_init__(self) -> None:
        """Refuse half a comparison."""
        if (self.compare is None) != (self.displacement is None):
            raise ConfigurationError("--compare and --displacement go together", "give both or none")


@dataclass(frozen=True, kw_only=True)
class ContourOptions(Options):
    """Interval, heights and cells of contours."""

    interval: Annotated[float, Option("Height between contours, m.")]
    index: Annotated[int, Option("Number of contour intervals between index contours.")] = 5
    heights: Annotated[str | None, Option("Height kind of a terrain model that does not state it.")] = None
    crs: Annotated[str | None, Option("Reference system of a terrain model that names none.")] = None
    cell: Annotated[float | None, Option("Cell size for gridding a CSV of terrain points, m.")] = None

    def __post_init__(self) -> None:
        """Refuse an interval that gives no contours."""
        if not (math.isfinite(self.interval) and self.interval > 0 and self.index > 0):
            raise ConfigurationError(
                f"contours every {self.interval:g} m, index contours every {self.index}, are impossible",
                "give --interval and --index greater than 0",
            )


@dataclass(frozen=True, kw_only=True)
class VolumeOptions(Options):
    """Lengths, sigmas and shape of a tank."""

    radius: Annotated[float | None, Option("Mean radius, m, in place of sections.")] = None
    radius_sigma: Annotated[float | None, Option("Standard deviation, m.")] = None
    height: Annotated[
        float | None, Option("Measured height, m; with sections: volume by their mean radius too.")
    ] = None
    height_sigma: Annotated[float | None, Option("Standard deviation, m.")] = None
    sigma: Annotated[
        float | None, Option("Standard deviation of all coordinates, m, for a table without sigmas.")
    ] = None
    vertical: Annotated[str, Option("Axis of the table that points up: X, Y or Z.")] = "Z"
    shape: Annotated[
        str,
        Option(
            "circle; or curve or polygon, through the points of a section in their order around it: "
            "areas and volume by quadrature."
        ),
    ] = "circle"
    wall_thickness: Annotated[
        float, Option("Thickness to subtract from the measured radii, m, if the points lie on the outside.")
    ] = 0.0
    filling: Annotated[
        float | None, Option("With sections: step of the filling table, metres, with sigmas.")
    ] = None
    plot: Annotated[Path | None, Option("Residual ring plot to write: .pdf, .svg, .png.")] = None

    def __post_init__(self) -> None:
        """Refuse a length without its standard deviation."""
        pairs = ((self.radius, self.radius_sigma), (self.height, self.height_sigma))
        if any((length is None) != (sigma is None) for length, sigma in pairs):
            raise ConfigurationError(
                "a length or a standard deviation is given without the other",
                "give --radius with --radius-sigma and --height with --height-sigma",
            )

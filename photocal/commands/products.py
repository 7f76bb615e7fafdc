"""`photocal ortho`, `contours`, `volume`: orthophotos of oriented images, contours, the volume of a tank."""

from pathlib import Path
from typing import Annotated

from photocal.base.console import AsJson, Language, answer, argument, option, spread
from photocal.products.options import ContourOptions, OrthoOptions, VolumeOptions


@spread
def ortho(
    block: Annotated[Path, argument("Block folder, or a set-up file of another program.", metavar="BLOCK")],
    images: Annotated[Path, option("Folder of the image files.")],
    dtm: Annotated[
        Path,
        option(
            "Terrain model: any raster that GDAL reads, or a CSV of points or contours (X, Y, Z, "
            "optional line), such as points.csv of an adjustment, all in metres."
        ),
    ],
    output: Annotated[Path, option("GeoTIFF to write.", "-o", "--output")],
    *,
    options: OrthoOptions,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Make an orthophoto: every cell takes its grey value from the image that sees it best from above.

    Occlusions are not modelled: houses that are missing from the terrain model lean. Seams run where the next
    image is closer to nadir, and grey values are not changed. For blended seams and balanced colours export
    the orientations, `photocal export RUN --format metashape -o DIR`: in Metashape import the cameras, then
    "Calibrate Colors" and "Build Orthomosaic" with mosaic blending.

    Example: `photocal ortho block --run run --images photos --dtm dtm.tif --cell 0.1 -o ortho.tif`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.products.ortho import ortho as made_of

    made = made_of(block, images, dtm, output, options=options)
    answer(as_json, made.figures, lambda: made.text(catalogue(spoken(language))))


@spread
def contours(
    dtm: Annotated[
        Path,
        argument(
            "Terrain model: any raster that GDAL reads, or a CSV of points (X, Y, Z, optional line).",
            metavar="TERRAIN",
        ),
    ],
    output: Annotated[Path, option("File to write: .dxf, .shp or .gpkg.", "-o", "--output")],
    *,
    options: ContourOptions,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Write the contours of a terrain model for CAD (DXF) or GIS (Shapefile, GeoPackage).

    Vertices have the height as Z. Shapefile and GeoPackage have the columns `height`, `index` (1 for an index
    contour) and `kind` (of the heights), and the reference system. A DXF is in metres, with index contours on
    a layer of their own and the reference system in a .prj file.

    Example: `photocal contours dtm.tif --interval 0.5 -o contours.dxf`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.products.contours import contours as made_of

    made = made_of(dtm, output, options)
    answer(as_json, made.figures, lambda: made.text(catalogue(spoken(language))))


@spread
def volume(
    sections: Annotated[
        Path | None,
        argument(
            "CSV of the points on the shell: section, point, X, Y, Z in metres, optional standard "
            "deviations sX, sY, sZ and correlations rXY, rXZ, rYZ.",
            metavar="SECTIONS.csv",
        ),
    ] = None,
    *,
    options: VolumeOptions,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Compute the volume of a tank, round or of any closed shape, with its standard deviation.

    A circle is fitted to every section with the covariance of its points, a cylinder to all of them.

    Example: `photocal volume sections.csv --sigma 0.014 --height 9.5 --height-sigma 0.004 --plot rings.pdf`,
    or `photocal volume --radius 6.479 --radius-sigma 0.003 --height 9.5 --height-sigma 0.004`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.products.volume import volume as measured

    volume = measured(sections, options)
    answer(as_json, lambda: volume.figures, lambda: volume.text(catalogue(spoken(language))))

"""`photocal radiometry`: sharpness, resolution on the ground, fall of light and linearity of a camera."""

from pathlib import Path
from typing import Annotated

from photocal.base.console import AsJson, answer, numbers_of, option
from photocal.base.errors import ConfigurationError


def radiometry(
    edge: Annotated[Path | None, option("Picture of a slanted edge: its MTF (ISO 12233).")] = None,
    region: Annotated[str | None, option("COLUMN,ROW,WIDTH,HEIGHT of the edge in it, px.")] = None,
    star: Annotated[Path | None, option("Picture of a Siemens star.")] = None,
    place: Annotated[str | None, option("COLUMN,ROW,RADIUS of the star in it, px.")] = None,
    spokes: Annotated[int, option("Bright sectors of the star.", min=4)] = 36,
    gsd_cm: Annotated[float | None, option("Ground sampling distance at the star, cm.")] = None,
    flat: Annotated[
        Path | None, option("Folder of pictures of an even surface, at several exposure times for linearity.")
    ] = None,
    output: Annotated[
        Path | None, option("TOML to write, [radiometry] of a certificate's particulars.", "-o", "--output")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the radiometry of a camera for the annex of its certificate.

    Grey values must be linear: raw pictures, or TIFF made without a curve of tones.

    Example: `photocal radiometry --edge edge.tif --star star.tif --place 2100,1480,600 --gsd-cm 1.5`
    """
    import math

    import numpy as np

    from photocal.base.files import output_file
    from photocal.measurement import radiometry as measure
    from photocal.measurement.image_facts import read_facts
    from photocal.measurement.image_file import list_images, read_grey

    figures: dict[str, float] = {}
    if edge is not None:
        grey = read_grey(edge)
        if region is not None:
            column, row, width, height = map(
                int, numbers_of(region, "--region", "COLUMN,ROW,WIDTH,HEIGHT: px")
            )
            grey = grey[row : row + height, column : column + width]
        frequency, transfer, figures["edge_slant_deg"] = measure.edge_mtf(grey)
        figures["mtf50_cycles_px"] = measure.falls_to(frequency, transfer, 0.5)
        figures["mtf10_cycles_px"] = measure.falls_to(frequency, transfer, measure.RESOLVED)
        figures["mtf_at_nyquist"] = float(np.interp(0.5, frequency, transfer))
    if star is not None:
        if place is None:
            raise ConfigurationError("--star needs --place", remedy="give COLUMN,ROW,RADIUS in pixels")
        column_, row_, radius = numbers_of(place, "--place", "COLUMN,ROW,RADIUS: px")
        frequency, contrast = measure.siemens_star(read_grey(star), (column_, row_), radius, spokes)
        limit = figures["star_limit_cycles_px"] = measure.falls_to(frequency, contrast, measure.RESOLVED)
        if gsd_cm is not None:
            figures["ground_resolution_cm"] = gsd_cm / limit
    if flat is not None:
        pictures = ((read_facts(path).exposure_s, read_grey(path)) for path in list_images(flat))
        figures |= measure.even_surface(pictures)
    if not figures:
        raise ConfigurationError("there is nothing to measure", remedy="give --edge, --star or --flat")
    rounded = {name: float(f"{value:.4g}") for name, value in figures.items() if math.isfinite(value)}
    lines = [f"{name} = {value}" for name, value in rounded.items()]
    if output is not None:
        with output_file(output) as aside:
            aside.write_text("\n".join(["[radiometry]", *lines, ""]), encoding="utf-8")
    answer(as_json, lambda: rounded, lambda: "\n".join(lines))

"""`photocal radiometry`: sharpness, resolution on the ground, fall of light and linearity of a camera."""

from pathlib import Path
from typing import Annotated

from photocal.base.console import AsJson, answer, option, spread
from photocal.measurement.radiometry_options import RadiometryOptions


@spread
def radiometry(
    options: RadiometryOptions,
    output: Annotated[
        Path | None, option("TOML to write, [radiometry] of a certificate's particulars.", "-o", "--output")
    ] = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Measure the radiometry of a camera for the annex of its certificate.

    Grey values must be linear: raw pictures, or TIFF made without a curve of tones.

    Example: `photocal radiometry --edge edge.tif --star star.tif --place 2100,1480,600 --gsd-cm 1.5`
    """
    from photocal.base.files import output_file
    from photocal.measurement.radiometry import measure_radiometry

    figures = measure_radiometry(options)
    lines = [f"{name} = {value}" for name, value in figures.items()]
    if output is not None:
        with output_file(output) as aside:
            aside.write_text("\n".join(["[radiometry]", *lines, ""]), encoding="utf-8")
    answer(as_json, lambda: figures, lambda: "\n".join(lines))

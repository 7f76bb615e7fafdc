"""`photocal check`: a product judged at its check points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def check(
    discrepancies: Annotated[
        Path,
        typer.Option(
            help="CSV with the columns point, dE, dN, dh = reference minus product, in metres or with the "
            "unit in the header (dE_cm); optional E, N, h."
        ),
    ],
    standard: Annotated[
        list[str] | None,
        typer.Option(
            help="decree-89817, pec-pcd, asprs-2024 or a TOML file; may be repeated. Without: all three."
        ),
    ] = None,
    scale: Annotated[str | None, typer.Option(help="Map scale to judge at, such as 1:1000.")] = None,
    interval: Annotated[float | None, typer.Option(help="Contour interval in metres to judge at.")] = None,
    confidence: Annotated[
        float, typer.Option(help="Level of the tests: two-sided for the bias, one-sided for the precision.")
    ] = 0.90,
    survey_horizontal: Annotated[
        float | None, typer.Option(help="Horizontal RMSE of the survey of the check points, metres.")
    ] = None,
    survey_vertical: Annotated[
        float | None, typer.Option(help="Vertical RMSE of the survey of the check points, metres.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(help="Folder for the residual map and the histograms (PDF).")
    ] = None,
    geopackage: Annotated[
        Path | None, typer.Option(help="GeoPackage of points and residual vectors for QGIS, to be written.")
    ] = None,
    crs: Annotated[
        str | None, typer.Option(help="Projected system of E and N for the GeoPackage, such as EPSG:31982.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Judge a product at its check points: statistics, tests and accuracy classes.

    Two classes are given side by side: by precision (the bias removed) and by accuracy (90 % of the
    points within PEC and RMSE within the standard error), with the largest scale that each admits.

    Example: `photocal check --discrepancies check.csv --scale 1:1000 --interval 1`
    """
    from photocal.accuracy.as_json import to_json
    from photocal.accuracy.as_text import to_text
    from photocal.accuracy.assessment import Question, assess
    from photocal.accuracy.discrepancies import read_discrepancies
    from photocal.accuracy.map_scale import parse_scale
    from photocal.accuracy.standard_file import SHIPPED, load_standard

    question = Question(
        None if scale is None else parse_scale(scale),
        interval,
        confidence,
        survey_horizontal,
        survey_vertical,
    )
    standards = tuple(load_standard(name) for name in standard or SHIPPED)
    result = assess(read_discrepancies(discrepancies), standards, question)
    if figures is not None:
        from photocal.accuracy.figures import write_figures

        write_figures(result.discrepancies, figures)
    if geopackage is not None:
        from datetime import UTC, datetime

        from photocal.accuracy.geopackage import reference_system, write_geopackage

        # The time of the table, not of the clock: the same input gives the same file.
        changed = datetime.fromtimestamp(discrepancies.stat().st_mtime, UTC)
        stamp = f"{changed:%Y-%m-%dT%H:%M:%S}.000Z"
        write_geopackage(geopackage, (("check", result.discrepancies),), reference_system(crs), stamp)
    answer(as_json, lambda: to_json(result), lambda: to_text(result))

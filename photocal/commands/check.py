"""`photocal check`: a block or a product judged at its check points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import ConfigurationError
from photocal.commands.check_of_block import (
    judge_block,
    judge_experiment,
    judge_numbers,
    judge_product,
    noise_of,
    with_project,
)
from photocal.commands.options import AsJson


def check(
    block: Annotated[
        Path | None,
        typer.Argument(
            help="Block folder, PROJECT.toml, or a set-up file of another program; its points have roles."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for tables, figures, GeoPackages and the report."),
    ] = None,
    discrepancies: Annotated[
        Path | None,
        typer.Option(
            help="Instead of a block: CSV with the columns point, correction_E, correction_N, correction_h, "
            "or dE, dN, dh as studies print them (both reference minus product), in metres or with the "
            "unit in the header (dE_cm); optional E, N, h."
        ),
    ] = None,
    experiment: Annotated[
        Path | None,
        typer.Option(help="Instead of a block: TOML file with interior orientations and control patterns."),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            help="Instead of a block: CSV of check points (point, E, N, h) for --ortho and --dtm, in their "
            "reference system."
        ),
    ] = None,
    ortho: Annotated[
        Path | None, typer.Option(help="Orthomosaic that shows the targets of the check points.")
    ] = None,
    target_diameter: Annotated[float | None, typer.Option(help="Of those round targets, metres.")] = None,
    search_radius: Annotated[
        float, typer.Option(help="How far from its place a target is looked for, metres.")
    ] = 2.0,
    dtm: Annotated[Path | None, typer.Option(help="Terrain model that is read at the check points.")] = None,
    height_kind: Annotated[
        str | None, typer.Option(help="Of the check points: ellipsoidal, orthometric or local.")
    ] = None,
    dtm_height_kind: Annotated[
        str | None, typer.Option(help="Of a terrain model that does not say it itself.")
    ] = None,
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
        float | None, typer.Option(help="Horizontal (radial) RMSE of the survey of the check points, metres.")
    ] = None,
    survey_vertical: Annotated[
        float | None, typer.Option(help="Vertical RMSE of the survey of the check points, metres.")
    ] = None,
    target_horizontal: Annotated[
        float | None, typer.Option(help="Horizontal (radial) RMSE that is asked for, metres.")
    ] = None,
    target_vertical: Annotated[
        float | None, typer.Option(help="Vertical RMSE that is asked for, metres.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(help="With --discrepancies: folder for residual map and histograms (PDF).")
    ] = None,
    geopackage: Annotated[
        Path | None, typer.Option(help="With --discrepancies: GeoPackage for QGIS, to be written.")
    ] = None,
    crs: Annotated[
        str | None, typer.Option(help="Projected system of E and N for the GeoPackage, such as EPSG:31982.")
    ] = None,
    control_numbers: Annotated[
        str | None,
        typer.Option(help="How much control is needed: repeat with so many control points, such as 0,1,3,5."),
    ] = None,
    simulate_direct: Annotated[
        str | None,
        typer.Option(
            help="Noise M,DEG of simulated exposures for direct georeferencing from the adjusted orientation."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of that noise.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Judge a block or a product at its check points: statistics, tests and accuracy classes.

    A block is georeferenced three ways (direct, integrated, indirect); lever arm, boresight, time and
    datum errors are looked for. Two classes are given side by side: by precision (the bias removed) and
    by accuracy (90 % of the points within PEC and RMSE within the standard error).

    Example: `photocal check field7 -o field7-check --scale 1:1000`
    """
    from photocal.accuracy.standard import Question, parse_scale
    from photocal.accuracy.standard_file import SHIPPED, load_standard

    if sum(source is not None for source in (block, discrepancies, experiment, points)) != 1:
        raise ConfigurationError(
            "there must be one thing to check",
            remedy="name a block or project, or --discrepancies, or --experiment, or --points",
        )
    if experiment is not None:
        judge_experiment(experiment, output, as_json=as_json)
        return
    if control_numbers is not None:
        if block is None:
            raise ConfigurationError("--control-numbers needs a block", remedy="name a block or project")
        source = with_project(block, Question())[0].output / "block" if block.suffix == ".toml" else block
        judge_numbers(source, control_numbers, output, as_json=as_json)
        return
    question = Question(
        None if scale is None else parse_scale(scale),
        interval,
        confidence,
        survey_horizontal,
        survey_vertical,
        target_horizontal,
        target_vertical,
    )
    noise = None if simulate_direct is None else noise_of(simulate_direct, seed)
    if block is not None and block.suffix == ".toml":
        project, question = with_project(block, question)
        names = standard or project.contents.judgement.standards or SHIPPED
        standards = tuple(load_standard(name) for name in names)
        source = project.output / "block"
        judge_block(source, output, standards, question, noise, crs, on_the_job=True, as_json=as_json)
        return
    standards = tuple(load_standard(name) for name in standard or SHIPPED)
    folder = figures or output
    if block is not None:
        judge_block(block, output, standards, question, noise, crs, on_the_job=False, as_json=as_json)
    elif discrepancies is not None:
        from photocal.accuracy.discrepancies import read_discrepancies

        table = read_discrepancies(discrepancies)
        judge_product(table, discrepancies, standards, question, folder, geopackage, crs, as_json=as_json)
    elif points is not None:
        from photocal.products.product_check import check_products, read_check_points

        found = check_products(
            read_check_points(points),
            ortho=ortho,
            target_diameter_m=target_diameter,
            search_m=search_radius,
            dtm=dtm,
            height_kind=height_kind,
            dtm_height_kind=dtm_height_kind,
        )
        judge_product(found, points, standards, question, folder, geopackage, crs, as_json=as_json)

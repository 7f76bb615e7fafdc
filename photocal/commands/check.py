"""`photocal check`: a block or a product judged at its check points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer, progress
from drivers.errors import ConfigurationError

if TYPE_CHECKING:
    import numpy as np

    from photocal.accuracy.assessment import Question
    from photocal.accuracy.discrepancies import Discrepancies
    from photocal.accuracy.georeferencing.experiment import InteriorSet
    from photocal.accuracy.georeferencing.simulated import Degradation
    from photocal.accuracy.standard import Standard
    from photocal.products.product_check import ProductCheck
    from photocal.project import Project


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
            help="Instead of a block: CSV with the columns point, dE, dN, dh = reference minus product, in "
            "metres or with the unit in the header (dE_cm); optional E, N, h."
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
        float | None, typer.Option(help="Horizontal RMSE of the survey of the check points, metres.")
    ] = None,
    survey_vertical: Annotated[
        float | None, typer.Option(help="Vertical RMSE of the survey of the check points, metres.")
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
    simulate_direct: Annotated[
        str | None,
        typer.Option(
            help="Noise M,DEG of simulated exposures for direct georeferencing from the adjusted orientation."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of that noise.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Judge a block or a product at its check points: statistics, tests and accuracy classes.

    A block is georeferenced three ways (direct, integrated, indirect); lever arm, boresight, time and
    datum errors are looked for. Two classes are given side by side: by precision (the bias removed) and
    by accuracy (90 % of the points within PEC and RMSE within the standard error).

    Example: `photocal check field7 -o field7-check --scale 1:1000`
    """
    from photocal.accuracy.assessment import Question
    from photocal.accuracy.map_scale import parse_scale
    from photocal.accuracy.standard_file import SHIPPED, load_standard

    if sum(source is not None for source in (block, discrepancies, experiment, points)) != 1:
        raise ConfigurationError(
            "there must be one thing to check",
            remedy="name a block or project, or --discrepancies, or --experiment, or --points",
        )
    if experiment is not None:
        _experiment(experiment, output, as_json=as_json)
        return
    question = Question(
        None if scale is None else parse_scale(scale),
        interval,
        confidence,
        survey_horizontal,
        survey_vertical,
    )
    noise = None if simulate_direct is None else _noise(simulate_direct, seed)
    if block is not None and block.suffix == ".toml":
        project, question = _project(block, question)
        names = standard or project.contents.judgement.standards or SHIPPED
        standards = tuple(load_standard(name) for name in names)
        source = project.output / "block"
        _block(source, output, standards, question, noise, crs, on_the_job=True, as_json=as_json)
        return
    standards = tuple(load_standard(name) for name in standard or SHIPPED)
    folder = figures or output
    if block is not None:
        _block(block, output, standards, question, noise, crs, on_the_job=False, as_json=as_json)
    elif discrepancies is not None:
        _discrepancies(discrepancies, standards, question, folder, geopackage, crs, as_json=as_json)
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
        _product(found, points, standards, question, folder, geopackage, crs, as_json=as_json)


def _block(
    source: Path,
    output: Path | None,
    standards: tuple[Standard, ...],
    question: Question,
    noise: tuple[Degradation, np.random.Generator] | None,
    crs: str | None,
    *,
    on_the_job: bool,
    as_json: bool,
) -> None:
    from photocal.accuracy.geopackage import reference_system
    from photocal.accuracy.georeferencing.as_json import to_json
    from photocal.accuracy.georeferencing.as_text import to_text
    from photocal.accuracy.georeferencing.comparison import check_block
    from photocal.accuracy.georeferencing.methods import METHODS
    from photocal.exchange.any_block import read_any_block
    from photocal.run.georeferencing import own_calibration

    read = read_any_block(source)
    # Known beforehand only where it is needed: a wrong frame is better explained by the check itself.
    system = reference_system(crs) if crs else None
    with progress("checking", len(METHODS) + 2) as advance:
        # A flight is its own calibration; a block folder states what it wants to be judged with.
        calibration = own_calibration(read) if on_the_job else None
        result = check_block(read, standards, question, noise, lambda _: advance(1), calibration)
    content = to_json(result)
    if output is not None:
        from photocal.accuracy.georeferencing.output import write_check

        system = system or reference_system(None if read.frame == "local" else read.frame)
        write_check(result, content, output, system, _stamp(source))
    said = "" if output is None else f"\nwritten to {output}"
    answer(as_json, lambda: content, lambda: to_text(result) + said)


def _project(path: Path, question: Question) -> tuple[Project, Question]:
    """Bring the block of a project up to date; what the command line does not ask, the project does."""
    import datetime as dt
    from dataclasses import replace

    from photocal.accuracy.map_scale import parse_scale
    from photocal.project import read_project
    from photocal.run.workflow import run_project

    project = read_project(path)
    asked = project.contents.judgement
    run_project(project, dt.datetime.now().astimezone().date(), progress, until="block")
    own_scale = None if asked.scale is None else parse_scale(asked.scale)
    return project, replace(
        question,
        scale_denominator=question.scale_denominator or own_scale,
        interval_m=question.interval_m or asked.contour_interval_m,
        survey_horizontal_m=question.survey_horizontal_m or asked.survey_horizontal_m,
        survey_vertical_m=question.survey_vertical_m or asked.survey_vertical_m,
    )


def _experiment(path: Path, output: Path | None, *, as_json: bool) -> None:
    from photocal.accuracy.georeferencing.experiment import run_experiment
    from photocal.accuracy.georeferencing.experiment_file import read_experiment
    from photocal.accuracy.georeferencing.experiment_output import to_json, to_text, write_experiment
    from photocal.exchange.any_block import read_any_block

    asked = read_experiment(path, read_any_block, _interiors)
    with progress("running", None) as advance:
        outcome = run_experiment(asked, lambda: advance(1))
    if output is not None:
        write_experiment(outcome, output)
    said = "" if output is None else f"\nwritten to {output}"
    answer(as_json, lambda: to_json(outcome), lambda: to_text(outcome) + said)


def _interiors(path: Path) -> tuple[InteriorSet, ...]:
    """Calibrations of a file as `photocal compare` reads it."""
    import numpy as np

    from photocal.accuracy.georeferencing.experiment import InteriorSet
    from photocal.analysis.stability.camera_file import read_camera_file
    from photocal.geometry.camera import PARAMETERS

    sets = []
    for one in read_camera_file(path).calibrations:
        sigma, correlation = np.full(len(PARAMETERS), np.nan), np.eye(len(PARAMETERS))
        if one.uncertainty is not None:
            at = [PARAMETERS.index(name) for name in one.uncertainty.names]
            sigma[at] = one.uncertainty.sigmas
            correlation[np.ix_(at, at)] = one.uncertainty.correlation
        sets.append(InteriorSet(one.id, one.camera, sigma, correlation))
    return tuple(sets)


def _product(
    found: ProductCheck,
    path: Path,
    standards: tuple[Standard, ...],
    question: Question,
    figures: Path | None,
    geopackage: Path | None,
    crs: str | None,
    *,
    as_json: bool,
) -> None:
    """Judge what an orthomosaic and a terrain model say at the check points."""
    from photocal.accuracy.as_json import to_json
    from photocal.accuracy.as_text import to_text
    from photocal.accuracy.assessment import assess
    from photocal.accuracy.georeferencing.as_json import finite

    result = assess(found.discrepancies, standards, question)
    _files(result.discrepancies, path, figures, geopackage, crs)
    answer(
        as_json,
        lambda: {
            **to_json(result),
            "likeness": [finite(v) for v in found.likeness.tolist()],
            "remarks": list(found.remarks),
        },
        lambda: "\n".join([to_text(result), *found.remarks]),
    )


def _discrepancies(
    path: Path,
    standards: tuple[Standard, ...],
    question: Question,
    figures: Path | None,
    geopackage: Path | None,
    crs: str | None,
    *,
    as_json: bool,
) -> None:
    from photocal.accuracy.as_json import to_json
    from photocal.accuracy.as_text import to_text
    from photocal.accuracy.assessment import assess
    from photocal.accuracy.discrepancies import read_discrepancies

    result = assess(read_discrepancies(path), standards, question)
    _files(result.discrepancies, path, figures, geopackage, crs)
    answer(as_json, lambda: to_json(result), lambda: to_text(result))


def _files(
    found: Discrepancies, path: Path, figures: Path | None, geopackage: Path | None, crs: str | None
) -> None:
    """Residual map, histograms and GeoPackage of a product, where they are asked for."""
    if figures is not None:
        from photocal.accuracy.figures import write_figures

        write_figures(found, figures)
    if geopackage is not None:
        from photocal.accuracy.geopackage import reference_system, write_geopackage

        write_geopackage(geopackage, (("check", found),), reference_system(crs), _stamp(path))


def _stamp(source: Path) -> str:
    """Time of the input, not of the clock: the same input gives the same file."""
    from datetime import UTC, datetime

    table = source / "points.csv" if source.is_dir() else source
    changed = datetime.fromtimestamp(table.stat().st_mtime, UTC)
    return f"{changed:%Y-%m-%dT%H:%M:%S}.000Z"


def _noise(text: str, seed: int) -> tuple[Degradation, np.random.Generator]:
    import math

    import numpy as np

    from photocal.accuracy.georeferencing.simulated import Degradation

    try:
        position, attitude = (float(part) for part in text.split(","))
    except ValueError as refusal:
        raise ConfigurationError(
            f"{text!r} is not a noise of position and attitude", remedy="write metres,degrees: 0.08,0.02"
        ) from refusal
    return Degradation(position, math.radians(attitude)), np.random.default_rng(seed)

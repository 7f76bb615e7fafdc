"""`photocal check`: a block, a project, an experiment or a product judged at its check points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from photocal.base.console import AsJson, answer, argument, numbers_of, option, progress
from photocal.base.errors import ConfigurationError

if TYPE_CHECKING:
    import numpy as np

    from photocal.accuracy.discrepancies import Discrepancies
    from photocal.accuracy.standard import Question, Standard
    from photocal.geometry.camera import Camera
    from photocal.georeferencing.methods import Degradation
    from photocal.products.product_check import ProductCheck
    from photocal.project import Project

# Figures as a JSON value, and the same for people.
Judged: TypeAlias = tuple[dict[str, Any], str]


def judge_product(
    product: Discrepancies | ProductCheck,
    path: Path,
    standards: tuple[Standard, ...],
    question: Question,
    figures: Path | None,
    geopackage: Path | None,
    crs: str | None,
) -> Judged:
    """Judge a table of discrepancies, or what an orthomosaic and a terrain model say at the check points."""
    from photocal.accuracy.assessment import assess
    from photocal.accuracy.discrepancies import Discrepancies
    from photocal.accuracy.output import to_json, to_text
    from photocal.base.arrays import as_plain

    more: dict[str, object] = {}
    remarks: tuple[str, ...] = ()
    if not isinstance(product, Discrepancies):
        likeness, remarks = as_plain(product.likeness), product.remarks
        more, product = {"likeness": likeness, "remarks": list(remarks)}, product.discrepancies
    result = assess(product, standards, question)
    if figures is not None:
        from photocal.accuracy.maps import check_figures, save_figures
        from photocal.base.files import output_folder

        with output_folder(figures) as aside:
            save_figures(aside, check_figures(result.discrepancies, question.gsd_m))
    if geopackage is not None:
        from photocal.accuracy.maps import reference_system, write_geopackage
        from photocal.base.geopackage import changed_utc

        write_geopackage(geopackage, (("check", product),), reference_system(crs), changed_utc(path))
    return to_json(result) | more, "\n".join([to_text(result), *remarks])


def judge_block(
    source: Path,
    output: Path | None,
    standards: tuple[Standard, ...],
    question: Question,
    noise: tuple[Degradation, np.random.Generator] | None,
    crs: str | None,
    *,
    on_the_job: bool,
) -> Judged:
    """Georeference a block three ways and judge it."""
    from photocal.accuracy.maps import reference_system
    from photocal.exchange.formats import read_any_block
    from photocal.findings.finding import Finding
    from photocal.findings.texts import catalogue, finding_json, finding_text, plain
    from photocal.georeferencing.comparison import check_block
    from photocal.georeferencing.methods import METHODS, with_shutters
    from photocal.georeferencing.output import to_json, to_text
    from photocal.run.stage import is_stage
    from photocal.run.summary import outdated, project_verdict

    read = read_any_block(source)
    # Known beforehand only where it is needed: a wrong frame is better explained by the check itself.
    system = reference_system(crs) if crs else None
    with progress("checking", len(METHODS) + 2) as advance:
        # A flight is its own calibration; a block folder states what it wants to be judged with.
        read = with_shutters(read)
        result = check_block(read, standards, question, noise, lambda _: advance(1), on_the_job=on_the_job)
    content, text = to_json(result), to_text(result)
    # A project has one verdict, however its block is named: that over all its stages.
    say, of_project = catalogue("en"), on_the_job or is_stage(source)
    final = project_verdict(source.parent) if of_project else None
    if final is not None:
        own_verdict, content["verdict"] = content["verdict"]["text"], finding_json(final, say)
        text = text.replace(own_verdict, content["verdict"]["text"])
    elif of_project and outdated(source.parent):
        note = Finding("certificate-outdated", "note")
        content["findings"].append(finding_json(note, say))
        text += f"\n{finding_text(note, say, plain)}"
    if output is not None:
        from photocal.base.geopackage import changed_utc
        from photocal.georeferencing.output import write_check

        system = system or reference_system(None if read.frame == "local" else read.frame)
        write_check(result, content, output, system, changed_utc(source))
    return content, _with_place(text, output)


def with_project(path: Path, question: Question) -> tuple[Project, Question]:
    """Bring the block of a project up to date; what the command line does not ask, the project does."""
    import datetime as dt
    from dataclasses import replace

    from photocal.project import read_project
    from photocal.run.campaign import run_project
    from photocal.run.georeferencing import question_of

    project = read_project(path)
    run_project(project, dt.datetime.now().astimezone().date(), progress, until="block")
    asked = {name: value for name, value in vars(question).items() if value is not None}
    return project, replace(question_of(project), **asked)


def judge_experiment(path: Path, output: Path | None) -> Judged:
    """Run an experiment with interior orientations and control patterns."""
    from photocal.exchange.formats import read_any_block
    from photocal.georeferencing.experiment import read_experiment, run_experiment
    from photocal.georeferencing.experiment_output import to_json, to_text, write_experiment

    asked = read_experiment(path, read_any_block, _interiors)
    with progress("running", None) as advance:
        outcome = run_experiment(asked, lambda: advance(1))
    if output is not None:
        write_experiment(outcome, output)
    return to_json(outcome), _with_place(to_text(outcome), output)


def judge_numbers(source: Path, counts: str, output: Path | None) -> Judged:
    """Repeat the adjustment with several numbers of control points."""
    from photocal.accuracy.maps import save_figures
    from photocal.base.files import output_folder, write_json
    from photocal.exchange.formats import read_any_block
    from photocal.georeferencing.experiment import control_numbers, numbers_text
    from photocal.georeferencing.experiment_output import control_plot

    try:
        numbers = [int(part) for part in counts.split(",")]
    except ValueError as refusal:
        raise ConfigurationError(
            f"--control-numbers {counts} is not understood", "give numbers, such as 0,1,3,5"
        ) from refusal
    with progress("adjusting", None) as advance:
        outcome, figures = control_numbers(read_any_block(source), numbers, done=lambda: advance(1))
    if output is not None:
        with output_folder(output) as folder:
            write_json(folder / "control_numbers.json", figures)
            save_figures(folder, {"control_numbers.pdf": control_plot(outcome)})
    return figures, _with_place(numbers_text(figures), output)


def _with_place(text: str, output: Path | None) -> str:
    return text if output is None else f"{text}\nwritten to {output}"


def _interiors(path: Path) -> tuple[Camera, ...]:
    """Calibrations of a file as `photocal compare` reads it."""
    from dataclasses import replace

    import numpy as np

    from photocal.analysis.stability.camera_file import read_camera_file
    from photocal.geometry.camera import PARAMETERS

    cameras = []
    for calibration in read_camera_file(path).calibrations:
        sigma = np.array([calibration.sigma_of(name) or np.inf for name in PARAMETERS])
        cameras.append(
            replace(calibration, prior_sigma=sigma, prior_correlation=calibration.correlation_of(PARAMETERS))
        )
    return tuple(cameras)


def noise_of(text: str, seed: int) -> tuple[Degradation, np.random.Generator]:
    """Read the noise of simulated exposures: metres, degrees."""
    import math

    import numpy as np

    from photocal.georeferencing.methods import Degradation

    position, attitude = numbers_of(text, "--simulate-direct", "METRES,DEGREES: a noise such as 0.08,0.02")
    return Degradation(position, math.radians(attitude)), np.random.default_rng(seed)


def check(
    block: Annotated[
        Path | None,
        argument("Block folder, PROJECT.toml, or a set-up file of another program; its points have roles."),
    ] = None,
    output: Annotated[
        Path | None, option("Folder for tables, figures, GeoPackages and the report.", "-o", "--output")
    ] = None,
    discrepancies: Annotated[
        Path | None,
        option(
            "Instead of a block: CSV with the columns point, correction_E, correction_N, correction_h, "
            "or dE, dN, dh as studies print them (both reference minus product), in metres or with the "
            "unit in the header (dE_cm); optional E, N, h."
        ),
    ] = None,
    experiment: Annotated[
        Path | None, option("Instead of a block: TOML file with interior orientations and control patterns.")
    ] = None,
    points: Annotated[
        Path | None,
        option(
            "Instead of a block: CSV of check points (point, E, N, h) for --ortho and --dtm, in their "
            "reference system."
        ),
    ] = None,
    ortho: Annotated[Path | None, option("Orthomosaic that shows the targets of the check points.")] = None,
    target_diameter: Annotated[float | None, option("Of those round targets, metres.")] = None,
    search_radius: Annotated[float, option("How far from its place a target is looked for, metres.")] = 2.0,
    dtm: Annotated[Path | None, option("Terrain model that is read at the check points.")] = None,
    height_kind: Annotated[
        str | None, option("Of the check points: ellipsoidal, orthometric or local.")
    ] = None,
    dtm_height_kind: Annotated[str | None, option("Of a terrain model that does not say it itself.")] = None,
    standard: Annotated[
        list[str] | None,
        option("decree-89817, pec-pcd, asprs-2024 or a TOML file; may be repeated. Without: all three."),
    ] = None,
    scale: Annotated[str | None, option("Map scale to judge at, such as 1:1000.")] = None,
    interval: Annotated[float | None, option("Contour interval in metres to judge at.")] = None,
    confidence: Annotated[
        float, option("Level of the tests: two-sided for the bias, one-sided for the precision.")
    ] = 0.90,
    survey_horizontal: Annotated[
        float | None, option("Horizontal (radial) RMSE of the survey of the check points, metres.")
    ] = None,
    survey_vertical: Annotated[
        float | None, option("Vertical RMSE of the survey of the check points, metres.")
    ] = None,
    target_horizontal: Annotated[
        float | None, option("Horizontal (radial) RMSE that is asked for, metres.")
    ] = None,
    target_vertical: Annotated[float | None, option("Vertical RMSE that is asked for, metres.")] = None,
    gsd: Annotated[
        float | None,
        option(
            "Ground sampling distance, metres: how many points lie within one and two; a block gives its own."
        ),
    ] = None,
    figures: Annotated[
        Path | None, option("With --discrepancies: folder for residual map and histograms (PDF).")
    ] = None,
    geopackage: Annotated[
        Path | None, option("With --discrepancies: GeoPackage for QGIS, to be written.")
    ] = None,
    crs: Annotated[
        str | None, option("Projected system of E and N for the GeoPackage, such as EPSG:31982.")
    ] = None,
    control_numbers: Annotated[
        str | None, option("How much control is needed: repeat with so many control points, such as 0,1,3,5.")
    ] = None,
    simulate_direct: Annotated[
        str | None,
        option("Noise M,DEG of simulated exposures for direct georeferencing from the adjusted orientation."),
    ] = None,
    seed: Annotated[int, option("Of that noise.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Judge a block or a product at its check points: statistics, tests and accuracy classes.

    A block is georeferenced three ways (direct, integrated, indirect); lever arm, boresight, time and
    datum errors are looked for. Two classes are given side by side: by precision (the bias removed) and
    by accuracy (90 % of the points within PEC and RMSE within the standard error).

    Example: `photocal check field7 -o field7-check --scale 1:1000`
    """
    from photocal.accuracy.standard import SHIPPED, Question, load_standard, parse_scale

    if sum(source is not None for source in (block, discrepancies, experiment, points)) != 1:
        raise ConfigurationError(
            "there must be one thing to check",
            "name a block or project, or --discrepancies, or --experiment, or --points",
        )
    question = Question(
        None if scale is None else parse_scale(scale),
        interval,
        confidence,
        survey_horizontal,
        survey_vertical,
        target_horizontal,
        target_vertical,
        gsd,
    )
    project, names = None, tuple(standard or ())
    if block is not None and block.suffix == ".toml":
        project, question = with_project(block, question)
        block, names = project.output / "block", names or project.contents.judgement.standards
    standards = tuple(load_standard(name) for name in names or SHIPPED)
    folder = figures or output
    if experiment is not None:
        judged = judge_experiment(experiment, output)
    elif control_numbers is not None:
        if block is None:
            raise ConfigurationError("--control-numbers needs a block", "name a block or project")
        judged = judge_numbers(block, control_numbers, output)
    elif block is not None:
        noise = None if simulate_direct is None else noise_of(simulate_direct, seed)
        judged = judge_block(block, output, standards, question, noise, crs, on_the_job=project is not None)
    elif discrepancies is not None:
        from photocal.accuracy.discrepancies import read_discrepancies

        table = read_discrepancies(discrepancies)
        judged = judge_product(table, discrepancies, standards, question, folder, geopackage, crs)
    elif points is not None:
        from photocal.products.product_check import check_products, read_check_points

        product = check_products(
            read_check_points(points),
            ortho=ortho,
            target_diameter_m=target_diameter,
            search_m=search_radius,
            dtm=dtm,
            height_kind=height_kind,
            dtm_height_kind=dtm_height_kind,
        )
        judged = judge_product(product, points, standards, question, folder, geopackage, crs)
    answer(as_json, lambda: judged[0], lambda: judged[1])

"""`photocal check`: a block, a project, an experiment or a product judged at its check points.

`photocal rover-test`: the field test of a GNSS rover, before its control points are used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from photocal.analysis.accuracy.options import JudgementOptions, MapOptions
from photocal.analysis.georeferencing.options import RepetitionOptions
from photocal.base.console import AsJson, Details, Language, answer, argument, numbers_of, option, spread
from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options
from photocal.base.progress import quiet
from photocal.base.progress_bars import one_bar, progress
from photocal.products.options import ProductOptions

if TYPE_CHECKING:
    import numpy as np

    from photocal.analysis.accuracy.discrepancies import Discrepancies
    from photocal.analysis.accuracy.standard import Question, Standard
    from photocal.analysis.georeferencing.methods import Degradation
    from photocal.block.project import Project
    from photocal.findings.texts import Catalogue
    from photocal.geometry.camera import Camera
    from photocal.products.product_check import ProductCheck


@dataclass(frozen=True)
class Told:
    """How the answer is given: in which language, and whether with all details."""

    language: str
    details: bool

    @property
    def say(self) -> Catalogue:
        """Texts for the terminal: of the language asked for, else of the environment."""
        from photocal.findings.texts import catalogue, spoken

        return catalogue(spoken(self.language))

    @property
    def stored(self) -> Catalogue:
        """Texts of files and JSON: English unless a language is asked for."""
        from photocal.findings.texts import catalogue

        return catalogue(self.language or "en")


# Figures as a JSON value, and the same for people.
Judged: TypeAlias = tuple[dict[str, Any], str]


@dataclass(frozen=True, kw_only=True)
class OtherSources(Options):
    """What is checked in place of a block."""

    discrepancies: Annotated[
        Path | None,
        Option(
            "Instead of a block: CSV with the columns point, correction_E, correction_N, correction_h, "
            "or dE, dN, dh as studies print them (both reference minus product), in metres or with the "
            "unit in the header (dE_cm); optional E, N, h."
        ),
    ] = None
    moments: Annotated[
        Path | None,
        Option(
            "Instead of a block: CSV of printed moments: component (E, N, h), n, and mean_m, std_m, or "
            "rmse_m, t (reference minus product); optional set."
        ),
    ] = None
    variance: Annotated[
        Path | None,
        Option(
            "Instead of a block: CSV of an experiment, for the analysis of variance: columns that end in _m "
            "are values, the others factors."
        ),
    ] = None
    experiment: Annotated[
        Path | None, Option("Instead of a block: TOML file with interior orientations and control patterns.")
    ] = None


def judge_product(
    product: Discrepancies | ProductCheck,
    path: Path,
    standards: tuple[Standard, ...],
    question: Question,
    maps: MapOptions,
    told: Told,
) -> Judged:
    """Judge a table of discrepancies, or what an orthomosaic and a terrain model say at the check points."""
    from photocal.analysis.accuracy.assessment import assess
    from photocal.analysis.accuracy.discrepancies import Discrepancies
    from photocal.analysis.accuracy.output import to_json, to_text
    from photocal.base.arrays import as_plain

    more: dict[str, object] = {}
    remarks: tuple[str, ...] = ()
    if not isinstance(product, Discrepancies):
        likeness, remarks = as_plain(product.likeness), product.remarks
        more, product = {"likeness": likeness, "remarks": list(remarks)}, product.discrepancies
    result = assess(product, standards, question)
    if maps.figures is not None:
        from photocal.analysis.accuracy.maps import check_figures, save_figures
        from photocal.base.files import output_folder

        with output_folder(maps.figures) as aside:
            save_figures(aside, check_figures(result.discrepancies, question.gsd_m, told.say))
    if maps.geopackage is not None:
        from photocal.analysis.accuracy.maps import reference_system, write_geopackage
        from photocal.base.geopackage import changed_utc

        system = reference_system(maps.crs)
        write_geopackage(maps.geopackage, (("check", product),), system, changed_utc(path))
    return to_json(result, told.stored) | more, "\n".join([to_text(result, told.say), *remarks])


def judge_moments(path: Path, standards: tuple[Standard, ...], question: Question, say: Catalogue) -> Judged:
    """Judge products of which only moments were printed."""
    from photocal.analysis.accuracy.assessment import assess_moments
    from photocal.analysis.accuracy.output import moments_record, moments_text, read_moments

    made = {name: assess_moments(one, standards, question) for name, one in read_moments(path).items()}
    return moments_record(made), moments_text(made, say)


def judge_variance(path: Path, say: Catalogue) -> Judged:
    """Tell which factors of a printed experiment move its errors."""
    from photocal.analysis.accuracy.variance_analysis import (
        SCHEMA,
        analyse_table,
        variance_record,
        variance_text,
    )

    analysed = analyse_table(path)
    return {"schema": SCHEMA, "variance": variance_record(analysed)}, variance_text(analysed, say)


def judge_block(
    source: Path,
    output: Path | None,
    standards: tuple[Standard, ...],
    question: Question,
    noise: tuple[Degradation, np.random.Generator] | None,
    crs: str | None,
    *,
    on_the_job: bool,
    told: Told,
) -> Judged:
    """Georeference a block three ways and judge it."""
    from photocal.analysis.accuracy.maps import reference_system
    from photocal.analysis.georeferencing.comparison import check_block
    from photocal.analysis.georeferencing.methods import METHODS
    from photocal.analysis.georeferencing.output import to_json, to_text
    from photocal.analysis.georeferencing.prepared import with_shutters
    from photocal.exchange.formats import read_any_block
    from photocal.findings.finding import Finding
    from photocal.findings.texts import finding_json, finding_text, plain
    from photocal.findings.verdict import verdict_json
    from photocal.run.stage import is_stage
    from photocal.run.summary import outdated, project_verdict

    read = read_any_block(source)
    # Known beforehand only where it is needed: a wrong frame is better explained by the check itself.
    system = reference_system(crs) if crs else None
    with progress("checking", len(METHODS) + 2) as advance:
        # A flight is its own calibration; a block folder states what it wants to be judged with.
        read = with_shutters(read)
        result = check_block(read, standards, question, noise, lambda _: advance(1), on_the_job=on_the_job)
    content = to_json(result, told.stored)
    # A project has one verdict, however its block is named: that over all its stages.
    of_project = on_the_job or is_stage(source)
    final = project_verdict(source.parent) if of_project else None
    text = to_text(result, final, told.say, details=told.details)
    if final is not None:
        content["verdict"] = verdict_json(final, told.stored)
    elif of_project and outdated(source.parent):
        note = Finding("certificate-outdated", "note")
        content["findings"].append(finding_json(note, told.stored))
        text += f"\n{finding_text(note, told.say, plain)}"
    if output is not None:
        from photocal.analysis.georeferencing.output import draw_check, write_check
        from photocal.base.geopackage import changed_utc

        system = system or reference_system(None if read.frame == "local" else read.frame)
        write_check(result, content, output, system, changed_utc(source), final, told.stored)
        draw_check(result, output, told.stored)
    return content, _with_place(text, output, told)


def with_project(path: Path, question: Question) -> tuple[Project, Question]:
    """Bring the block of a project up to date; what the command line does not ask, the project does."""
    import datetime as dt

    from photocal.block.project import read_project
    from photocal.run.campaign import run_project
    from photocal.run.georeferencing import question_of

    project = read_project(path)
    run_project(project, dt.datetime.now().astimezone().date(), quiet, until="block", bar=one_bar())
    asked = {name: value for name, value in vars(question).items() if value is not None}
    return project, replace(question_of(project), **asked)


def judge_experiment(path: Path, output: Path | None, told: Told) -> Judged:
    """Run an experiment with interior orientations and control patterns."""
    from photocal.analysis.georeferencing.experiment import read_experiment, run_experiment
    from photocal.analysis.georeferencing.experiment_output import to_json, to_text, write_experiment
    from photocal.exchange.formats import read_any_block

    asked = read_experiment(path, read_any_block, _interiors)
    with progress("running", None) as advance:
        outcome = run_experiment(asked, lambda: advance(1))
    if output is not None:
        write_experiment(outcome, output)
    return to_json(outcome), _with_place(to_text(outcome, told.say), output, told)


def judge_numbers(source: Path, counts: str, output: Path | None, told: Told) -> Judged:
    """Repeat the adjustment with several numbers of control points."""
    from photocal.analysis.accuracy.maps import save_figures
    from photocal.analysis.georeferencing.experiment import control_numbers, numbers_text
    from photocal.analysis.georeferencing.experiment_output import control_plot
    from photocal.base.files import output_folder, write_json
    from photocal.exchange.formats import read_any_block

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
    return figures, _with_place(numbers_text(figures, told.say), output, told)


def _with_place(text: str, output: Path | None, told: Told) -> str:
    return text if output is None else f"{text}\n{told.say('shown.written', place=output)}"


def _interiors(path: Path) -> tuple[Camera, ...]:
    """Calibrations of a file as `photocal compare` reads it."""
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


@spread
def check(
    block: Annotated[
        Path | None,
        argument(
            "Block folder, PROJECT.toml, or a set-up file of another program; its points have roles.",
            metavar="BLOCK",
        ),
    ] = None,
    output: Annotated[
        Path | None, option("Folder for tables, figures, GeoPackages and the report.", "-o", "--output")
    ] = None,
    *,
    other: OtherSources,
    product: ProductOptions,
    judgement: JudgementOptions,
    maps: MapOptions,
    repetition: RepetitionOptions,
    language: Language = "",
    details: Details = False,
    as_json: AsJson = False,
) -> None:
    """Judge a block or a product at its check points: statistics, tests and accuracy classes.

    A block is georeferenced three ways (direct, integrated, indirect); lever arm, boresight, time and
    datum errors are tested. Two classes are given side by side: by precision (the bias removed) and
    by accuracy (90 % of the points within PEC and RMSE within the standard error).

    Example: `photocal check field7 -o field7-check --scale 1:1000`
    """
    sources = (block, *vars(other).values(), product.points)
    if sum(source is not None for source in sources) != 1:
        raise ConfigurationError(
            "there must be one thing to check",
            "name a block or project, or --discrepancies, --moments, --variance, --experiment or --points",
        )
    # What is wrong with them is said before anything is computed.
    question, standards, told = judgement.question(), judgement.standards(), Told(language, details)
    at = replace(maps, figures=maps.figures or output)
    if other.experiment is not None:
        judged = judge_experiment(other.experiment, output, told)
    elif block is not None:
        judged = _of_block(block, output, judgement, maps, repetition, told)
    elif repetition.control_numbers is not None:
        raise ConfigurationError("--control-numbers needs a block", "name a block or project")
    elif other.moments is not None:
        judged = judge_moments(other.moments, standards, question, told.say)
    elif other.variance is not None:
        judged = judge_variance(other.variance, told.say)
    elif other.discrepancies is not None:
        from photocal.analysis.accuracy.discrepancies import read_discrepancies

        table = read_discrepancies(other.discrepancies)
        judged = judge_product(table, other.discrepancies, standards, question, at, told)
    elif product.points is not None:
        from photocal.products.product_check import check_products, read_check_points

        found = check_products(read_check_points(product.points), product)
        judged = judge_product(found, product.points, standards, question, at, told)
    answer(as_json, lambda: judged[0], lambda: judged[1])


def _of_block(
    block: Path,
    output: Path | None,
    judgement: JudgementOptions,
    maps: MapOptions,
    repetition: RepetitionOptions,
    told: Told,
) -> Judged:
    from photocal.block.project import is_project

    question, on_the_job = judgement.question(), is_project(block)
    if on_the_job:
        project, question = with_project(block, question)
        block = project.output / "block"
        named = judgement.standard or project.contents.judgement.standards
        judgement = replace(judgement, standard=tuple(named))
    standards = judgement.standards()
    if repetition.control_numbers is not None:
        return judge_numbers(block, repetition.control_numbers, output, told)
    noise = repetition.noise()
    return judge_block(block, output, standards, question, noise, maps.crs, on_the_job=on_the_job, told=told)


def rover_test(
    sets: Annotated[
        Path, argument("CSV of the measured sets: series, set, point, E, N, h (m).", metavar="SETS.csv")
    ],
    distance: Annotated[float, option("Known horizontal distance of both rover points, m.")],
    height_difference: Annotated[float, option("Known height of the second point over the first, m.")],
    sigma: Annotated[str, option("Stated standard deviations of the rover: PLANE,HEIGHT, m.")],
    earlier: Annotated[str, option("Standard deviations of an earlier full test: PLANE,HEIGHT, m.")] = "",
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Test a GNSS rover (RTK) in the field by ISO 17123-8, simplified or full.

    One series of five sets makes the simplified test, three series the full one: standard deviations in plane
    and height, compared with the stated ones (chi-squared) and an earlier test (F). `photocal forms --kinds
    rover` prints the sheet.

    Example: `photocal rover-test sets.csv --distance 12.345 --height-difference 0.214 --sigma 0.010,0.015`
    """
    from photocal.analysis.accuracy import rover_test as test
    from photocal.findings.texts import catalogue, spoken

    form = "PLANE,HEIGHT: metres, such as 0.010,0.015"
    plane, height = numbers_of(sigma, "--sigma", form)
    before = None
    if earlier:
        plane_before, height_before = numbers_of(earlier, "--earlier", form)
        before = plane_before, height_before
    made = test.rover_test(test.read_sets(sets), distance, height_difference, plane, height, before)
    answer(as_json, lambda: made, lambda: test.as_text(made, catalogue(spoken(language))))

"""`photocal adjust`, `analyse`, `certificate`: a block adjusted, its calibration judged, and certified.

`photocal forms`: sheets to print for the field and the laboratory.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import typer

from photocal.analysis.options import AnalysisOptions, PublishedOptions
from photocal.base.console import (
    Answering,
    AsJson,
    Details,
    Language,
    answer,
    argument,
    option,
    printable,
    spread,
)
from photocal.base.errors import ConfigurationError
from photocal.base.progress_bars import progress
from photocal.block.options import PartsOptions, Wanted
from photocal.report.options import CertificateOptions


@spread
def adjust(
    block: Annotated[
        Path,
        argument(
            "Block folder (block.toml, images.csv, points.csv, observations.csv), or a set-up file of "
            "another program (docs/exchange.md lists them).",
            metavar="BLOCK",
        ),
    ],
    output: Annotated[Path, option("Folder for the results.", "-o", "--output")],
    snoop: Annotated[
        str, option("Search for gross errors: `w` (a priori sigmas) or `tau` (a posteriori).")
    ] = "",
    *,
    wanted: Wanted,
    apart: PartsOptions,
    answering: Answering,
) -> None:
    """Adjust a block: camera, orientations and points with their complete statistics.

    Example: `photocal adjust my-block -o run`
    """
    from photocal.base.compiled import compile_ahead
    from photocal.block.results.adjusted import adjust_block
    from photocal.block.results.folder import result_json
    from photocal.block.results.in_parts import adjust_block_in_parts
    from photocal.exchange.formats import read_any_block
    from photocal.findings.texts import catalogue, spoken

    if snoop not in ("", "w", "tau"):
        raise ConfigurationError(f"--snoop {snoop} is not known", "use w or tau")
    test = cast("Literal['w', 'tau'] | None", snoop or None)
    if apart.parts and (test or wanted != Wanted()):
        raise ConfigurationError(
            "--parts goes with no other figures than the usual ones",
            "leave out --snoop, --ellipses, --reliability, --components and --joint, or --parts",
        )
    compile_ahead()
    lines = iteration_lines("adjusting")
    if apart.parts:
        result = adjust_block_in_parts(block, output, apart, lines, read_any_block)
    else:
        result = adjust_block(block, output, test, lines, wanted, read_any_block)
    say = catalogue(spoken(answering.language))
    written = say("result.written", place=output)
    answer(answering.as_json, lambda: result_json(result), lambda: f"{result.text(say)}\n{written}")


def iteration_lines(title: str) -> Callable[[Any], None]:
    """Show each iteration on standard error when a person watches and it takes more than a second."""
    began = time.monotonic()

    def line(iteration: Any) -> None:
        """Write one iteration, when a person watches and it takes long."""
        if sys.stderr.isatty() and time.monotonic() - began > 1.0:
            sys.stderr.write(
                f"{title}: iteration {iteration.number}, chi-squared {iteration.chi_squared:.6g}, "
                f"step {iteration.decrement**0.5:.2g} sigma\n"
            )

    return line


@spread
def analyse(
    run: Annotated[
        Path,
        argument(
            "Folder that `photocal adjust` wrote; a block that it refused; or a CSV of published parameters.",
            metavar="RUN",
        ),
    ],
    analysis: AnalysisOptions,
    published: PublishedOptions,
    language: Language = "",
    *,
    details: Details = False,
    as_json: AsJson = False,
) -> None:
    """Analyse a calibration: a verdict, hidden errors worst first, significance, correlations, method.

    The block of the run is adjusted again, with one change at a time. It is searched for at its recorded
    place, next to the run and below the current folder, and recognised by its hashes. The result is also
    written into the run as analysis.json, which `photocal certificate` reads.

    For a block folder, or with --block for a run without a result, only the verdict is given: it names the
    control points with which the adjustment does not converge.

    A CSV with the columns parameter, value and std_dev (perhaps set), as publications and other programs
    print them, is tested directly. With its correlations or covariance (--matrix), or for such a matrix
    alone, strong correlations and principal components are given, too.

    Example: `photocal adjust my-block -o run && photocal analyse run`, or
    `photocal analyse iop.csv --matrix correlations.csv --degrees-of-freedom 2470`
    """
    from photocal.analysis.analyse_run import analyse_block, analyse_run, analysis_record
    from photocal.block.results.folder import RESULT
    from photocal.exchange.formats import read_any_block
    from photocal.findings.document import text
    from photocal.findings.texts import catalogue, spoken
    from photocal.findings.verdict import judge, verdict_json, verdict_section
    from photocal.report.analysis_sections import analysed, calibrated
    from photocal.report.analysis_sections import published as of_published
    from photocal.report.certificate import overall
    from photocal.report.stored_analysis import read_run
    from photocal.run.summary import stage_findings

    # What is stored and scripted stays as it is wherever it is made.
    say, stored = catalogue(spoken(language)), catalogue(language or "en")
    if run.is_file():
        from photocal.analysis.published import analyse_published, published_record

        beside = published.matrix, published.set_name, published.degrees_of_freedom
        sets = analyse_published(run, *beside, analysis.alpha, analysis.correlation)
        answer(
            as_json,
            lambda: published_record(sets),
            lambda: text(of_published(sets, analysis.correlation, say)),
        )
        return
    levels = analysis.alpha, analysis.correlation
    source = analysis.block or (run if (run / "block.toml").is_file() else None)
    if source is not None and not (run / RESULT).is_file():
        if source != run:
            typer.echo(printable(say("analysis.without_run", run=run, block=source)), err=True)
        block = read_any_block(source)
        with progress("adjusting again", 1.0) as advance:
            outcome = analyse_block(block, None, *levels, advance, analysis.bootstrap)
        placed, estimated = block.datum != "free", any(camera.free for camera in block.cameras)
        images = len(block.images.names)
        found = judge(outcome.findings, images, placed=placed, calibrated=estimated)
        answer(
            as_json,
            lambda: {**analysis_record(outcome, stored), "verdict": verdict_json(found, stored)},
            lambda: text([verdict_section(found, say)]),
        )
        return
    with progress("adjusting again", 1.0) as advance:
        outcome = analyse_run(
            run, analysis.block, *levels, advance, stored, analysis.bootstrap, read_any_block
        )
    made = read_run(run)
    given = overall(made, (), stage_findings(run))
    answer(
        as_json,
        lambda: {**analysis_record(outcome, stored), "verdict": verdict_json(given, stored)},
        lambda: text([verdict_section(given, say), *(analysed if details else calibrated)(made, say)]),
    )


@spread
def certificate(
    run: Annotated[Path, argument("Folder that `photocal adjust` wrote.", metavar="RUN")],
    output: Annotated[Path, option("Folder for the certificate.", "-o", "--output")],
    *,
    options: CertificateOptions,
    as_json: Annotated[bool, option("Print what was written as JSON.", "--json")] = False,
) -> None:
    """Write the certificate of a calibration: HTML page, PDF and JSON.

    Example: `photocal certificate run -o certificate --block block --language pt-BR`
    """
    from dataclasses import replace

    from photocal.findings.texts import spoken
    from photocal.run.certify import certificate as certified

    made = certified(run, output, options=replace(options, language=spoken(options.language)))
    answer(
        as_json,
        lambda: {
            "number": made.document.number,
            "files": [str(path) for path in made.files],
            "highlights": {item.label: item.value for item in made.document.highlights},
        },
        lambda: str(made),
    )


def forms(
    output: Annotated[Path, option("PDF to write.", "-o", "--output")],
    kinds: Annotated[str, option("station, flight, targets, laboratory, rover, separated by commas.")] = (
        "station,flight,targets"
    ),
    plan: Annotated[
        Path | None, option("plan.geojson of `photocal plan`: a station sheet for each of its points.")
    ] = None,
    stations: Annotated[
        int, option("Number of camera stations in front of a test field.", min=1, max=20)
    ] = 3,
    language: Language = "",
    as_json: Annotated[bool, option("Print what was written as JSON.", "--json")] = False,
) -> None:
    """Write sheets to print: GNSS stations, flight log, targets, laboratory, test of a rover.

    Example: `photocal forms -o forms.pdf --plan plan/plan.geojson --language pt-BR`
    """
    import datetime as dt

    from photocal.base.files import write_pdf
    from photocal.findings.document import pdf
    from photocal.findings.texts import catalogue, spoken
    from photocal.report.ministry_rows import field_forms, planned_places

    places = () if plan is None else planned_places(plan)
    names = [name.strip() for name in kinds.split(",") if name.strip()]
    say = catalogue(spoken(language))
    document = field_forms(names, places, say, stations)
    content = pdf(document, dt.datetime.now().astimezone().date())
    write_pdf(output, content)
    titles = [section.title for section in document.sections]
    answer(
        as_json,
        lambda: {"file": str(output), "sheets": titles},
        lambda: "\n".join([*titles, say("shown.written", place=output)]),
    )

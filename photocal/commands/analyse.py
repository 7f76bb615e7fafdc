"""`photocal analyse`: what a calibration is worth and what it has hidden."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from photocal.commands.options import AsJson, argument, option


def analyse(
    run: Annotated[
        Path,
        argument("Folder that `photocal adjust` wrote; or a CSV of published parameters or correlations."),
    ],
    block: Annotated[
        Path | None, option("Block folder of the run, or its set-up file, when it is not found.")
    ] = None,
    alpha: Annotated[float, option("Level of the significance tests.", min=1e-4, max=0.5)] = 0.10,
    correlation: Annotated[float, option("Correlations from here on are named.", min=0.0, max=1.0)] = 0.8,
    bootstrap: Annotated[
        int,
        option("Adjust so many blocks of images drawn with replacement; 100 tell enough.", min=0, max=10_000),
    ] = 0,
    matrix: Annotated[
        Path | None, option("CSV of the correlations or the covariance of published parameters.")
    ] = None,
    set_name: Annotated[
        str | None, option("Set of a published table; without, all of them.", "--set")
    ] = None,
    degrees_of_freedom: Annotated[float, option("Redundancy behind published parameters.", min=1.0)] = float(
        "inf"
    ),
    language: Annotated[str, option("Language: en or pt-BR.")] = "en",
    as_json: AsJson = False,
) -> None:
    """Analyse a calibration: hidden errors worst first, significance, correlations, method.

    The block of the run is adjusted again, with one thing changed at a time. It is looked for where the run
    says, beside the run and below the current folder, and recognised by its hashes. The answer is also
    written as analysis.json into the run, from where `photocal certificate` takes it.

    A CSV with the columns parameter, value and std_dev (perhaps set), as publications and other programs
    print them, is tested as it stands; with its correlations or covariance (--matrix), or of such a matrix
    alone, strong correlations and principal components follow, too.

    Example: `photocal adjust my-block -o run && photocal analyse run`, or
    `photocal analyse iop.csv --matrix correlations.csv --degrees-of-freedom 2470`
    """
    from acquire.console import answer, progress
    from photocal.findings.catalogue import catalogue
    from photocal.report.analysis_record import analyse_run, analysis_record
    from photocal.report.analysis_text import analysis_text

    say = catalogue(language)
    if run.is_file():
        from photocal.analysis.published import analyse_published
        from photocal.report.analysis_text import published_record, published_text

        sets = analyse_published(run, matrix, set_name, degrees_of_freedom, alpha, correlation)
        answer(as_json, lambda: published_record(sets), lambda: published_text(sets, say))
        return
    with progress("adjusting again", 1.0) as advance:
        outcome = analyse_run(run, block, alpha, correlation, advance, say, bootstrap)
    answer(as_json, lambda: analysis_record(outcome, say), lambda: analysis_text(outcome, say))

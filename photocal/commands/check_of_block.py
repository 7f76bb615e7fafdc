"""`photocal check` of blocks, projects and experiments."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from acquire.console import answer, numbers_of, progress
from drivers.errors import ConfigurationError

if TYPE_CHECKING:
    import numpy as np

    from photocal.accuracy.discrepancies import Discrepancies
    from photocal.accuracy.standard import Question, Standard
    from photocal.geometry.camera import Camera
    from photocal.georeferencing.simulated import Degradation
    from photocal.products.product_check import ProductCheck
    from photocal.project import Project


def judge_product(
    found: Discrepancies | ProductCheck,
    path: Path,
    standards: tuple[Standard, ...],
    question: Question,
    figures: Path | None,
    geopackage: Path | None,
    crs: str | None,
    *,
    as_json: bool,
) -> None:
    """Judge a table of discrepancies, or what an orthomosaic and a terrain model say at the check points."""
    from photocal.accuracy.as_json import finite, to_json
    from photocal.accuracy.as_text import to_text
    from photocal.accuracy.assessment import assess
    from photocal.accuracy.discrepancies import Discrepancies

    more: dict[str, object] = {}
    remarks: tuple[str, ...] = ()
    if not isinstance(found, Discrepancies):
        likeness, remarks = [finite(v) for v in found.likeness.tolist()], found.remarks
        more, found = {"likeness": likeness, "remarks": list(remarks)}, found.discrepancies
    result = assess(found, standards, question)
    _files(result.discrepancies, path, figures, geopackage, crs)
    answer(as_json, lambda: to_json(result) | more, lambda: "\n".join([to_text(result), *remarks]))


def _files(
    found: Discrepancies, path: Path, figures: Path | None, geopackage: Path | None, crs: str | None
) -> None:
    """Residual map, histograms and GeoPackage of a product, where they are asked for."""
    if figures is not None:
        from photocal.accuracy.figures import write_figures

        write_figures(found, figures)
    if geopackage is not None:
        from photocal.accuracy.geopackage import reference_system, write_geopackage

        write_geopackage(geopackage, (("check", found),), reference_system(crs), changed_utc(path))


def changed_utc(source: Path) -> str:
    """Time of the input, not of the clock: the same input gives the same file."""
    from datetime import UTC, datetime

    table = source / "points.csv" if source.is_dir() else source
    changed = datetime.fromtimestamp(table.stat().st_mtime, UTC)
    return f"{changed:%Y-%m-%dT%H:%M:%S}.000Z"


def judge_block(
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
    """Georeference a block three ways, judge it and answer."""
    from photocal.accuracy.geopackage import reference_system
    from photocal.exchange.formats import read_any_block
    from photocal.findings.catalogue import catalogue
    from photocal.findings.texts import finding_json
    from photocal.georeferencing.as_json import to_json
    from photocal.georeferencing.as_text import to_text
    from photocal.georeferencing.comparison import check_block
    from photocal.georeferencing.methods import METHODS, with_shutters
    from photocal.run.georeferencing import own_calibration
    from photocal.run.stage import is_stage
    from photocal.run.warnings import project_verdict

    read = read_any_block(source)
    # Known beforehand only where it is needed: a wrong frame is better explained by the check itself.
    system = reference_system(crs) if crs else None
    with progress("checking", len(METHODS) + 2) as advance:
        # A flight is its own calibration; a block folder states what it wants to be judged with.
        read = with_shutters(read)
        calibration = own_calibration(read) if on_the_job else None
        result = check_block(read, standards, question, noise, lambda _: advance(1), calibration)
    content, text = to_json(result), to_text(result)
    # A project has one verdict, however its block is named: that over all its stages.
    final = project_verdict(source.parent) if on_the_job or is_stage(source) else None
    if final is not None:
        own, content["verdict"] = content["verdict"]["text"], finding_json(final, catalogue("en"))
        text = text.replace(own, content["verdict"]["text"])
    if output is not None:
        from photocal.georeferencing.output import write_check

        system = system or reference_system(None if read.frame == "local" else read.frame)
        write_check(result, content, output, system, changed_utc(source))
    said = "" if output is None else f"\nwritten to {output}"
    answer(as_json, lambda: content, lambda: text + said)


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


def judge_experiment(path: Path, output: Path | None, *, as_json: bool) -> None:
    """Run an experiment with interior orientations and control patterns, and answer."""
    from photocal.exchange.formats import read_any_block
    from photocal.georeferencing.experiment import run_experiment
    from photocal.georeferencing.experiment_file import read_experiment
    from photocal.georeferencing.experiment_output import to_json, to_text, write_experiment

    asked = read_experiment(path, read_any_block, _interiors)
    with progress("running", None) as advance:
        outcome = run_experiment(asked, lambda: advance(1))
    if output is not None:
        write_experiment(outcome, output)
    said = "" if output is None else f"\nwritten to {output}"
    answer(as_json, lambda: to_json(outcome), lambda: to_text(outcome) + said)


def judge_numbers(source: Path, counts: str, output: Path | None, *, as_json: bool) -> None:
    """Repeat the adjustment with several numbers of control points, and answer."""
    import json

    from acquire.outputs import output_folder
    from photocal.exchange.formats import read_any_block
    from photocal.georeferencing.control_numbers import control_numbers, numbers_text
    from photocal.georeferencing.experiment_plots import control_plot

    try:
        numbers = [int(part) for part in counts.split(",")]
    except ValueError as refusal:
        raise ConfigurationError(
            f"--control-numbers {counts} is not understood", remedy="give numbers, such as 0,1,3,5"
        ) from refusal
    with progress("adjusting", None) as advance:
        outcome, figures = control_numbers(read_any_block(source), numbers, done=lambda: advance(1))
    if output is not None:
        with output_folder(output) as folder:
            (folder / "control_numbers.json").write_text(
                json.dumps(figures, indent=1) + "\n", encoding="utf-8"
            )
            plot = control_plot(outcome)
            if plot is not None:
                plot.savefig(folder / "control_numbers.pdf")
    said = "" if output is None else f"\nwritten to {output}"
    answer(as_json, lambda: figures, lambda: numbers_text(figures) + said)


def _interiors(path: Path) -> tuple[Camera, ...]:
    """Calibrations of a file as `photocal compare` reads it."""
    from dataclasses import replace

    import numpy as np

    from photocal.analysis.stability.camera_file import read_camera_file
    from photocal.geometry.camera import PARAMETERS

    cameras = []
    for one in read_camera_file(path).calibrations:
        sigma, correlation = np.full(len(PARAMETERS), np.inf), np.eye(len(PARAMETERS))
        if one.uncertainty is not None:
            at = [PARAMETERS.index(name) for name in one.uncertainty.names]
            sigma[at] = one.uncertainty.sigmas
            correlation[np.ix_(at, at)] = one.uncertainty.correlation
        cameras.append(replace(one.camera, id=one.id, prior_sigma=sigma, prior_correlation=correlation))
    return tuple(cameras)


def noise_of(text: str, seed: int) -> tuple[Degradation, np.random.Generator]:
    """Read the noise of simulated exposures: metres, degrees."""
    import math

    import numpy as np

    from photocal.georeferencing.simulated import Degradation

    position, attitude = numbers_of(text, "--simulate-direct", "METRES,DEGREES: a noise such as 0.08,0.02")
    return Degradation(position, math.radians(attitude)), np.random.default_rng(seed)

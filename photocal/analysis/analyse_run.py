"""The analysis of a run, made and written for programs as `analysis.json`, by `photocal analyse`."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.analysis.correlation import ExteriorCorrelation, StrongCorrelation
from photocal.analysis.georeferencing.causes import slips_of
from photocal.analysis.georeferencing.comparison import exposure_difference
from photocal.analysis.georeferencing.direct import direct_orientation
from photocal.analysis.georeferencing.prepared import in_local_frame
from photocal.analysis.left_out import Checks
from photocal.analysis.outcome import (
    ANALYSIS,
    Analysis,
    ExteriorDifference,
    Outcome,
    analyse_adjusted,
    analyse_network,
)
from photocal.analysis.searched_block import SearchedBlock
from photocal.analysis.shutters import shutter_findings
from photocal.base.arrays import as_plain
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.files import digest, output_file, write_json
from photocal.base.policy import policy
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import NetworkOfBlock, assemble, block_frame
from photocal.block.results.adjusted import adjustment_of, known_adjustment, network_of, state_of
from photocal.block.results.folder import RESULT, block_of_run, read_result
from photocal.block.results.result import Result
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_text, need_words, plain
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import angles_from_matrix


def analysis_record(analysis: Analysis, say: Catalogue) -> dict[str, Any]:
    """Turn an analysis into plain values, ready for JSON, with words beside its codes."""
    values = {field.name: getattr(analysis, field.name) for field in fields(Analysis)}
    content: dict[str, Any] = as_plain(values, lambda part: _words(part, say))
    return content


def _words(part: object, say: Catalogue) -> dict[str, Any]:
    """Give the texts for the code of a correlation, a requirement or a finding, as since schema 1."""
    if isinstance(part, StrongCorrelation | ExteriorCorrelation):
        return {"words": say(f"cause.{part.cause}")}
    if not isinstance(part, Finding):
        return {}
    if f"requirement.{part.code}.name" in say.messages:
        return {"met": part.severity == "passed", **need_words(part.code, part.figures, say)}
    size, text = {} if part.size is None else asdict(part.size), finding_text(part, say, plain)
    return {
        "text": text,
        "kind": part.code,
        "sentence": text,
        "small": part.small,
        **{key: as_plain(size.get(key)) for key in ("figure", "sigma", "unit")},
        **{f"effect_{key}": as_plain(size.get(key)) for key in ("c", "ground_m", "px")},
    }


def analyse_run(
    folder: Path,
    block: Path | None = None,
    alpha: float = policy.parameter_significance,
    threshold: float = policy.strong_correlation,
    done: Callable[[float], None] = lambda _: None,
    say: Catalogue | None = None,
    draws: int = 0,
    read: Callable[[Path], Block] = read_block,
) -> Outcome:
    """Analyse a run and write `analysis.json` into its folder: it then goes into the certificate.

    block: block folder or set-up file; looked for where the run says, beside it and below the current folder
        when not given.
    draws: of the bootstrap over images.
    read: how a block is read; a run of a project hands on the one that it has.
    done: gets the share of the work that was done since it was called last.

    raises PhotocalError: as reading, adjusting and writing do.
    """
    result = read_result(folder)
    source = block_of_run(folder, result, block, Path.cwd())
    given = read(source.path)
    outcome = analyse_block(given, result, alpha, threshold, done, draws)
    return write_analysis(folder, outcome, given, result, say)


def write_analysis(
    folder: Path, outcome: Outcome, block: Block, result: Result, say: Catalogue | None = None
) -> Outcome:
    """Write the analysis of a block's result into the folder of this, and give it as it is written."""
    difference = exterior_difference(block, result)
    outcome = replace(outcome, exterior_difference=difference, result_sha256=digest(folder / RESULT))
    with output_file(folder / ANALYSIS) as aside:
        write_json(aside, analysis_record(outcome, say or catalogue("en")))
    return outcome


def analyse_block(
    block: Block,
    result: Result | None = None,
    alpha: float = policy.parameter_significance,
    threshold: float = policy.strong_correlation,
    done: Callable[[float], None] = lambda _: None,
    draws: int = 0,
) -> Outcome:
    """Analyse a block, also one that no adjustment ends with where its control alone hinders that.

    result: its adjustment, from which the analysis starts; without, it is adjusted first.
    raises IllPosedError, NotConvergedError: when something else than control hinders it.
    """
    # Shutters, lags and what was rejected are those that an adjustment ends with.
    adjusted = None if result is None else known_adjustment(block, result)
    if result is None:
        with suppress(IllPosedError, NotConvergedError):
            adjusted = adjustment_of(block)
    if adjusted is not None:
        return analyse_searched(SearchedBlock(adjusted), alpha, threshold, done, draws)
    assembly = assemble(block) if result is None else network_of(block, result)
    checks, start = checks_of(block, assembly), None if result is None else state_of(assembly, result)
    slips = slips_of(block, assembly)
    outcome = analyse_network(assembly.network, checks, alpha, threshold, done, draws, start, slips)
    return outcome if result is None else with_shutters_told(outcome, result)


def analyse_searched(
    searched: SearchedBlock,
    alpha: float = policy.parameter_significance,
    threshold: float = policy.strong_correlation,
    done: Callable[[float], None] = lambda _: None,
    draws: int = 0,
) -> Outcome:
    """Analyse an adjusted block with the causes that were looked for in it; see `analyse_block`."""
    block, assembly = searched.adjusted.block, searched.adjusted.assembly
    checks, slips = checks_of(block, assembly), slips_of(block, assembly)
    outcome = analyse_adjusted(searched.causes, checks, alpha, threshold, done, draws, slips)
    return with_shutters_told(outcome, searched.adjusted.result)


def with_shutters_told(outcome: Outcome, result: Result) -> Outcome:
    """Give an analysis with what the adjustment found of shutters, behind all hidden errors."""
    told = shutter_findings(result.cameras, result.readouts)
    return replace(outcome, findings=(*outcome.findings, *told))


def checks_of(block: Block, assembly: NetworkOfBlock) -> Checks:
    """Surveyed coordinates of the check points in the frame of the network."""
    check = np.flatnonzero(block.points.of_role("check")[assembly.points])
    return Checks(check, assembly.frame.to_local(block.points.values[assembly.points[check]]))


def exterior_difference(block: Block, result: Result) -> ExteriorDifference | None:
    """Compare the orientations that the positioning system gave with the adjusted ones."""
    original = direct_orientation(in_local_frame(block))
    if not original.known.any():
        return None
    adjusted = result.images.values
    if block.frame != "local":
        adjusted = local_poses(block_frame(block), adjusted)
    given = np.hstack([angles_from_matrix(original.rotation), original.centre])
    given[~original.known] = np.nan
    images, mean, rmse = exposure_difference(given, adjusted)
    turns = (np.degrees(part[:3]) * 3600.0 for part in (mean, rmse))
    figures = (mean[3:], rmse[3:], *turns)
    return ExteriorDifference(images, *(tuple(part.tolist()) for part in figures))

"""The analysis of a run, made and written for programs as `analysis.json`, by `photocal analyse`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from acquire.outputs import output_file, write_json
from drivers.arrays import as_plain
from photocal.analysis.method import MethodCheck
from photocal.analysis.outcome import CameraAnalysis, Outcome, analyse_network
from photocal.analysis.robust import Robust
from photocal.analysis.systematic_errors.refit import Checks
from photocal.analysis.systematic_errors.search import Search
from photocal.block.model import Block, digest
from photocal.block.network import NetworkOfBlock, block_frame
from photocal.exchange.formats import read_any_block
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json, finding_text, need_words, plain
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import angles_from_matrix
from photocal.georeferencing.direct import direct_orientation
from photocal.georeferencing.local import in_local_frame
from photocal.report.stored_analysis import ANALYSIS, SCHEMA, ExteriorDifference
from photocal.results.adjusted import network_of, state_of
from photocal.results.folder import RESULT, read_result
from photocal.results.origin import block_of_run
from photocal.results.result import Result


def analysis_record(outcome: Outcome, say: Catalogue) -> dict[str, Any]:
    """Turn an analysis into plain values, ready for JSON."""
    search = outcome.search
    names = [camera.id for camera in search.first.network.cameras]
    return {
        "schema": SCHEMA,
        "findings": [finding_record(one, say) for one in outcome.findings],
        "variance_factor": as_plain(search.first.solution.variance_factor),
        "alpha": outcome.alpha,
        "correlation_threshold": outcome.threshold,
        "cameras": {
            name: None if one is None else _camera(one, say)
            for name, one in zip(names, outcome.cameras, strict=True)
        },
        "lens_models": {name: as_plain(fits) for name, fits in zip(names, outcome.lenses, strict=True)},
        "observation_sigma": as_plain(search.sigma),
        "groups": as_plain(search.groups),
        "variance_components": {
            "images": as_plain(search.images),
            "axes": as_plain(search.axes),
            "cameras": as_plain(search.cameras),
        },
        "image_shifts": as_plain(search.shifts),
        "residual_maps": {name: as_plain(cells) for name, cells in zip(names, search.maps, strict=True)},
        "jackknife": _jackknife(search, outcome.robust, names),
        "bootstrap_draws": outcome.robust.draws,
        "network": as_plain(outcome.shape),
        "methods": [_method(one, say) for one in outcome.methods],
    }


def finding_record(finding: Finding, say: Catalogue) -> dict[str, Any]:
    """A finding as JSON value, with what schema 1 calls its figures beside."""
    size = {} if finding.size is None else asdict(finding.size)
    return {
        **finding_json(finding, say),
        "kind": finding.code,
        "sentence": finding_text(finding, say, plain),
        "small": finding.small,
        **{key: as_plain(size.get(key)) for key in ("figure", "sigma", "unit")},
        **{f"effect_{key}": as_plain(size.get(key)) for key in ("c", "ground_m", "px")},
    }


def _camera(one: CameraAnalysis, say: Catalogue) -> dict[str, Any]:
    proposal = one.proposal
    return {
        "variance_factor_of_tests": one.variance_factor,
        "significance": as_plain(one.tests),
        "effects": as_plain(one.effects),
        "correlations": [
            {**as_plain(pair), "words": say(f"cause.{pair.cause}")} for pair in one.correlations
        ],
        "correlations_with_exterior": [
            {**as_plain(pair), "words": say(f"cause.{pair.cause}")} for pair in one.exterior
        ],
        "components": {
            "steps": as_plain(proposal.steps),
            "final": as_plain(proposal.final),
            "removed": list(proposal.removed),
            "kept": list(proposal.kept),
            "recommended": list(proposal.recommended),
            "proposal": [finding_text(remark, say, plain) for remark in proposal.findings],
            "remarks": [finding_record(remark, say) for remark in proposal.findings],
        },
        "left_out": as_plain(one.left_out),
        "within_flight": as_plain(one.within),
    }


def _method(one: MethodCheck, say: Catalogue) -> dict[str, Any]:
    """A method with its requirements, in codes and in words."""
    return {
        "method": one.method,
        "met": one.met,
        "requirements": [
            {
                "code": need.code,
                "severity": need.severity,
                "met": need.severity == "passed",
                "figures": dict(need.figures),
                **need_words(need.code, need.figures, say),
            }
            for need in one.requirements
        ],
    }


def _jackknife(search: Search, robust: Robust, names: list[str]) -> dict[str, Any]:
    before, after = search.jackknife_first, search.jackknife_last

    def by_parameter(values: Any, camera: int) -> dict[str, Any]:
        estimated = search.first.network.cameras[camera].estimated
        return {PARAMETERS[i]: as_plain(values[camera][i]) for i in np.flatnonzero(estimated)}

    return {
        name: {
            "standard_error": by_parameter(before.standard_error, k),
            "sandwich": by_parameter(robust.sandwich, k),
            "bootstrap": None if robust.bootstrap is None else by_parameter(robust.bootstrap, k),
            "standard_error_corrected": by_parameter(after.standard_error, k),
            "left_out": [
                {"images": list(images), "parameters": by_parameter(values, k)}
                for images, values in zip(before.left_out, before.cameras, strict=True)
            ],
            "not_possible": list(before.not_possible),
        }
        for k, name in enumerate(names)
    }


ALPHA = 0.10
THRESHOLD = 0.8


def analyse_run(
    folder: Path,
    block: Path | None = None,
    alpha: float = ALPHA,
    threshold: float = THRESHOLD,
    done: Callable[[float], None] = lambda _: None,
    say: Catalogue | None = None,
    draws: int = 0,
) -> Outcome:
    """Analyse a run and write `analysis.json` into its folder: it then goes into the certificate.

    block: block folder or set-up file; looked for where the run says, beside it and below the current folder
        when not given.
    draws: of the bootstrap over images.
    done: gets the share of the work that was done since it was called last.

    raises PhotocalError: as reading, adjusting and writing do.
    """
    result = read_result(folder)
    source = block_of_run(folder, result, block, Path.cwd())
    read = read_any_block(source.path)
    assembly = network_of(read, result)
    checks, start = _checks(read, assembly), state_of(assembly, result)
    outcome = analyse_network(assembly.network, checks, alpha, threshold, done, draws, start)
    difference = exterior_difference(read, result)
    content = {
        **analysis_record(outcome, say or catalogue("en")),
        "exterior_difference": as_plain(difference) if difference else None,
        "result_sha256": digest(folder / RESULT),
    }
    with output_file(folder / ANALYSIS) as aside:
        write_json(aside, content)
    return outcome


def _checks(block: Block, assembly: NetworkOfBlock) -> Checks:
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
    d = (given - adjusted)[original.known]
    d[:, :3] = np.degrees((d[:, :3] + np.pi) % (2 * np.pi) - np.pi) * 3600.0
    mean, rmse = d.mean(axis=0), np.sqrt(np.mean(d**2, axis=0))
    place, turn = slice(3, 6), slice(3)
    figures = [tuple(values[part].tolist()) for part in (place, turn) for values in (mean, rmse)]
    return ExteriorDifference(len(d), *figures)

"""The analysis of a run: its block adjusted again with one thing changed at a time."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from acquire.outputs import output_file
from photocal.analysis.outcome import Outcome, analyse_network
from photocal.analysis.systematic_errors.left_out import Checks
from photocal.block.model import Block, digest
from photocal.block.network import NetworkOfBlock, block_frame
from photocal.exchange.formats import read_any_block
from photocal.findings.catalogue import Catalogue, catalogue
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import angles_from_matrix
from photocal.georeferencing.direct import direct_orientation
from photocal.georeferencing.local import in_local_frame
from photocal.report.analysis_record import analysis_record, as_plain
from photocal.report.stored_analysis import ANALYSIS, ExteriorDifference
from photocal.results.adjusted import network_of, state_of
from photocal.results.folder import RESULT, read_result
from photocal.results.origin import block_of_run
from photocal.results.result import Result

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
    draws : int
        Of the bootstrap over images.
    done : callable
        Gets the share of the work that was done since it was called last.

    Raises
    ------
    PhotocalError
        As reading, adjusting and writing do.
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
        "exterior_difference": as_plain(asdict(difference)) if difference else None,
        "result_sha256": digest(folder / RESULT),
    }
    with output_file(folder / ANALYSIS) as aside:
        aside.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
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
    x, y, z, *turn = mean[[3, 4, 5, 0, 1, 2]].tolist()
    rx, ry, rz, *turns = rmse[[3, 4, 5, 0, 1, 2]].tolist()
    return ExteriorDifference(len(d), (x, y, z), (rx, ry, rz), _triple(turn), _triple(turns))


def _triple(values: list[float]) -> tuple[float, float, float]:
    first, second, third = values
    return first, second, third

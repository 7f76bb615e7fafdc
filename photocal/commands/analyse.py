"""`photocal analyse`: what a calibration is worth and what it has hidden."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from photocal.block.model import Block


def analyse(
    run: Annotated[Path, typer.Argument(help="Folder that `photocal adjust` wrote.")],
    block: Annotated[
        Path | None, typer.Option("--block", help="Block folder of the run, when it is not found beside it.")
    ] = None,
    alpha: Annotated[float, typer.Option(min=1e-4, max=0.5, help="Level of the significance tests.")] = 0.10,
    correlation: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Correlations from here on are named.")
    ] = 0.8,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Analyse a calibration: hidden errors worst first, significance, correlations, method.

    The block of the run is adjusted again, with one thing changed at a time. It is looked for beside the run
    and below the current folder, and recognised by its hashes.

    Example: `photocal adjust configs/demo/dcs460 -o run && photocal analyse run`
    """
    from acquire.console import answer, progress
    from photocal.analysis.outcome import analyse_network
    from photocal.analysis.outcome_json import as_figures
    from photocal.analysis.outcome_text import as_text
    from photocal.block.folder import read_block
    from photocal.block.network import assemble
    from photocal.commands.run_block import block_of_run

    result = _result(run)
    source = read_block(block_of_run(run, result, block, Path.cwd()))
    assembly = assemble(source)
    with progress("adjusting again", None) as advance:
        outcome = analyse_network(
            assembly.network, _checks(source, assembly), alpha, correlation, lambda: advance(1)
        )
    answer(as_json, lambda: as_figures(outcome), lambda: as_text(outcome))


def _result(run: Path) -> dict[str, Any]:
    from photocal.report.run import read_run

    read_run(run)
    content: dict[str, Any] = json.loads((run / "result.json").read_text(encoding="utf-8"))
    return content


def _checks(source: Block, assembly: Any) -> Any:
    import numpy as np

    from photocal.analysis.hidden.left_out import Checks

    check = np.flatnonzero(source.points.of_role("check")[assembly.points])
    return Checks(check, assembly.frame.to_local(source.points.values[assembly.points[check]]))

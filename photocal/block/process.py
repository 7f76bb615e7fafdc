"""Adjust a block folder and write its run folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from acquire.outputs import output_folder
from photocal.adjustment.adjust import adjust
from photocal.adjustment.snooping import Test, snoop
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import Assembly, assemble
from photocal.block.run import summary, write_run

Report = Callable[[Iteration], None]


def adjust_block(
    source: Path, output: Path, snooping: Test | None = None, report: Report | None = None
) -> dict[str, Any]:
    """Read a block, adjust it, write the results.

    Parameters
    ----------
    source : Path
        Block folder, or a set-up file of another program that `exchange` reads.
    output : Path
        Run folder; made or renewed when everything has succeeded.
    snooping : {"w", "tau"}, optional
        Search for gross errors with this test.
    report : callable, optional
        Called after each iteration.

    Returns
    -------
    dict
        Content of `result.json`.

    Raises
    ------
    PhotocalError
        For bad input, an ill-posed network, or an output that cannot be written.
    """
    began = time.perf_counter()
    block = read_any_block(source)
    assembly = assemble(block)
    timing = {"read": time.perf_counter() - began}
    assembly, solution = _adjusted(assembly, snooping, report)
    timing |= solution.timing_s
    result = summary(block, assembly, solution, timing)
    with output_folder(output) as aside:
        write_run(aside, block, assembly, solution, result)
    return result


def read_any_block(source: Path) -> Block:
    """Read a block folder, or the set-up file of another program.

    Parameters
    ----------
    source : Path

    Returns
    -------
    Block

    Raises
    ------
    PhotocalError
        For what cannot be read.
    """
    if not source.is_file():
        return read_block(source)
    # Readers of other programs' formats are many; a block folder needs none of them.
    from photocal.exchange.foreign import read_foreign_block

    return read_foreign_block(source)


def _adjusted(assembly: Assembly, snooping: Test | None, report: Report | None) -> tuple[Assembly, Solution]:
    """Adjust the network of an assembly; with snooping only what is accepted remains in it."""
    if snooping is None:
        return assembly, adjust(assembly.network, report)
    found = snoop(assembly.network, snooping, report)
    accepted = replace(
        assembly,
        network=found.network,
        points=assembly.points[found.points],
        rays=assembly.rays[found.accepted],
    )
    return accepted, found.solution

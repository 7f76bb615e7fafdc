"""Adjust a block folder and write its run folder."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from acquire.outputs import output_folder
from photocal.adjustment.covariance import complete
from photocal.adjustment.datum import with_datum
from photocal.adjustment.normal import prepare
from photocal.adjustment.solver import minimise
from photocal.adjustment.state import start_state
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.block.run import summary, write_run


def adjust_block(folder: Path, output: Path) -> dict[str, Any]:
    """Read a block folder, adjust it, write the results.

    Parameters
    ----------
    folder : Path
        Block folder.
    output : Path
        Run folder; made or renewed when everything has succeeded.

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
    block = read_block(folder)
    assembly = assemble(block)
    read = time.perf_counter()
    state = start_state(assembly.network)
    problem = with_datum(prepare(assembly.network), state)
    minimum = minimise(problem, state)
    solved = time.perf_counter()
    solution = complete(problem, minimum)
    done = time.perf_counter()
    timing = {"read": read - began, "solve": solved - read, "covariance": done - solved}
    result = summary(block, assembly, solution, timing)
    with output_folder(output) as aside:
        write_run(aside, block, assembly, solution, result)
    return result

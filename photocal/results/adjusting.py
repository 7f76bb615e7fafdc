"""Adjusting a block: its result, and its run folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from acquire.outputs import output_folder
from photocal.adjustment.adjust import adjust
from photocal.adjustment.readout import with_readouts
from photocal.adjustment.snooping import Test, snoop, subset
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration
from photocal.adjustment.variance_components import Component, estimate_components, rays_by_camera
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.motion import require_motion
from photocal.block.network import NetworkOfBlock, assemble
from photocal.block.start import behind_cameras
from photocal.results.adjusted import result_of
from photocal.results.folder import write_result
from photocal.results.more_tables import Wanted, more_figures, write_more
from photocal.results.result import BlockFacts, Result

NOTHING_MORE = Wanted()
Report = Callable[[Iteration], None]


def adjust_block(
    source: Path,
    output: Path,
    snooping: Test | None = None,
    report: Report | None = None,
    wanted: Wanted = NOTHING_MORE,
    read: Callable[[Path], Block] = read_block,
) -> Result:
    """Read a block, adjust it, write the results.

    raises PhotocalError: for bad input, an ill-posed network, or an output that cannot be written.
    """
    began = time.perf_counter()
    block = read(source)
    read_s = time.perf_counter() - began
    result, assembly, solution = _adjusted_block(block, snooping, report, wanted)
    result = replace(
        result,
        block=_with_origin(result.block, source, block, output),
        timing_s={"read": read_s, **result.timing_s},
    )
    with output_folder(output) as aside:
        write_result(aside, result)
        write_more(aside, block, assembly, solution, result.points.covariance, wanted)
    return result


def adjust_network(block: Block, snooping: Test | None = None, wanted: Wanted = NOTHING_MORE) -> Result:
    """Adjust a block that is at hand; parameters and errors as of `adjust_block`."""
    return _adjusted_block(block, snooping, None, wanted)[0]


def _adjusted_block(
    block: Block, snooping: Test | None, report: Report | None, wanted: Wanted
) -> tuple[Result, NetworkOfBlock, Solution]:
    began = time.perf_counter()
    assembly = assemble(block)
    require_motion(block, assembly.network)
    timing = {"assemble": time.perf_counter() - began}
    assembly, solution = adjusted(assembly, snooping, report)
    components: tuple[Component, ...] = ()
    if wanted.components:
        found = estimate_components(assembly.network, rays_by_camera(assembly.network), report=report)
        assembly, solution = replace(assembly, network=found.network), found.solution
        components = found.components
    timing |= solution.timing_s
    result = result_of(block, assembly, solution, snooping=snooping, components=components, timing_s=timing)
    return (
        replace(result, **more_figures(assembly, result.points.covariance, wanted)),
        assembly,
        solution,
    )


def _with_origin(facts: BlockFacts, source: Path, block: Block, output: Path) -> BlockFacts:
    """Add where the inputs lie, seen from the run folder, and which of them is the set-up file."""
    root, setup = source, ""
    if source.is_file():
        setup = next(file.path for file in block.inputs if Path(file.path).name == source.name)
        root = source.parents[len(Path(setup).parts) - 1]
    # Together they may move to another place; the run folder alone need not.
    seen = Path(os.path.relpath(root.resolve(), output.resolve())).as_posix()
    return replace(facts, source=seen, setup=setup)


def adjusted(
    assembly: NetworkOfBlock, snooping: Test | None = None, report: Report | None = None
) -> tuple[NetworkOfBlock, Solution]:
    """Adjust the network of an assembly; points that no start value brings before their cameras take no part.

    raises PhotocalError: for an ill-posed network.
    """
    network = assembly.network
    known = network.points.held.any(axis=1) | network.points.weight.any(axis=(1, 2))
    lost = behind_cameras(network.exposures, network.rays, network.points.values) & ~known
    if lost.any():
        network, taken, points = subset(network, ~lost[network.rays.point])
        assembly = replace(
            assembly, network=network, points=assembly.points[points], rays=assembly.rays[taken]
        )
    if snooping is None:
        solution = adjust(network, report)
    else:
        found = snoop(network, snooping, report)
        points, rays = assembly.points[found.points], assembly.rays[found.accepted]
        assembly, solution = (
            replace(assembly, network=found.network, points=points, rays=rays),
            found.solution,
        )
    network, solution, readouts = with_readouts(assembly.network, solution, report)
    return replace(assembly, network=network, readouts=readouts), solution

"""A block folder adjusted in parts, by several processes or a cluster: the results are those of the whole."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from photocal.adjustment.network import Network
from photocal.adjustment.parts.adjusting import adjust_parts, solution_of_parts
from photocal.adjustment.parts.dissection import dissect
from photocal.adjustment.parts.forecast import Forecast, forecast
from photocal.adjustment.parts.part import images_together, require_divisible
from photocal.adjustment.parts.portions import write_divided
from photocal.base.errors import ConfigurationError
from photocal.base.files import refusals
from photocal.base.operating_system import available_memory
from photocal.base.workers import Cluster, Workers
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.options import PartsOptions
from photocal.block.results.adjusted import AdjustedBlock, Report, result_of, seen_from_before, write_adjusted
from photocal.block.results.result import Result

# What a process holds before it has any part, and of each ray: measured, adjusted, and written; bytes.
PROCESS, OF_RAY, GB = 3e8, 400.0, 1e9


def adjust_block_in_parts(
    source: Path,
    output: Path,
    options: PartsOptions,
    report: Report | None = None,
    read: Callable[[Path], Block] = read_block,
) -> Result:
    """Read a block, adjust it in parts, write the results, as `adjust_block` those of the whole.

    raises ConfigurationError: for a block that cannot be divided, or where memory does not suffice.
    raises PhotocalError: as `adjust_block`.
    """
    block = read(source)
    assembly = seen_from_before(assemble(block))
    network = assembly.network
    require_divisible(network)
    if network.exposures.motion is not None:
        raise ConfigurationError(
            "a block with a rolling shutter cannot be adjusted in parts", "adjust it whole: leave --parts out"
        )
    rays = network.rays
    together = images_together(rays.image, rays.point, len(network.image_names))
    centre = np.nan_to_num(network.exposures.started[:, 3:])
    dissection = dissect(together, centre, max(1, len(centre) // options.parts))
    shared = sum(int(camera.estimated.sum()) for camera in network.cameras) + len(network.mounting.values)
    require_memory(network, forecast(together, centre, dissection, shared), options.who)
    beside = output.resolve().parent
    with refusals(beside):
        beside.mkdir(parents=True, exist_ok=True)
        opened = tempfile.TemporaryDirectory(dir=beside, prefix=f".{output.name}-parts-")
    with opened as folder:
        if isinstance(options.who, Cluster):
            options.who.require_shared(Path(folder), Path(folder))
        write_divided(network, dissection, Path(folder))
        free = network.datum_points is not None
        adjusted = adjust_parts(Path(folder), dissection, options.who, report, free=free)
        solution = solution_of_parts(Path(folder), adjusted, len(dissection.parts))
    result = result_of(block, assembly, solution)
    return write_adjusted(AdjustedBlock(block, assembly, solution, result), source, output)


def require_memory(network: Network, sizes: Forecast, workers: Workers) -> None:
    """Refuse a block whose parts, or what joins them, this computer cannot hold, before any work is done.

    raises ConfigurationError: with what it would need.
    """
    free = available_memory()
    if free is None:
        return
    here = PROCESS + OF_RAY * len(network.rays.image) + sizes.upper_bytes
    # Parts that find no room are computed again: each process needs room for the largest.
    each = PROCESS + 2.0 * float(sizes.part_bytes.max(initial=0.0))
    need = here + (0.0 if isinstance(workers, Cluster) else workers * each)
    if need > free:
        raise ConfigurationError(
            f"the block in {len(sizes.inner)} parts takes about {need / GB:.1f} GB of memory, "
            f"{free / GB:.1f} GB are free",
            "take fewer workers, other parts, or a computer with more memory",
        )

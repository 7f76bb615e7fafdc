"""The network of a block as a run adjusted it: without gross errors, with the sigmas that it estimated."""

from __future__ import annotations

from dataclasses import replace

from photocal.adjustment.variance_components import estimate_components, rays_by_camera
from photocal.block.model import Block
from photocal.block.network import NetworkOfBlock, assemble
from photocal.block.process import adjusted
from photocal.report.run import Result


def as_adjusted(block: Block, result: Result) -> NetworkOfBlock:
    """Make the network that a run ended with."""
    assembly, _ = adjusted(assemble(block), result.snooping)
    if not result.variance_components:
        return assembly
    found = estimate_components(assembly.network, rays_by_camera(assembly.network))
    return replace(assembly, network=found.network)

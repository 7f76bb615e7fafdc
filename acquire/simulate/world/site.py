"""The two folders of a simulated flight: what a surveyor brings home, and the truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from acquire.simulate.world.block_folder import write_block
from acquire.simulate.world.configuration import Configuration, Level
from acquire.simulate.world.observations import observe
from acquire.simulate.world.project_file import write_particulars, write_project
from acquire.simulate.world.truth import write_truth
from acquire.simulate.world.world import World, make_world

Advance = Callable[[float], None]


def simulate_flight(configuration: Configuration, folder: Path, advance: Advance) -> dict[str, Any]:
    """Simulate a flight and write `site/` and `truth/`.

    Parameters
    ----------
    configuration : Configuration
    folder : Path
        An empty folder.
    advance : callable
        Is told the share of the work done since the last call.

    Returns
    -------
    dict
        Figures of the summary.
    """
    world = make_world(configuration)
    site, truth = folder / "site", folder / "truth"
    site.mkdir(parents=True)
    observed = None if configuration.level is Level.PICTURES else observe(world)
    if configuration.level is Level.BLOCK and observed is not None:
        write_block(world, observed, site / "block")
    write_project(world, site)
    write_particulars(world, site / "particulars.toml")
    write_truth(world, truth, observed, projected=configuration.level is not Level.BLOCK)
    advance(1.0)
    return summary(world)


def summary(world: World) -> dict[str, Any]:
    """Give what a flight consists of."""
    roles = world.targets.roles
    return {
        "name": world.configuration.name,
        "level": world.configuration.level.value,
        "seed": world.configuration.seed,
        "images": len(world.exposures),
        "control": roles.count("control"),
        "check": roles.count("check"),
        "duration_s": round(world.motion.duration_s, 1),
        "faults": sorted(fault.value for fault in world.configuration.faults),
    }

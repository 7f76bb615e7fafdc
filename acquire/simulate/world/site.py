"""The two folders of a simulated flight: what a surveyor brings home, and the truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.world.block_folder import write_block, write_observations
from acquire.simulate.world.configuration import Configuration, Level
from acquire.simulate.world.observations import kept_images, observe
from acquire.simulate.world.project_file import write_particulars, write_project
from acquire.simulate.world.streams import Streams, make_streams, telemetry_log
from acquire.simulate.world.tables import write_table
from acquire.simulate.world.truth import write_truth
from acquire.simulate.world.world import World, make_world, picture_stamps

Advance = Callable[[float], None]


def simulate_flight(configuration: Configuration, folder: Path, advance: Advance) -> dict[str, Any]:
    """Simulate a flight and write `site/` and `truth/`."""
    world = make_world(configuration)
    site, truth = folder / "site", folder / "truth"
    site.mkdir(parents=True)
    observed = None if configuration.level is Level.PICTURES else observe(world)
    if observed is not None and configuration.level is Level.BLOCK:
        write_block(world, observed, site / "block")
    elif observed is not None:
        write_observations(world, observed, site / "observations.csv")
        write_times(world, site / "times.csv")
    if configuration.level is Level.PICTURES:
        from acquire.simulate.world.picture_file import write_pictures

        write_pictures(world, site / "images", advance)
    if configuration.level is not Level.BLOCK:
        write_streams(world, make_streams(world), folder)
    write_project(world, site)
    write_particulars(world, site / "particulars.toml")
    write_truth(world, truth, observed, projected=configuration.level is not Level.BLOCK)
    return summary(world)


def write_streams(world: World, streams: Streams, folder: Path) -> None:
    """Write the recorded streams to the site, and when each frame arrived beside the truth."""
    site, wires = folder / "site", folder / "truth" / "wires"
    wires.mkdir(parents=True)
    start_us = int(world.utc_ns(np.zeros(1))[0]) // 1000
    (site / "vehicle.tlog").write_bytes(telemetry_log(streams.vehicle, start_us))
    (site / "rover.ubx").write_bytes(streams.rover.data)
    (site / f"base.{world.configuration.gnss.base_protocol}").write_bytes(streams.base.data)
    for name, wire in streams.links().items():
        sizes = [len(frame) for frame in wire.frames]
        write_table(wires / f"{name}.csv", {"arrival_s": (".6f", wire.arrival_s), "bytes": ("d", sizes)})


def write_times(world: World, path: Path) -> None:
    """Write `times.csv`: the names of pictures and what the camera's clock said."""
    pairs = zip(world.exposures.names, picture_stamps(world), kept_images(world).tolist(), strict=True)
    rows = [(name, stamp.isoformat(timespec="milliseconds")) for name, stamp, kept in pairs if kept]
    names, taken = zip(*rows, strict=True)
    write_table(path, {"image": ("", names), "taken": ("", taken)})


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

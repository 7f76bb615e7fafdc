"""The world of the simulator, as tests and studies fly it: simulate a flight, import its log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from acquire.importing.importer import import_recordings
from acquire.simulate.world.configuration import FLIGHTS, read_configuration
from acquire.simulate.world.exposures import omega_phi_kappa
from acquire.simulate.world.observations import observe
from acquire.simulate.world.site import simulate_flight
from acquire.simulate.world.world import World, make_world
from photocal.base.arrays import Floats
from photocal.block.model import Block, Images, ObjectPoints, Observations
from photocal.geometry.camera import Camera

PLANS = FLIGHTS
FLIGHT = PLANS / "survey.toml"
LINKS = ("vehicle", "rover", "base")


def simulate(folder: Path, plan: Path = FLIGHT, /, **instead: Any) -> Path:
    """Simulate a flight.

    Parameters
    ----------
    folder : Path
        Gets `site` and `truth`.
    plan : Path
        Configuration of the flight.
    **instead
        Keys of its top level that replace those of the file.

    Returns
    -------
    Path
        The site.
    """
    simulate_flight(read_configuration(plan, instead), folder, lambda _: None)
    return folder / "site"


def import_log(site: Path, links: tuple[str, ...] = LINKS) -> Path:
    """Import the streams of a site as its flight log, anew."""
    log = site / "flight.mcap"
    log.unlink(missing_ok=True)
    import_recordings([(link, path) for link in links for path in site.glob(f"{link}.*")], [], log, _nothing)
    return log


def fly(folder: Path, plan: Path = FLIGHT, /, **instead: Any) -> Path:
    """Fly with streams and image observations, no pictures, and import the streams; as `simulate`.

    Returns
    -------
    Path
        The project file, ready for `photocal run`.
    """
    site = simulate(folder, plan, **{"level": "observations", **instead})
    import_log(site)
    return site / "project.toml"


def world_of(plan: Path = FLIGHT, /, **instead: Any) -> World:
    """The world of a flight, with nothing written; as `simulate`."""
    return make_world(read_configuration(plan, instead))


def true_poses(world: World) -> Floats:
    """Omega, phi, kappa (rad), X, Y, Z (m) of the exposures, shape (n, 6)."""
    pose = world.exposures.pose
    return np.column_stack([omega_phi_kappa(pose.rotation), pose.centre_m])


def block_of(world: World, own: Camera, position_sigma_m: Floats, rng: np.random.Generator) -> Block:
    """A block of a world as a camera is known before: projection centres observed, ties seen, no control."""
    poses, seen, names = true_poses(world), observe(world), world.exposures.names
    poses[:, 3:] += rng.normal(0.0, 1.0, (len(poses), 3)) * position_sigma_m
    sigma = np.column_stack([np.full((len(poses), 3), np.inf), np.tile(position_sigma_m, (len(poses), 1))])
    used, point = np.unique(seen.point, return_inverse=True)
    places = seen.points_m[used] + rng.normal(0.0, 0.1, (len(used), 3))
    return Block(
        "simulated", "local", "", "control", (own,),
        Images(names, np.zeros(len(names), np.int64), poses, sigma, time=world.exposures.event_s),
        ObjectPoints(tuple(seen.names[k] for k in used), places),
        Observations("px", "pixel", seen.image, point, seen.pixels, np.tile(seen.sigma_px[:, None], 2)),
    )  # fmt: skip


def _nothing(_done: object) -> None:
    """Show no progress."""

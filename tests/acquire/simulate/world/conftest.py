"""Simulated worlds and flights that several tests look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from acquire.simulate.world.configuration import FlightConfiguration, read_configuration
from acquire.simulate.world.world import World, make_world
from tests.conftest import Once
from tests.simulated import PLANS, simulate


def configured(name: str, **instead: Any) -> FlightConfiguration:
    """Read a demonstration with other keys at the top level."""
    return read_configuration(PLANS / f"{name}.toml", instead)


@dataclass(frozen=True)
class Flight:
    """A simulated flight on disk, and the world that it comes from."""

    folder: Path
    world: World


def flown(folder: Path, **instead: Any) -> Flight:
    """Simulate the small flight into a folder."""
    simulate(folder, PLANS / "small.toml", **instead)
    return Flight(folder, make_world(configured("small", **instead)))


@pytest.fixture(scope="session")
def world() -> World:
    """The demonstration's world."""
    return make_world(configured("survey"))


@pytest.fixture(scope="session")
def small(once: Once) -> Flight:
    """The small flight with pictures."""
    return Flight(once("small", flown), make_world(configured("small")))

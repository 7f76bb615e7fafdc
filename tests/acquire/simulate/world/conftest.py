"""Simulated worlds and flights that several tests look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from acquire.simulate.world.configuration import FlightConfiguration, read_configuration
from acquire.simulate.world.site import simulate_flight
from acquire.simulate.world.world import World, make_world
from tests.conftest import Once

DEMO = Path(__file__).resolve().parents[4] / "acquire" / "simulate" / "flights"


def configured(name: str, **instead: Any) -> FlightConfiguration:
    """Read a demonstration with other keys at the top level."""
    return read_configuration(DEMO / f"{name}.toml", instead)


def nothing(_share: float) -> None:
    """Show no progress."""


@dataclass(frozen=True)
class Flight:
    """A simulated flight on disk, and the world that it comes from."""

    folder: Path
    world: World


def flown(folder: Path, **instead: Any) -> Flight:
    """Simulate the small flight into a folder."""
    given = configured("small", **instead)
    simulate_flight(given, folder, nothing)
    return Flight(folder, make_world(given))


@pytest.fixture(scope="session")
def world() -> World:
    """The demonstration's world."""
    return make_world(configured("survey"))


@pytest.fixture(scope="session")
def small(once: Once) -> Flight:
    """The small flight with pictures."""
    return Flight(once("small", flown), make_world(configured("small")))

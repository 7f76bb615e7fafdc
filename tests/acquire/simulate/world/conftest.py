"""Simulated worlds and flights that several tests look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from acquire.simulate.world.world import World
from tests.conftest import Once
from tests.simulated import PLANS, simulate, world_of


@dataclass(frozen=True)
class Flight:
    """A simulated flight on disk, and the world that it comes from."""

    folder: Path
    world: World


def flown(folder: Path, **instead: Any) -> Flight:
    """Simulate the small flight into a folder."""
    simulate(folder, PLANS / "small.toml", **instead)
    return Flight(folder, world_of(PLANS / "small.toml", **instead))


@pytest.fixture(scope="session")
def world() -> World:
    """The demonstration's world."""
    return world_of(PLANS / "survey.toml")


@pytest.fixture(scope="session")
def small(once: Once) -> Flight:
    """The small flight with pictures."""
    return Flight(once("small", flown), world_of(PLANS / "small.toml"))

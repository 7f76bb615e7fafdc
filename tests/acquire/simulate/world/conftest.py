"""Simulated worlds that several tests look at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from acquire.simulate.world.configuration import Configuration, read_configuration
from acquire.simulate.world.world import World, make_world

DEMO = Path(__file__).resolve().parents[4] / "configs" / "demo" / "simulated" / "flight.toml"


def configured(**instead: Any) -> Configuration:
    """Read the demonstration with other keys at the top level."""
    return read_configuration(DEMO, instead)


@pytest.fixture(scope="session")
def world() -> World:
    """The demonstration's world."""
    return make_world(configured())

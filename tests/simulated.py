"""Simulated flights of the demonstration without pictures, for tests and studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from acquire.importing.importer import import_recordings
from acquire.simulate.world.configuration import FLIGHTS, read_configuration
from acquire.simulate.world.site import simulate_flight

PLANS = FLIGHTS
FLIGHT = PLANS / "survey.toml"
_LINKS = ("vehicle", "rover", "base")


def fly(folder: Path, plan: Path = FLIGHT, /, **instead: Any) -> Path:
    """Fly with streams and image observations, and import the streams.

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
        The project file, ready for `photocal run`.
    """
    simulate_flight(read_configuration(plan, {"level": "observations", **instead}), folder, lambda _: None)
    site = folder / "site"
    streams = [(link, path) for link in _LINKS for path in site.glob(f"{link}.*")]
    import_recordings(streams, [], site / "flight.mcap", lambda _: None)
    return site / "project.toml"

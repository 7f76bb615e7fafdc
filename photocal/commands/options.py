"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def option(text: str, *names: str, **settings: Any) -> Any:
    """Describe an option of a command: its help, and its names where they are not that of the parameter."""
    return typer.Option(*names, help=text, **settings)


def argument(text: str, **settings: Any) -> Any:
    """Describe an argument of a command by its help."""
    return typer.Argument(help=text, **settings)


Rover = Annotated[Path | None, option("RINEX observations of the rover.")]
Base = Annotated[Path | None, option("RINEX observations of the base.")]
Navigation = Annotated[
    list[str] | None,
    option("RINEX navigation file; may be repeated. `base`: those that the base's link recorded."),
]
BasePosition = Annotated[
    str | None,
    option("LAT,LON,H of the base: degrees, ellipsoidal height in metres; or a CSRS-PPP or SINEX file."),
]
BaseSigma = Annotated[str | None, option("Standard deviations E,N,U of the base's position, metres.")]
BaseWeather = Annotated[
    str | None,
    option("TEMPERATURE,HUMIDITY[,PRESSURE] at the base: degrees Celsius, percent, hPa."),
]
RoverLink = Annotated[str, option("Link of the rover in the flight log.")]
BaseLink = Annotated[str, option("Link of the base in the flight log.")]
AsJson = Annotated[bool, option("Print the figures as JSON.", "--json")]

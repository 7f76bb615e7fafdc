"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Rover = Annotated[Path | None, typer.Option(help="RINEX observations of the rover.")]
Base = Annotated[Path | None, typer.Option(help="RINEX observations of the base.")]
Navigation = Annotated[
    list[str] | None,
    typer.Option(help="RINEX navigation file; may be repeated. `base`: those that the base's link recorded."),
]
BasePosition = Annotated[
    str | None,
    typer.Option(
        help="LAT,LON,H of the base: degrees, ellipsoidal height in metres; or a CSRS-PPP or SINEX file."
    ),
]
BaseSigma = Annotated[
    str | None, typer.Option(help="Standard deviations E,N,U of the base's position, metres.")
]
BaseWeather = Annotated[
    str | None,
    typer.Option(help="TEMPERATURE,HUMIDITY[,PRESSURE] at the base: degrees Celsius, percent, hPa."),
]
RoverLink = Annotated[str, typer.Option(help="Link of the rover in the flight log.")]
BaseLink = Annotated[str, typer.Option(help="Link of the base in the flight log.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")]

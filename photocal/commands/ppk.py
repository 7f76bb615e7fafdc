"""`photocal ppk`: the rover's trajectory from raw observations of rover and base."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer
from photocal.commands.options import (
    AsJson,
    Base,
    BaseLink,
    BasePosition,
    BaseSigma,
    BaseWeather,
    Navigation,
    Rover,
    RoverLink,
)


def ppk(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for trajectory.csv, summary and plot.")
    ],
    flight: Annotated[
        list[Path] | None, typer.Argument(help="Flight logs with raw frames of both, that follow each other.")
    ] = None,
    rover: Rover = None,
    base: Base = None,
    nav: Navigation = None,
    base_position: BasePosition = None,
    base_sigma: BaseSigma = None,
    weather: BaseWeather = None,
    rover_link: RoverLink = "rover",
    base_link: BaseLink = "base",
    rover_antenna_height: Annotated[
        float | None,
        typer.Option(help="Antenna reference point above the rover's mark, metres; without: RINEX header."),
    ] = None,
    base_antenna_height: Annotated[
        float | None,
        typer.Option(help="Antenna reference point above the base's mark, metres; without: RINEX header."),
    ] = None,
    antex: Annotated[
        Path | None, typer.Option(help="Antenna models: an ANTEX file, such as igs20.atx of the IGS.")
    ] = None,
    rover_antenna: Annotated[
        str, typer.Option(help="Type and radome of the rover's antenna in it; none: without a model.")
    ] = "",
    base_antenna: Annotated[
        str, typer.Option(help="The base's; without: as the RINEX header names it.")
    ] = "",
    elevation: Annotated[float, typer.Option(help="Least elevation of satellites, degrees.")] = 15.0,
    static: Annotated[bool, typer.Option("--static", help="The rover stood still: one position.")] = False,
    as_json: AsJson = False,
) -> None:
    """Compute the trajectory of a rover from raw observations of rover and base.

    Fixes are validated (ratio, both directions, Doppler velocity, code) and doubtful ones become float;
    float sigmas are rescaled to what both directions show. The columns sen, seu, snu are the roots of the
    covariances with their signs, in metres.

    Example: `photocal ppk FLIGHT.mcap -o ppk`
    """
    import tempfile

    from acquire.outputs import output_folder
    from photocal.navigation.engine import Rtklib
    from photocal.navigation.flight_log import FlightLog
    from photocal.navigation.ppk import options_for, process, with_antennas
    from photocal.navigation.ppk_inputs import Sources, gather_inputs
    from photocal.navigation.ppk_report import ppk_figures, ppk_text, write_ppk

    engine = Rtklib()
    logs = tuple(flight or ())
    sources = Sources(
        FlightLog(logs), rover, base, tuple(nav or ()), base_position, rover_link, base_link
    ).with_base(base_sigma, weather)
    with tempfile.TemporaryDirectory() as scratch:
        inputs, remarks = gather_inputs(sources, engine, Path(scratch))
        options = options_for(inputs.rover, inputs.base, rover_antenna_height, base_antenna_height, elevation)
        options = with_antennas(options, antex, (inputs.rover, rover_antenna), (inputs.base, base_antenna))
        result = process(inputs, options, "static" if static else "kinematic", engine, Path(scratch))
    figures = ppk_figures(result, remarks)
    with output_folder(output) as folder:
        write_ppk(folder, result, figures)
    answer(as_json, lambda: figures, lambda: ppk_text(figures))

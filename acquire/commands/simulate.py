"""`acquire simulate`: flights that never took place."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer, application, progress
from drivers.errors import ConfigurationError, OutputError

app = application("Simulate flights: a minute of telemetry, a whole survey with its truth, devices on ports.")


@app.callback(invoke_without_command=True)
def simulate(
    context: typer.Context,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Telemetry log of a short flight to write (.tlog).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Write the telemetry log of a synthetic flight of a minute, the same bytes each time.

    Example: `acquire simulate -o flight.tlog`
    """
    if context.invoked_subcommand is not None:
        if output is not None or as_json:
            raise ConfigurationError(
                "an option stands before the command", remedy=f"put it after {context.invoked_subcommand}"
            )
        return
    if output is None:
        raise ConfigurationError("nothing to write", remedy="give -o FILE.tlog, or a command, see --help")
    from acquire.outputs import output_file
    from acquire.simulate.flight import LABEL, telemetry_log
    from drivers.mavlink.dialect import ardupilotmega

    log = telemetry_log(ardupilotmega())
    with output_file(output) as aside:
        aside.write_bytes(log)
    answer(
        as_json,
        lambda: {"schema": "acquire.simulate/1", "output": str(output), "bytes": len(log), "label": LABEL},
        lambda: f"wrote {output}, {len(log)} bytes: {LABEL}",
    )


@app.command()
def flight(
    configuration: Annotated[Path, typer.Argument(metavar="CONFIG.toml", help="The flight to simulate.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to make: site/ and truth/.")],
    level: Annotated[
        str | None, typer.Option(help="pictures, observations or block, instead of the file's.")
    ] = None,
    observations_only: Annotated[
        bool, typer.Option("--observations-only", help="The same as --level block: fast, for statistics.")
    ] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the file's.")] = None,
    fault: Annotated[list[str] | None, typer.Option(help="Switch on a fault; may be repeated.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Simulate a survey flight: what a surveyor brings home in site/, the truth in truth/.

    Example: `acquire simulate flight configs/demo/simulated/flight.toml -o flight`
    """
    from acquire.outputs import output_folder
    from acquire.simulate.world.configuration import read_configuration
    from acquire.simulate.world.site import simulate_flight

    if output.is_dir() and any(output.iterdir()):
        # Files of another flight between the new ones would be taken for its own.
        raise OutputError("is not empty", where=output, remedy="name a new folder")
    chosen = {
        "level": "block" if observations_only else level,
        "seed": seed,
        "faults": frozenset(fault) if fault else None,
    }
    given = read_configuration(configuration, {k: v for k, v in chosen.items() if v is not None})
    with progress("simulating", 1.0) as advance, output_folder(output) as aside:
        figures = simulate_flight(given, aside, advance)
    answer(
        as_json,
        lambda: {"schema": "acquire.simulate.flight/1", "output": str(output), **figures},
        lambda: (
            f"wrote {output}: {figures['images']} images, {figures['control']} control and "
            f"{figures['check']} check points, {figures['duration_s']:.0f} s"
            + (f"; faults: {', '.join(figures['faults'])}" if figures["faults"] else "")
        ),
    )

"""`acquire check`: the preflight of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def check(
    configuration: Annotated[Path, typer.Argument(help="Configuration (TOML) of the recording.")],
    seconds: Annotated[float, typer.Option(min=0.1, max=600, help="How long to listen.")] = 5.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Look at ports, heartbeats, fix, rates, disk space and clock before a flight.

    The rates asked for are requested by `acquire record`; here they are only seen. Ends with 10 when
    something is not as it should be.

    Example: `acquire check flight.toml`
    """
    from acquire.recording import preflight
    from acquire.recording.caster_position import caster_positions
    from acquire.recording.configuration import read_configuration
    from acquire.recording.recorder import Host, sources_of
    from drivers.errors import DeviceError
    from drivers.mavlink.dialect import ardupilotmega

    chosen = read_configuration(configuration)
    host, dialect = Host(), ardupilotmega()
    positions = caster_positions(chosen, dialect)
    sources = sources_of(chosen, positions, host.clock_ns)
    checks = preflight.check(chosen, configuration.parent, sources, positions, seconds, host, dialect)
    answer(
        as_json,
        lambda: preflight.as_json(checks),
        lambda: "\n".join(f"{'good' if c.state == 'good' else 'BAD '}  {c.part}: {c.text}" for c in checks),
    )
    bad = [one.part for one in checks if one.state != "good"]
    if bad:
        raise DeviceError(
            f"not ready: {', '.join(bad)}", where=configuration, remedy="see to these before the flight"
        )

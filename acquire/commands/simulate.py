"""`acquire simulate`: a synthetic flight for trying things out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", help="Telemetry log to write (.tlog).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Write the telemetry log of a synthetic flight of a minute, the same bytes each time.

    Example: `acquire simulate -o flight.tlog`
    """
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

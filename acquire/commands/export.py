"""`acquire export`: the MAVLink link of a flight log as a telemetry log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def export(
    log: Annotated[Path, typer.Argument(help="Flight log (.mcap).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Telemetry log to write (.tlog).")],
    link: Annotated[str | None, typer.Option(help="Link, when the log has several.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Write the vehicle's link as a telemetry log that ground stations and pymavlink read.

    Example: `acquire export flight.mcap --link vehicle -o flight.tlog`
    """
    from acquire.log.replay import choose_link, export_tlog

    name = choose_link(log, link)
    count = export_tlog(log, name, output)
    answer(
        as_json,
        lambda: {"schema": "acquire.export/1", "link": name, "frames": count, "output": str(output)},
        lambda: f"{name}: {count} frames, wrote {output}",
    )

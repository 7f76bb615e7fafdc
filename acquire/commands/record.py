"""`acquire record`: a flight, every link raw first."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def record(
    configuration: Annotated[
        Path, typer.Argument(help="Configuration (TOML): [recording], [[link]], [site].")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON at the end.")] = False,
) -> None:
    """Record all links until Ctrl-C; the file is safe on disk at least once a second.

    Example: `acquire record flight.toml`
    """
    from acquire.operating_system import stopped_by_signals
    from acquire.recording.configuration import read_configuration
    from acquire.recording.recorder import record as recording

    chosen = read_configuration(configuration)
    stop = stopped_by_signals()
    result = recording(chosen, configuration.parent, stop, lambda text: typer.echo(text, err=True))
    answer(
        as_json,
        lambda: {
            "schema": "acquire.record/1",
            "output": str(result.paths[0]),
            "files": [str(path) for path in result.paths],
            "alarms": [
                {"kind": a.kind, "link": a.link, "text": a.text, "time_utc_ns": a.time_ns}
                for a in result.alarms
            ],
            "links": [
                {
                    "link": name,
                    "frames": t.frames,
                    "frame_bytes": t.frame_bytes,
                    "damage_bytes": t.damage_bytes,
                }
                for name, t in result.tallies.items()
            ],
        },
        lambda: "\n".join(
            [
                f"{name}: {t.frames} frames, {t.damage_bytes} bytes of damage"
                for name, t in result.tallies.items()
            ]
            + [f"wrote {path}" for path in result.paths]
        ),
    )

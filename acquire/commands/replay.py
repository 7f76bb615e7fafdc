"""`acquire replay`: the raw frames of a flight log to a program or a port."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def replay(
    log: Annotated[Path, typer.Argument(help="Flight log (.mcap).")],
    to: Annotated[str, typer.Option(help="udp://HOST:PORT, tcp://HOST:PORT (waits for a reader) or pty.")],
    link: Annotated[str | None, typer.Option(help="Link, when the log has several.")] = None,
    speed: Annotated[
        float, typer.Option(min=0, help="Times the pace of the recording; 0: as fast as it is taken.")
    ] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Send the raw frames of a link, byte for byte and in their order.

    Example: `acquire replay flight.mcap --link vehicle --to udp://127.0.0.1:14550 --speed 10`
    """
    import time

    from acquire.log import replay as replaying
    from acquire.transports.sinks import open_sink

    name = replaying.choose_link(log, link)
    with open_sink(to) as (sink, address):
        typer.echo(f"replaying {name} to {address}", err=True)
        sent = replaying.replay(log, name, sink, speed, time.monotonic, time.sleep)
    answer(
        as_json,
        lambda: {
            "schema": "acquire.replay/1",
            "link": name,
            "frames": sent.frames,
            "bytes": sent.size,
            "recorded_s": sent.recorded_s,
            "lost": sent.lost,
        },
        lambda: (
            f"sent {sent.frames} frames, {sent.size} bytes, recorded in {sent.recorded_s:.1f} s; "
            + ("what the network lost is not known" if sent.lost is None else f"{sent.lost} lost")
        ),
    )

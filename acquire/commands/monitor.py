"""`acquire monitor`: the state of a recording while it goes on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from acquire.log.reader import Messages
    from acquire.monitor.state import State
    from acquire.monitor.tail import Tail


def monitor(
    source: Annotated[
        Path,
        typer.Argument(help="Flight log (.mcap), folder of a recording, or its configuration (.toml)."),
    ],
    page: Annotated[bool, typer.Option("--page", help="Show it as a local web page instead.")] = False,
    address: Annotated[
        str,
        typer.Option(help="HOST:PORT of the page. Beyond this computer the page demands a token."),
    ] = "127.0.0.1:8740",
    debrief: Annotated[
        Path | None, typer.Option(help="File that `photocal debrief` writes: the page shows it.")
    ] = None,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Also serve the channels to Foxglove, with a token.")
    ] = False,
    foxglove_address: Annotated[str, typer.Option(help="HOST:PORT for Foxglove.")] = "127.0.0.1:8765",
    mute: Annotated[bool, typer.Option("--mute", help="Do not ring the bell of the terminal.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the state once as JSON.")] = False,
) -> None:
    """Show fix, satellites, corrections, rates, pictures, disk, clock and alarms of a recording live.

    It reads the log as it grows: it needs nothing of the recorder and cannot disturb it.

    Example: `acquire monitor flight.toml --page`
    """
    from acquire.monitor.tail import read_all, tail_of
    from acquire.monitor.view_model import view_of

    tail = tail_of(source)
    if as_json:
        answer(True, lambda: view_of(read_all(tail)).as_json(), str)
    elif foxglove:
        from acquire.monitor.foxglove_server import serving_foxglove
        from acquire.web import read_address

        with serving_foxglove(read_address(foxglove_address)) as (listen, url):
            typer.echo(f"Foxglove: open a connection to {url}", err=True)
            _show(tail, address if page else None, mute, listen, debrief)
    else:
        _show(tail, address if page else None, mute, lambda _: None, debrief)


def _show(
    tail: Tail,
    address: str | None,
    mute: bool,
    listen: Callable[[list[Messages]], None],
    debrief: Path | None,
) -> None:
    """Show a recording until Ctrl-C, on a page or here."""
    from acquire.monitor.tail import follow
    from acquire.operating_system import stopped_by_signals

    stop = stopped_by_signals()
    if address is None:
        _in_terminal(tail, stop, mute, listen)
        return
    from acquire.monitor.page import Latest, application
    from acquire.web import read_address, serving

    latest = Latest(lambda: tail.path.parent if tail.path else None, debrief)
    with serving(application(latest), read_address(address)) as url:
        typer.echo(f"open {url}")
        follow(tail, latest.publish, stop, listen)


def _in_terminal(
    tail: Tail, stop: threading.Event, mute: bool, listen: Callable[[list[Messages]], None]
) -> None:
    from rich.console import Console
    from rich.live import Live

    from acquire.monitor.tail import follow, read_all
    from acquire.monitor.terminal import render
    from acquire.monitor.view_model import layers, view_of

    console = Console()
    if not console.is_terminal:
        state = read_all(tail)
        console.print(render(view_of(state), layers(state), console.width, console.height))
        return
    told = 0
    with Live(console=console, screen=True, auto_refresh=False) as live:

        def show(state: State) -> None:
            nonlocal told
            if not mute and any(a.number > told and a.level == "bad" for a in state.alarms):
                console.bell()
            told = state.raised
            live.update(render(view_of(state), layers(state), console.width, console.height), refresh=True)

        follow(tail, show, stop, listen)

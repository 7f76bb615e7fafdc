"""Commands before and during a flight: check, record and monitor."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from acquire.commands.texts import refused, texts
from photocal.base.console import (
    Address,
    Check,
    Language,
    answer,
    answered,
    argument,
    error_lines,
    option,
    write_through,
)
from photocal.base.progress_bars import progress
from photocal.base.sentences import Texts, spoken

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from acquire.log.reader import LoggedMessages
    from acquire.monitor.state import RecordingState
    from acquire.monitor.tail import Tail


def check(
    configuration: Annotated[Path, argument("Configuration (TOML) of the recording.", metavar="CONFIG.toml")],
    seconds: Annotated[float, option("How long to listen.", min=0.1, max=600)] = 5.0,
    language: Language = "",
    as_json: Annotated[bool, option("Print the findings as JSON.", "--json")] = False,
) -> None:
    """Check ports, heartbeats, fix, rates, disk space and clock before a flight.

    `acquire record` requests the message rates; this command only measures them. The exit code is 10 when a
    check fails.

    Example: `acquire check flight.toml`
    """
    from acquire.recording import preflight
    from acquire.recording.caster_position import caster_positions
    from acquire.recording.configuration import read_configuration
    from acquire.recording.recorder import Host, sources_of
    from drivers.mavlink.dialect import ardupilotmega
    from photocal.base.errors import DeviceError

    say = texts(spoken(language))
    chosen = read_configuration(configuration)
    host, dialect = Host(), ardupilotmega()
    positions = caster_positions(chosen, dialect)
    sources = sources_of(chosen, positions, host.clock_ns)
    with progress(say("progress.listening"), None, say.messages["progress.left"]):
        checks = preflight.check(chosen, configuration.parent, sources, positions, seconds, host, dialect)
    answer(
        as_json,
        lambda: preflight.as_json(checks),
        lambda: "\n".join(_checked(one, say) for one in checks),
    )
    bad = [one.part if as_json else say.stored(one.part) for one in checks if one.state != "good"]
    if bad:
        raise DeviceError(
            f"not ready: {', '.join(bad)}", "correct these before the flight", where=configuration
        )


def _checked(one: Check, say: Texts) -> str:
    state = say("check.good" if one.state == "good" else "check.bad")
    return f"{state}  {say.stored(one.part)}: {say.stored(one.text)}"


def record(
    configuration: Annotated[
        Path, argument("Configuration (TOML): [recording], [[link]], [site].", metavar="CONFIG.toml")
    ],
    language: Language = "",
    as_json: Annotated[bool, option("Print the figures as JSON at the end.", "--json")] = False,
) -> None:
    """Record all links until Ctrl-C; data are flushed to disk at least once a second.

    Example: `acquire record flight.toml`
    """
    from acquire.recording.configuration import read_configuration
    from acquire.recording.recorder import record as recording
    from photocal.base.arrays import picked
    from photocal.base.errors import PhotocalError
    from photocal.base.operating_system import stopped_by_signals

    say = texts(spoken(language))
    chosen = read_configuration(configuration)
    stop = stopped_by_signals()
    try:
        result = recording(
            chosen,
            configuration.parent,
            stop,
            lambda text: write_through(sys.stderr, f"{say.stored(text)}\n"),
        )
    except PhotocalError as failure:
        _last_words(sys.stderr, error_lines(failure, refused))
        raise typer.Exit(failure.exit_code) from failure
    text = answered(
        as_json,
        lambda: {
            "schema": "acquire.record/1",
            "output": str(result.paths[0]) if result.paths else None,
            "files": [str(path) for path in result.paths],
            "untold_lines": result.untold,
            "alarms": [
                picked(alarm, "kind", "link", "text", time_utc_ns="time_ns") for alarm in result.alarms
            ],
            "links": [
                {"link": name, **picked(tally, "frames", "frame_bytes", "damage_bytes")}
                for name, tally in result.tallies.items()
            ],
        },
        lambda: "\n".join(
            [
                say("record.link", link=name, frames=t.frames, damage=t.damage_bytes)
                for name, t in result.tallies.items()
            ]
            + [say("record.wrote", path=path) for path in result.paths]
        ),
    )
    _last_words(sys.stdout, f"{text}\n")


def _last_words(stream: TextIO, text: str) -> None:
    """Print what is said at the end to whoever takes it: a terminal that takes nothing is not waited for."""
    # A pipe takes as much at once or not at all (POSIX: PIPE_BUF).
    piece_chars = 4096
    from acquire.recording.device_line import Outlet
    from acquire.recording.recorder import LAST_WORDS_S

    pieces = [text[at : at + piece_chars] for at in range(0, len(text), piece_chars)]
    printed: Outlet[str] = Outlet("last words", lambda piece: write_through(stream, piece), len(pieces))
    for piece in pieces:
        printed.put(piece)
    printed.close(LAST_WORDS_S)


def monitor(
    source: Annotated[
        Path,
        argument(
            "Flight log (.mcap), folder of a recording, or its configuration (.toml).", metavar="SOURCE"
        ),
    ],
    page: Annotated[bool, option("Show it as a local web page instead.", "--page")] = False,
    address: Address = "127.0.0.1:8740",
    debrief: Annotated[Path | None, option("File that `photocal debrief` writes: the page shows it.")] = None,
    plan: Annotated[Path | None, option("Planned mission (flight.waypoints), drawn under the track.")] = None,
    foxglove: Annotated[
        bool, option("Also serve the channels to Foxglove, with a token.", "--foxglove")
    ] = False,
    foxglove_address: Annotated[str, option("HOST:PORT for Foxglove.")] = "127.0.0.1:8765",
    mute: Annotated[bool, option("Do not ring the bell of the terminal.", "--mute")] = False,
    language: Language = "",
    as_json: Annotated[bool, option("Print the state once as JSON.", "--json")] = False,
) -> None:
    """Show fix, satellites, corrections, rates, pictures, disk, clock and alarms of a recording live.

    It reads the log while it grows, and cannot disturb the recorder.

    Example: `acquire monitor flight.toml --page`
    """
    from acquire.monitor.tail import read_all, tail_of
    from acquire.monitor.view_model import view_of

    say = texts(spoken(language))
    tail = tail_of(source)
    if as_json:
        answer(True, lambda: view_of(read_all(tail)).as_json(), str)
    elif foxglove:
        from acquire.monitor.foxglove_server import serving_foxglove
        from photocal.base.web import read_address

        with serving_foxglove(read_address(foxglove_address)) as (listen, url):
            typer.echo(say("monitor.foxglove", url=url), err=True)
            _show(tail, say, language, address if page else None, mute, listen, debrief, plan)
    else:
        _show(tail, say, language, address if page else None, mute, lambda _: None, debrief, plan)


def _show(
    tail: Tail,
    say: Texts,
    language: str,
    address: str | None,
    mute: bool,
    listen: Callable[[list[LoggedMessages]], None],
    debrief: Path | None,
    plan: Path | None,
) -> None:
    """Show a recording until Ctrl-C, on a page or here."""
    from acquire.monitor.tail import follow
    from photocal.base.operating_system import stopped_by_signals

    stop = stopped_by_signals()
    if address is None:
        _in_terminal(tail, say, stop, mute, listen)
        return
    from acquire.monitor.page import Latest, application
    from photocal.base.web import read_address, serving

    latest = Latest(lambda: tail.path.parent if tail.path else None, debrief, plan)
    with serving(application(latest), read_address(address)) as url:
        # Else the browser's language counts, also behind a token.
        asked = f"?lang={language}" if language and "?" not in url else ""
        typer.echo(say("monitor.open", url=url + asked))
        follow(tail, latest.publish, stop, listen)


def _in_terminal(
    tail: Tail,
    say: Texts,
    stop: threading.Event,
    mute: bool,
    listen: Callable[[list[LoggedMessages]], None],
) -> None:
    from rich.console import Console
    from rich.live import Live

    from acquire.monitor.tail import follow, read_all
    from acquire.monitor.terminal import render
    from acquire.monitor.view_model import layers, view_of

    console = Console()
    # One that cannot go back draws nothing anew.
    if not console.is_terminal or console.is_dumb_terminal:
        state = read_all(tail)
        console.print(render(view_of(state), layers(state), say, console.width, console.height))
        return
    announced = 0
    with Live(console=console, screen=True, auto_refresh=False) as live:

        def show(state: RecordingState) -> None:
            """Draw the state anew, and ring the bell at a new alarm."""
            nonlocal announced
            if not mute and any(a.number > announced and a.level == "bad" for a in state.alarms):
                console.bell()
            announced = state.raised
            live.update(
                render(view_of(state), layers(state), say, console.width, console.height), refresh=True
            )

        follow(tail, show, stop, listen)

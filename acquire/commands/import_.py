"""`acquire import`: recordings of other programs to a flight log."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer, progress
from drivers.errors import ConfigurationError

if TYPE_CHECKING:
    from acquire.importing.importer import Imported


def import_(
    output: Annotated[Path, typer.Option("-o", "--output", help="Flight log to write (.mcap).")],
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE]...", help="Recordings: .tlog, .ubx, .rtcm3, .nmea, .bin, .ulg, .mrk; gzip too."
        ),
    ] = None,
    link: Annotated[
        list[str] | None, typer.Option(metavar="NAME=FILE", help="Recording with the name of its link.")
    ] = None,
    date: Annotated[
        str | None,
        typer.Option(metavar="YYYY-MM-DD", help="UTC date of the beginning of streams that do not tell it."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Import recordings into one flight log, raw first.

    Example: `acquire import flight.tlog --link rover=rover.ubx --link base=base.ubx.gz -o flight.mcap`
    """
    from acquire.importing.importer import import_recordings

    named = [_named(text) for text in link or []]
    unnamed = files or []
    near_ns = _noon_ns(date)
    if not named and not unnamed:
        raise ConfigurationError("no recording was named", remedy="give FILE or --link NAME=FILE")
    total = sum(p.stat().st_size for p in [*unnamed, *(p for _, p in named)] if p.is_file())
    with progress("importing", total) as advance:
        results = import_recordings(named, unnamed, output, advance, near_ns)
    for result in results:
        if result.warning:
            typer.echo(f"warning: {result.link}: {result.warning}", err=True)
    answer(
        as_json,
        lambda: {
            "schema": "acquire.import/1",
            "output": str(output),
            "links": [result.as_json() for result in results],
        },
        lambda: "\n".join([*map(_sentence, results), f"wrote {output}"]),
    )


def _noon_ns(date: str | None) -> int:
    """Return noon of a date, which lies within half a day of every time of it; -1 without a date."""
    if date is None:
        return -1
    import datetime as dt

    try:
        day = dt.date.fromisoformat(date)
    except ValueError as refusal:
        raise ConfigurationError(
            "is no date", where=f"--date {date}", remedy="give year, month and day: 2026-05-01"
        ) from refusal
    return int(dt.datetime(day.year, day.month, day.day, 12, tzinfo=dt.UTC).timestamp()) * 1_000_000_000


def _named(text: str) -> tuple[str, Path]:
    name, separator, path = text.partition("=")
    if not separator or not path or not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise ConfigurationError(
            "a link is given as NAME=FILE, the name of letters, digits, _ and -",
            where=f"--link {text}",
            remedy="for example --link rover=rover.ubx",
        )
    return name, Path(path)


def _sentence(result: Imported) -> str:
    tally = result.tally
    text = f"{result.link}: {tally.frames} frames from {result.path} ({result.form.name})"
    if tally.damage_bytes:
        text += f"; {tally.damage_bytes} bytes in {tally.damage_runs} places belong to no valid frame"
    if result.packing_cut:
        text += "; the packed file ends early, imported as far as it goes"
    if result.cut:
        text += (
            f"; the recording ends inside a frame ({result.cut} bytes of it): imported to the last whole one"
        )
    return f"{text}; time: {result.log_time}"

"""Commands about a flight log: import, info, replay, recover and export."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from acquire.channels.mounting import mounting_lines
from photocal.base.console import AsJson, answer, argument, option, progress
from photocal.base.errors import ConfigurationError

if TYPE_CHECKING:
    from acquire.importing.importer import Imported
    from acquire.importing.recovery import Recovered

Log = Annotated[Path, argument("Flight log (.mcap).")]
Link = Annotated[str | None, option("Link, when the log has several.")]
Types = Annotated[bool, option("List frames by type, and the topics of the log.", "--types")]


def import_(
    output: Annotated[Path, option("Flight log to write (.mcap).", "-o", "--output")],
    files: Annotated[
        list[Path] | None,
        argument("Recordings: .tlog, .ubx, .rtcm3, .nmea, .bin, .ulg, .mrk; gzip too.", metavar="FILE"),
    ] = None,
    link: Annotated[
        list[str] | None, option("Recording with the name of its link.", metavar="NAME=FILE")
    ] = None,
    date: Annotated[
        str | None, option("UTC date of the beginning of streams without a date.", metavar="YYYY-MM-DD")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Import recordings into one flight log, raw first.

    Example: `acquire import flight.tlog --link rover=rover.ubx --link base=base.ubx.gz -o flight.mcap`
    """
    from acquire.importing.importer import import_recordings

    named = [_named(text) for text in link or []]
    unnamed = files or []
    near_ns = _noon_ns(date)
    if not named and not unnamed:
        raise ConfigurationError("no recording was named", "give FILE or --link NAME=FILE")
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
            "is not a date", "give year, month and day: 2026-05-01", where=f"--date {date}"
        ) from refusal
    return int(dt.datetime(day.year, day.month, day.day, 12, tzinfo=dt.UTC).timestamp()) * 1_000_000_000


def _named(text: str) -> tuple[str, Path]:
    name, separator, path = text.partition("=")
    if not separator or not path or not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise ConfigurationError(
            "a link is given as NAME=FILE; its name has letters, digits, _ and -",
            "for example --link rover=rover.ubx",
            where=f"--link {text}",
        )
    return name, Path(path)


def _sentence(result: "Imported") -> str:
    tally = result.tally
    text = f"{result.link}: {tally.frames} frames from {result.path} ({result.form.name})"
    if tally.damage_bytes:
        text += f"; {tally.damage_bytes} bytes in {tally.damage_runs} places belong to no valid frame"
    if result.packing_cut:
        text += "; the compressed file ends early, imported up to there"
    if result.cut:
        text += f"; the recording ends in a frame ({result.cut} bytes of it): imported up to the one before"
    return f"{text}; time: {result.log_time}"


def info(log: Log, types: Types = False, as_json: AsJson = False) -> None:
    """Report whether a flight log is complete and can be processed; show its links, gaps, fixes and clocks.

    Example: `acquire info flight.mcap`
    """
    from acquire.channels.summary import summarise
    from drivers.mavlink.dialect import ardupilotmega

    figures = summarise(log, ardupilotmega())
    answer(as_json, lambda: figures, lambda: _text(figures, types=types))


def _text(figures: dict[str, Any], *, types: bool) -> str:
    from acquire.channels.summary import verdict_lines

    lines = [*verdict_lines(figures["verdict"]), "", f"{figures['file']}: {figures['bytes']} bytes"]
    if not figures["complete"]:
        lines.append("  ends early: only its intact part is shown; acquire recover repairs it")
        if every := figures["metadata"].get("recording", {}).get("flush_s"):
            lines.append(f"  flushed to disk every {every} s: a power cut loses that and the time of a flush")
    for link in figures["links"]:
        lines += ["", *_link(link, types=types)]
        notes = figures["metadata"].get(f"import {link['link']}")
        if notes:
            lines.append(f"  source {notes['file']}, SHA-256 {notes['sha256']}")
            lines.append(f"  time: {notes['log_time']}")
    if figures["fixes"]:
        lines += ["", "fixes"]
        for receiver, counts in figures["fixes"].items():
            shares = ", ".join(f"{name} {count}" for name, count in counts.items())
            lines.append(f"  {receiver}: {shares}")
    for source, told in figures["mounting"].items():
        sender = source.split("/")[0]
        lines += ["", f"mounting, from {told['parameters']} parameters of {sender} (body axes)"]
        lines += mounting_lines(told)
    if not types:
        return "\n".join(lines)
    lines += ["", "topics"]
    for topic in figures["topics"]:
        kind = topic["schema"] or topic["encoding"]
        lines.append(f"  {topic['topic']:<34} {kind:<26} {topic['messages']:>8}")
    return "\n".join(lines)


def _link(link: dict[str, Any], *, types: bool) -> list[str]:
    gaps = link["gaps"]
    lines = [
        f"{link['link']}: {link['frames']} frames, {link['frame_bytes']} bytes in {link['duration_s']:.1f} s",
        f"  {link['damage_bytes']} bytes belong to no valid frame",
        f"  gaps over {gaps['longer_than_s']:g} s: {gaps['count']}, the longest {gaps['longest_s']:.2f} s",
    ]
    lines += [
        f"  source system {s['system']} component {s['component']}: {s['frames']} frames,"
        f" {s['missing_numbers']} more were sent and did not arrive"
        for s in link["sources"]
    ]
    if link["clock"]:
        lines.append(f"  clock: {link['clock']['verdict']}")
    if not types:
        return lines
    lines.append(f"  {'type':<34} {'frames':>8} {'rate Hz':>9} {'longest gap s':>14}")
    for kind in sorted(link["types"], key=lambda t: -t["frames"]):
        rate = "" if kind["rate_hz"] is None else f"{kind['rate_hz']:.2f}"
        gap = "" if kind["longest_gap_s"] is None else f"{kind['longest_gap_s']:.2f}"
        lines.append(f"  {kind['encoding'] + ' ' + kind['type']:<34} {kind['frames']:>8} {rate:>9} {gap:>14}")
    return lines


def replay(
    log: Log,
    to: Annotated[str, option("udp://HOST:PORT, tcp://HOST:PORT (waits for a reader) or pty.")],
    link: Link = None,
    speed: Annotated[float, option("Speed factor; 0: as fast as the receiver accepts.", min=0)] = 1.0,
    as_json: AsJson = False,
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
            + ("losses on the network are not known" if sent.lost is None else f"{sent.lost} lost")
        ),
    )


def recover(
    log: Annotated[Path, argument("Flight log (.mcap); it is not changed.")],
    output: Annotated[
        Path | None, option("Repaired log (default: NAME.recovered.mcap).", "-o", "--output")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Save every intact chunk of a flight log that was truncated or damaged.

    Example: `acquire recover flight.mcap -o repaired.mcap`
    """
    from acquire.importing.recovery import recover as repair

    target = output or log.with_suffix(".recovered.mcap")
    if target.resolve() == log.resolve():
        raise ConfigurationError(
            "the repaired log would overwrite the damaged one", "name another", where=target
        )
    result = repair(log, target)
    answer(
        as_json,
        lambda: {
            "schema": "acquire.recover/1",
            "file": str(log),
            "output": str(target),
            "messages": result.messages,
            "chunks": result.chunks,
            "had_its_end": result.complete,
            "damaged": list(result.damaged),
        },
        lambda: _recovered(result, log, target),
    )


def _recovered(result: "Recovered", log: Path, target: Path) -> str:
    if result.intact:
        return f"{log} was whole, {target} is a copy: {result.messages} messages"
    lines = [f"saved {result.messages} messages in {result.chunks} chunks to {target}"]
    if not result.complete:
        lines.append("the log was not closed: what was written after its last complete chunk is lost")
    lines += [f"skipped: {text}" for text in result.damaged]
    return "\n".join(lines)


def export(
    log: Log,
    output: Annotated[Path, option("Telemetry log to write (.tlog).", "-o", "--output")],
    link: Link = None,
    as_json: AsJson = False,
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

"""Commands about a flight log: import, info, replay, recover and export."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from acquire.channels.mounting import mounting_lines
from acquire.commands.texts import texts
from photocal.base.console import AsJson, Language, answer, argument, option
from photocal.base.errors import ConfigurationError
from photocal.base.progress_bars import progress
from photocal.base.sentences import Texts, spoken

if TYPE_CHECKING:
    from acquire.importing.importer import Imported

Log = Annotated[Path, argument("Flight log (.mcap).", metavar="FLIGHT.mcap")]
Link = Annotated[str | None, option("Name of the link, needed where the log has several.", metavar="NAME")]
Types = Annotated[bool, option("Also list frames by type, and the topics of the log.", "--types")]


def import_(
    output: Annotated[Path, option("Flight log to write (.mcap).", "-o", "--output")],
    files: Annotated[
        list[Path] | None,
        argument("Recordings: .tlog, .ubx, .rtcm3, .nmea, .bin, .ulg, .mrk; also gzipped.", metavar="FILE"),
    ] = None,
    link: Annotated[
        list[str] | None, option("Recording with the name of its link; may be repeated.", metavar="NAME=FILE")
    ] = None,
    date: Annotated[
        str | None, option("UTC date of the first data of streams that hold no date.", metavar="YYYY-MM-DD")
    ] = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Import recordings into one flight log: raw frames, and what is decoded from them.

    Example: `acquire import flight.tlog --link rover=rover.ubx --link base=base.ubx.gz -o flight.mcap`
    """
    from acquire.importing.importer import import_recordings
    from photocal.base.files import refuse_to_replace

    say = texts(spoken(language))
    named = [_named(text) for text in link or []]
    unnamed = files or []
    near_ns = _noon_ns(date)
    if not named and not unnamed:
        raise ConfigurationError("no recording was named", "give FILE or --link NAME=FILE")
    paths = [*unnamed, *(path for _, path in named)]
    refuse_to_replace(output)
    total = sum(path.stat().st_size for path in paths if path.is_file())
    with progress(say("progress.importing"), total, say.messages["progress.left"]) as advance:
        results = import_recordings(named, unnamed, output, advance, near_ns)
    for result in results:
        if result.warning:
            typer.echo(say("import.warning", link=result.link, warning=say.stored(result.warning)), err=True)
    answer(
        as_json,
        lambda: {
            "schema": "acquire.import/1",
            "output": str(output),
            "links": [result.as_json() for result in results],
        },
        lambda: "\n".join(
            [*(_sentence(result, say) for result in results), say("record.wrote", path=output)]
        ),
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


def _sentence(result: "Imported", say: Texts) -> str:
    tally, form = result.tally, say.stored(result.form.name)
    parts = [say("import.link", link=result.link, frames=tally.frames, path=result.path, form=form)]
    if tally.damage_bytes:
        parts.append(say("import.damage", size=tally.damage_bytes, places=tally.damage_runs))
    if result.packing_cut:
        parts.append(say("import.packing_cut"))
    if result.cut:
        parts.append(say("import.cut", size=result.cut))
    return "; ".join([*parts, say("import.time", source=say.stored(result.log_time))])


def info(log: Log, types: Types = False, language: Language = "", as_json: AsJson = False) -> None:
    """Report whether a flight log is complete and can be processed; show its links, gaps, fixes and clocks.

    Example: `acquire info flight.mcap`
    """
    from acquire.channels.summary import summarise

    say = texts(spoken(language))
    figures = summarise(log)
    answer(as_json, lambda: figures, lambda: _text(figures, say, types=types))


def _text(figures: dict[str, Any], say: Texts, *, types: bool) -> str:
    from acquire.channels.summary import verdict_lines

    file = say("info.file", file=figures["file"], size=figures["bytes"])
    lines = [*verdict_lines(figures["verdict"], say), "", file]
    if not figures["complete"]:
        lines.append(f"  {say('info.ends_early')}")
        if every := figures["metadata"].get("recording", {}).get("flush_s"):
            lines.append(f"  {say('info.flushed', every=every.replace('.', say.mark))}")
    for link in figures["links"]:
        lines += ["", *_link(link, say, types=types)]
        notes = figures["metadata"].get(f"import {link['link']}")
        if notes:
            lines.append(f"  {say('info.source', file=notes['file'], sha256=notes['sha256'])}")
            lines.append(f"  {say('info.time', source=say.stored(notes['log_time']))}")
    if figures["fixes"]:
        lines += ["", say("info.fixes")]
        for receiver, counts in figures["fixes"].items():
            shares = (say("info.fix", fix=say.stored(fix), count=count) for fix, count in counts.items())
            lines.append(f"  {receiver}: {', '.join(shares)}")
    for source, told in figures["mounting"].items():
        lines += ["", say("info.mounting", count=told["parameters"], sender=source.split("/")[0])]
        lines += mounting_lines(told, say)
    if not types:
        return "\n".join(lines)
    lines += ["", say("info.topics")]
    for topic in figures["topics"]:
        kind = topic["schema"] or topic["encoding"]
        lines.append(f"  {topic['topic']:<34} {kind:<26} {topic['messages']:>8}")
    return "\n".join(lines)


def _link(link: dict[str, Any], say: Texts, *, types: bool) -> list[str]:
    gaps = link["gaps"]
    told = [
        say("info.damage", count=link["damage_bytes"]),
        say(
            "info.pauses",
            limit=say.row([gaps["longer_than_s"]], "g"),
            count=gaps["count"],
            longest=say.row([gaps["longest_s"]], ".2f"),
        ),
    ]
    told += [say("info.sender", **sender) for sender in link["sources"]]
    if link["clock"]:
        told.append(say("info.clock", verdict=say.stored(link["clock"]["verdict"])))
    if types:
        heads = [say(f"info.{key}") for key in ("type", "frames", "rate_hz", "longest_gap_s")]
        told.append(_row(*heads))
    for kind in sorted(link["types"] if types else (), key=lambda t: -t["frames"]):
        rate, gap = (
            "" if kind[key] is None else say.row([kind[key]], ".2f") for key in ("rate_hz", "longest_gap_s")
        )
        told.append(_row(f"{kind['encoding']} {kind['type']}", str(kind["frames"]), rate, gap))
    duration = say.row([link["duration_s"]], ".1f")
    head = say(
        "info.link", link=link["link"], frames=link["frames"], size=link["frame_bytes"], duration=duration
    )
    return [head, *map("  ".__add__, told)]


def _row(kind: str, frames: str, rate: str, gap: str) -> str:
    return f"{kind:<33} {frames:>9} {rate:>9} {gap:>14}"


def replay(
    log: Log,
    to: Annotated[
        str, option("Destination: udp://HOST:PORT, tcp://HOST:PORT (waits for a connection) or pty.")
    ],
    link: Link = None,
    speed: Annotated[float, option("Speed factor; 0: as fast as the destination accepts.", min=0)] = 1.0,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Send the raw frames of a link, byte for byte and in their order.

    Example: `acquire replay flight.mcap --link vehicle --to udp://127.0.0.1:14550 --speed 10`
    """
    import time

    from acquire.log import replay as replaying
    from acquire.transports.sinks import open_sink

    say = texts(spoken(language))
    name = replaying.choose_link(log, link)
    with open_sink(to) as (sink, address):
        typer.echo(say("replay.begins", link=name, address=address), err=True)
        if not address.startswith("udp:"):
            typer.echo(say("replay.waits"), err=True)
        sent = replaying.replay(log, name, sink, speed, time.monotonic, time.sleep)
    answer(
        as_json,
        lambda: {"schema": "acquire.replay/1", "link": name, **sent},
        lambda: say(
            "replay.sent",
            frames=sent["frames"],
            size=sent["bytes"],
            duration=say.row([sent["recorded_s"]], ".1f"),
            lost=say("replay.unknown") if sent["lost"] is None else say("replay.lost", count=sent["lost"]),
        ),
    )


def recover(
    log: Annotated[Path, argument("Flight log (.mcap); it is not changed.", metavar="FLIGHT.mcap")],
    output: Annotated[
        Path | None, option("Repaired log (default: NAME.recovered.mcap).", "-o", "--output")
    ] = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Save every intact chunk of a flight log that was truncated or damaged.

    Example: `acquire recover flight.mcap -o repaired.mcap`
    """
    from acquire.importing.recovery import recover as repair
    from photocal.base.files import refuse_to_replace

    say = texts(spoken(language))
    target = output or log.with_suffix(".recovered.mcap")
    refuse_to_replace(target)
    result = repair(log, target)
    answer(
        as_json,
        lambda: {
            "schema": "acquire.recover/1",
            "file": str(log),
            "output": str(target),
            **result,
        },
        lambda: _recovered(result, log, target, say),
    )


def _recovered(result: dict[str, Any], log: Path, target: Path, say: Texts) -> str:
    if result["had_its_end"] and not result["damaged"]:
        return say("recover.whole", log=log, copy=target, count=result["messages"])
    lines = [say("recover.saved", count=result["messages"], chunks=result["chunks"], copy=target)]
    if not result["had_its_end"]:
        lines.append(say("recover.not_closed"))
    lines += [say("recover.skipped", damage=say.refused(damage)) for damage in result["damaged"]]
    return "\n".join(lines)


def export(
    log: Log,
    output: Annotated[Path, option("Telemetry log to write (.tlog).", "-o", "--output")],
    link: Link = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Write the vehicle's link as a telemetry log that ground stations and pymavlink read.

    Example: `acquire export flight.mcap --link vehicle -o flight.tlog`
    """
    from acquire.log.replay import choose_link, export_tlog
    from photocal.base.files import refuse_to_replace

    say = texts(spoken(language))
    refuse_to_replace(output)
    name = choose_link(log, link)
    count = export_tlog(log, name, output)
    answer(
        as_json,
        lambda: {"schema": "acquire.export/1", "link": name, "frames": count, "output": str(output)},
        lambda: say("export.wrote", link=name, frames=count, path=output),
    )

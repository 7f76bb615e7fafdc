"""`acquire info`: what a flight log holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from acquire.channels.mounting import mounting_of
from acquire.console import answer

if TYPE_CHECKING:
    from acquire.log.summary import LogSummary


def info(
    log: Annotated[Path, typer.Argument(help="Flight log (.mcap).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Show links, frames by type, rates, gaps, damage, fixes, sources and clocks of a flight log.

    Example: `acquire info flight.mcap`
    """
    from acquire.log.summary import summarise
    from drivers.mavlink.dialect import ardupilotmega

    summary = summarise(log, ardupilotmega())
    answer(as_json, summary.as_json, lambda: _text(summary))


def _text(summary: LogSummary) -> str:
    figures = summary.as_json()
    lines = [f"{figures['file']}: {figures['bytes']} bytes"]
    if not figures["complete"]:
        lines.append("  ends early: this is what is whole in it; acquire recover repairs it")
    for link in figures["links"]:
        lines += ["", *_link(link)]
        notes = figures["metadata"].get(f"import {link['link']}")
        if notes:
            lines.append(f"  source {notes['file']}, SHA-256 {notes['sha256']}")
            lines.append(f"  time: {notes['log_time']}")
    if figures["fixes"]:
        lines += ["", "fixes"]
        for receiver, counts in figures["fixes"].items():
            shares = ", ".join(f"{name} {count}" for name, count in counts.items())
            lines.append(f"  {receiver}: {shares}")
    for source, told in summary.parameters.items():
        lines += ["", f"mounting as {len(told)} parameters of {source.split('/')[0]} tell it (body axes)"]
        lines += mounting_of(told).lines()
    lines += ["", "topics"]
    for topic in figures["topics"]:
        kind = topic["schema"] or topic["encoding"]
        lines.append(f"  {topic['topic']:<34} {kind:<26} {topic['messages']:>8}")
    return "\n".join(lines)


def _link(link: dict[str, Any]) -> list[str]:
    gaps = link["gaps"]
    lines = [
        f"{link['link']}: {link['frames']} frames, {link['frame_bytes']} bytes in {link['duration_s']:.1f} s",
        f"  {link['damage_bytes']} bytes belong to no valid frame",
        f"  {gaps['count']} gaps over {gaps['longer_than_s']:g} s, the longest {gaps['longest_s']:.2f} s",
    ]
    lines += [
        f"  source system {s['system']} component {s['component']}: {s['frames']} frames,"
        f" {s['missing_numbers']} numbers missing"
        for s in link["sources"]
    ]
    if link["clock"]:
        lines.append(f"  clock: {link['clock']['verdict']}")
    lines.append(f"  {'type':<34} {'frames':>8} {'rate Hz':>9} {'longest gap s':>14}")
    for kind in sorted(link["types"], key=lambda t: -t["frames"]):
        rate = "" if kind["rate_hz"] is None else f"{kind['rate_hz']:.2f}"
        gap = "" if kind["longest_gap_s"] is None else f"{kind['longest_gap_s']:.2f}"
        lines.append(f"  {kind['encoding'] + ' ' + kind['type']:<34} {kind['frames']:>8} {rate:>9} {gap:>14}")
    return lines

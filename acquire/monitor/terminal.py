"""The live view in a terminal."""

import datetime as dt
import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from rich.console import Group, RenderableType
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from acquire.monitor.state import ShownAlarm
from acquire.monitor.view_model import MapLayer, PageView, Row, Word
from photocal.base.arrays import Floats, Integers, picked
from photocal.base.console import printable
from photocal.base.geodesy import enu_offsets
from photocal.base.sentences import Texts
from photocal.base.time_scales import SECOND_NS

# Dots of a Braille cell by column and row (Unicode 15, chapter 21.1).
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
_BRAILLE_SIGNS = {"missed": ("✕", "bold red"), "station": ("▲", "green")}
_TRACK, _PICTURE, _HERE = "blue", "bold", "bold blue"


def braille_map(layers: Sequence[MapLayer], say: Texts, width: int, height: int) -> Text:
    """Draw layers, north up."""
    # The Braille cell without dots.
    blank = 0x2800
    # A vehicle that stands is not blown up to fill the map.
    least_extent_m = 20.0
    rows = height - 1
    drawn = [layer for layer in layers if len(layer.points)]
    if not drawn or width < 8 or rows < 2:
        return Text("\n" * (rows // 2) + say("monitor.no_position").center(width), style="dim")
    shown = [layer for layer in drawn if layer.kind != "station"] or drawn
    places = metres(np.concatenate([layer.points for layer in shown]), drawn[0].points[0])
    low, high = places.min(axis=0), places.max(axis=0)
    extent = np.maximum(high - low, least_extent_m)
    dots_per_m = min((2 * width - 3) / extent[0], (4 * rows - 3) / extent[1])
    middle = (low + high) / 2

    def dots(layer: MapLayer) -> Floats:
        """Places of a layer in dots of the terminal's map."""
        away = (metres(layer.points, drawn[0].points[0]) - middle) * dots_per_m
        return np.column_stack([width - 0.5 + away[:, 0], 2 * rows - 0.5 - away[:, 1]])

    cells = np.full((rows, width), blank, np.int64)
    styles: dict[tuple[int, int], str] = {}
    signs: dict[tuple[int, int], tuple[str, str]] = {}
    for layer in drawn:
        at = dots(layer)
        if layer.kind == "track":
            _line(cells, styles, at)
            signs |= dict.fromkeys(_cells(at[-1:], cells.shape), ("◆", _HERE))
        elif layer.kind == "picture":
            styles |= dict.fromkeys(_cells(at, cells.shape), _PICTURE)
            _set(cells, at)
    for layer in drawn:
        if layer.kind in _BRAILLE_SIGNS:
            signs |= dict.fromkeys(_cells(dots(layer), cells.shape), _BRAILLE_SIGNS[layer.kind])
    text = Text()
    for row in range(rows):
        for column in range(width):
            key = (row, column)
            sign, style = signs.get(key, (chr(cells[row, column]), styles.get(key, "")))
            text.append(" " if sign == chr(blank) else sign, style)
        text.append("\n")
    return text.append(_scale_bar(width, dots_per_m))


def metres(points: Floats, origin: Floats) -> Floats:
    """Return metres east and north of an origin."""
    level = np.zeros(len(points))
    return enu_offsets(points[:, 0], points[:, 1], level, np.append(origin, 0.0))[:, :2]


def round_step(value: float) -> float:
    """Return the greatest of 1, 2, 5, 10, 20... that is not above a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (5, 2, 1) if factor * power <= value * (1 + 1e-9))


def _line(cells: Integers, styles: dict[tuple[int, int], str], at: Floats) -> None:
    for start, end in pairwise(at):
        steps = max(int(np.ceil(np.abs(end - start).max())), 1)
        between = start + (end - start) * np.linspace(0, 1, steps + 1)[:, None]
        _set(cells, between)
        styles |= dict.fromkeys(_cells(between, cells.shape), _TRACK)
    _set(cells, at)


def _set(cells: Integers, at: Floats) -> None:
    for x, y in np.rint(at).astype(int).tolist():
        if 0 <= y // 4 < cells.shape[0] and 0 <= x // 2 < cells.shape[1]:
            cells[y // 4, x // 2] |= _DOTS[x % 2][y % 4]


def _cells(at: Floats, shape: tuple[int, ...]) -> list[tuple[int, int]]:
    places = [(y // 4, x // 2) for x, y in np.rint(at).astype(int).tolist()]
    return [(row, column) for row, column in places if 0 <= row < shape[0] and 0 <= column < shape[1]]


def _scale_bar(width: int, dots_per_m: float) -> Text:
    step = round_step(width / 3 * 2 / dots_per_m)
    cells = max(round(step * dots_per_m / 2), 2)
    label = f"{step / 1000:g} km" if step >= 1000 else f"{step:g} m"
    bar = f"├{'─' * (cells - 2)}┤ {label}"
    return Text(bar + "N ↑".rjust(max(width - len(bar), 4)), style="bold")


# Sign and word differ as well as the colour.
_SIGNS = {"good": "✓", "warn": "▲", "bad": "✕", "off": "·", "note": "–"}
_STYLES = {"good": "bold green", "warn": "bold black on yellow", "bad": "bold white on red"}
# What has been is quieter than what is.
_PAST = {"warn": "yellow", "bad": "bold red"}
_LEAST_WITH_MAP, _MAP_SHARE, _LEAST_MAP = 76, 0.27, 20


def render(view: PageView, layers: Sequence[MapLayer], say: Texts, width: int, height: int) -> RenderableType:
    """Return the view for a window, in the language of `say`."""
    map_width = max(_LEAST_MAP, round(_MAP_SHARE * width)) if width >= _LEAST_WITH_MAP else 0
    left = width - map_width - (2 if map_width else 0)
    sections = _sections(view, say, left)
    used = 1 + len(sections)
    room = max(height - used - 2, 1)
    figures = Group(*sections, _heading(say("monitor.alarms")), _alarms(view.alarms, say, room))
    if not map_width:
        return Group(_head(view, say), figures)
    both = Table.grid(padding=(0, 2, 0, 0))
    both.add_column(width=left)
    both.add_column(width=map_width)
    both.add_row(figures, braille_map(layers, say, map_width, height - 1))
    return Group(_head(view, say), both)


def _sections(view: PageView, say: Texts, width: int) -> list[RenderableType]:
    """Return headings and lines, each one line high."""
    # Longer names are cut, so that the figures keep their place.
    longest_name = 12
    sections: list[RenderableType] = []
    names = [row["name"] for row in (*view.receivers, *view.links)]
    wide = min(max(map(len, [say("monitor.disk"), *names])), longest_name)
    groups: dict[str, Sequence[str | Text]] = {
        "fix": [_receiver(row, say, wide) for row in view.receivers] or [say("monitor.no_receiver")],
        "pictures": [_camera(row, say, wide) for row in view.cameras] or [say("monitor.no_picture")],
        "links": [_link(row, say, wide) for row in view.links] or [say("monitor.no_link")],
        "rest": _rest(view, say, wide),
    }
    for heading, lines in groups.items():
        sections.append(_heading(say(f"monitor.{heading}")))
        sections += [_cut(line, width) for line in lines]
    return sections


def _head(view: PageView, say: Texts) -> RenderableType:
    line = Table.grid(expand=True)
    line.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    line.add_column(justify="right", no_wrap=True)
    name = Text.assemble(_word(view.overall, say), "  ", view.file)
    line.add_row(name, Text(duration(view.duration_s), style="bold"))
    return line


def _receiver(row: Row, say: Texts, wide: int) -> Text:
    parts = [_name(row["name"], wide), _word(row["fix"], say)]
    if row["satellites"] is not None:
        parts.append(Text("  " + say("monitor.satellites", count=row["satellites"])))
    if (miss := row["horizontal_m"]) is not None:
        parts.append(
            Text("  " + (f"{say.row([miss * 100], '.1f')} cm" if miss < 1 else f"{say.row([miss], '.1f')} m"))
        )
    if row["correction_age_s"] is not None:
        parts += [Text(f"  {say('monitor.corrections')} "), _word(row["correction"], say)]
    return Text.assemble(*parts)


def _camera(row: Row, say: Texts, wide: int) -> Text:
    told = [say("monitor.counts", **picked(row, "triggered", "reported"))] if row["triggered"] else []
    told += [say("monitor.marks", count=row["time_marks"])] if row["time_marks"] else []
    return Text.assemble(_name(row["link"], wide), _word(row["state"], say), *map("  ".__add__, told))


def _link(row: Row, say: Texts, wide: int) -> Text:
    count, longest = row["gaps"], f"{row['longest_gap_s']:.0f}"
    told = [f"{say.row([row['frames_per_s']], '.1f')}/s", f"{size(row['bytes_per_s'], say)}/s"]
    key = "monitor.no_gaps" if not count else "monitor.gap" if count == 1 else "monitor.gaps"
    told.append(say(key, count=count, longest=longest))
    if row["damage_bytes"]:
        told.append(say("monitor.damaged", size=size(row["damage_bytes"], say)))
    return Text.assemble(_name(row["name"], wide), _word(row["state"], say), *map("  ".__add__, told))


def _rest(view: PageView, say: Texts, wide: int) -> list[Text]:
    log = say("monitor.log", size=size(view.bytes, say))
    lines = [Text.assemble(_name(say("monitor.disk"), wide), _word(view.disk["state"], say), f"  {log}")]
    batteries = {row["link"]: row["state"] for row in view.batteries}
    clocks = {row["link"]: row["state"] for row in view.clocks}
    vehicles = {row["link"]: row for row in view.vehicles}
    for link in sorted({*batteries, *clocks, *vehicles}):
        parts: list[str | Text] = [_name(link, wide)]
        if link in vehicles:
            height_m = vehicles[link]["height_m"]
            parts += [_word(vehicles[link]["mode"], say), "  "]
            parts += [] if height_m is None else [Text(f"{height_m:.0f} m", style="bold"), "  "]
        parts += [_word(batteries[link], say), "  "] if link in batteries else []
        parts += [f"{say('monitor.clock')} ", _word(clocks[link], say)] if link in clocks else []
        lines.append(Text.assemble(*parts))
    return lines


def _alarms(alarms: Sequence[ShownAlarm], say: Texts, room: int) -> RenderableType:
    if not alarms:
        return Text(say("monitor.none"), style="dim")
    lines = []
    for alarm in alarms[: -room - 1 : -1]:
        time = dt.datetime.fromtimestamp(alarm.time_ns / SECOND_NS, dt.UTC).strftime("%H:%M:%S ")
        text = say.stored(alarm.text)
        text = printable(f"{alarm.link}: {text}" if alarm.link else text)
        said = (f"{_SIGNS[alarm.level]} {text}", "dim" if alarm.ended else _PAST.get(alarm.level, ""))
        line = Text.assemble(
            (time, "dim"), said, (f" ({say(f'monitor.{alarm.ended}')})" if alarm.ended else "", "dim")
        )
        line.no_wrap, line.overflow = True, "ellipsis"
        lines.append(line)
    return Group(*lines)


def _heading(text: str) -> Rule:
    return Rule(Text(text), align="left", style="dim")


def _name(text: str, width: int) -> Text:
    text = printable(text)
    short = text if len(text) <= width else f"{text[: width - 1]}…"
    return Text(f"{short:<{width}} ", style="bold")


def _word(word: Word, say: Texts) -> Text:
    return Text(f"{_SIGNS[word.level]} {printable(say.stored(word.text))}", style=_STYLES.get(word.level, ""))


def _cut(line: str | Text, width: int) -> Text:
    text = Text(line, style="dim") if isinstance(line, str) else line
    text.truncate(width, overflow="ellipsis")
    return text


def duration(seconds: float) -> str:
    """Return hours, minutes and seconds: ``"1:02:03"``."""
    whole = max(int(seconds), 0)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


def size(count: float, say: Texts) -> str:
    """Return a size in bytes with its decimal unit."""
    for unit, limit in (("B", 1e3), ("kB", 1e6), ("MB", 1e9)):
        if count < limit:
            return f"{say.row([count / (limit / 1e3)], '.0f' if unit == 'B' else '.1f')} {unit}"
    return f"{say.row([count / 1e9], '.1f')} GB"

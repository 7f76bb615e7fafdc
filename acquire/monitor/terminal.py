"""The live view in a terminal."""

import datetime as dt
import math
import sys
import textwrap
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from rich.console import Group, RenderableType
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from acquire.monitor.state import ShownAlarm
from acquire.monitor.view_model import MapLayer, PageView, Row, Word
from photocal.base.arrays import Floats, Integers
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
# The map is to the right of the figures, which have the width of a common window.
_FIGURES_WIDTH, _MAP_SHARE, _LEAST_MAP = 80, 0.27, 20
# What a line of figures is made of: the name of a device, and what is said of it.
_Line = tuple[str, list[Text]]


def render(view: PageView, layers: Sequence[MapLayer], say: Texts, width: int, height: int) -> RenderableType:
    """Return the view for a window, in the language of `say`."""
    # Between figures and map.
    gap = 2
    map_width = min(round(_MAP_SHARE * width), width - gap - _FIGURES_WIDTH)
    left = width - map_width - gap if map_width >= _LEAST_MAP else width
    # Beside the figures there are the head and, at least, a heading and a line of alarms.
    sections = _sections(view, say, left)
    if len(sections) > height - 4:
        sections = _sections(view, say, sys.maxsize)
    for line in sections:
        if isinstance(line, Text):
            line.truncate(left, overflow="ellipsis")
    room = max(height - len(sections) - 3, 1)
    figures = Group(*sections, _heading(say("monitor.alarms")), *(_alarms(view.alarms, say, left, room)))
    if left == width:
        return Group(_head(view, say), figures)
    both = Table.grid(padding=(0, gap, 0, 0))
    both.add_column(width=left)
    both.add_column(width=map_width)
    both.add_row(figures, braille_map(layers, say, map_width, height - 1))
    return Group(_head(view, say), both)


def _sections(view: PageView, say: Texts, width: int) -> list[Rule | Text]:
    """Return headings and lines, each one line high."""
    # Longer names are cut, so that the figures keep their place.
    longest_name = 12
    sections: list[Rule | Text] = []
    names = [row["name"] for row in (*view.receivers, *view.links)]
    wide = min(max(map(len, [say("monitor.disk"), *names])), longest_name)
    groups: dict[str, list[_Line]] = {
        "fix": [_receiver(row, say) for row in view.receivers],
        "pictures": [_camera(row, say) for row in view.cameras],
        "links": [_link(row, say) for row in view.links],
        "rest": _rest(view, say),
    }
    for heading, lines in groups.items():
        sections.append(_heading(say(f"monitor.{heading}")))
        for name, parts in lines:
            sections += _packed(_name(name, wide), parts, width)
        if not lines:
            sections.append(Text(say(f"monitor.no_{heading}"), style="dim"))
    return sections


def _packed(name: Text, parts: Sequence[Text], width: int) -> list[Text]:
    """Put parts behind a name; what does not fit into the line stands below, under the first part."""
    lines = [Text.assemble(name, parts[0])]
    for part in parts[1:]:
        if lines[-1].cell_len + 2 + part.cell_len <= width:
            lines[-1] = Text.assemble(lines[-1], "  ", part)
        else:
            lines.append(Text.assemble(" " * name.cell_len, part))
    return lines


def _head(view: PageView, say: Texts) -> RenderableType:
    line = Table.grid(expand=True, padding=(0, 1, 0, 0))
    line.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    line.add_column(justify="right", no_wrap=True)
    name = Text.assemble(_word(view.overall, say), "  ", view.file)
    line.add_row(name, Text(duration(view.duration_s), style="bold"))
    return line


def _receiver(row: Row, say: Texts) -> _Line:
    parts = [_word(row["fix"], say)]
    if row["satellites"] is not None:
        parts.append(Text(say("monitor.satellites", count=row["satellites"])))
    if (miss := row["horizontal_m"]) is not None:
        factor, unit = (100, "cm") if miss < 1 else (1, "m")
        parts.append(Text(f"{say.row([miss * factor], '.1f')} {unit}"))
    if row["correction_age_s"] is not None:
        parts.append(Text.assemble(say("monitor.corrections"), " ", _word(row["correction"], say)))
    return row["name"], parts


def _camera(row: Row, say: Texts) -> _Line:
    counts = {key: row[key] for key in ("triggered", "reported")}
    told = [say("monitor.counts", **counts)] if row["triggered"] else []
    told += [say("monitor.marks", count=row["time_marks"])] if row["time_marks"] else []
    return row["link"], [_word(row["state"], say), *map(Text, told)]


def _link(row: Row, say: Texts) -> _Line:
    told = list[str]()
    if row["frames_per_s"]:
        told = [f"{say.row([row['frames_per_s']], '.1f')}/s", f"{size(row['bytes_per_s'], say)}/s"]
    longest = f"{row['longest_gap_s']:.0f}"
    told.append(
        say("monitor.gaps", count=row["gaps"], longest=longest) if row["gaps"] else say("monitor.no_gaps")
    )
    if row["damage_bytes"]:
        told.append(say("monitor.damaged", size=size(row["damage_bytes"], say)))
    return row["name"], [_word(row["state"], say), *map(Text, told)]


def _rest(view: PageView, say: Texts) -> list[_Line]:
    log = Text(say("monitor.log", size=size(view.bytes, say)))
    lines: list[_Line] = [(say("monitor.disk"), [_word(view.disk["state"], say), log])]
    batteries = {row["link"]: row["state"] for row in view.batteries}
    clocks = {row["link"]: row["state"] for row in view.clocks}
    vehicles = {row["link"]: row for row in view.vehicles}
    for link in sorted({*batteries, *clocks, *vehicles}):
        parts = list[Text]()
        if link in vehicles:
            height_m = vehicles[link]["height_m"]
            parts.append(_word(vehicles[link]["mode"], say))
            parts += [] if height_m is None else [Text(f"{round(height_m)} m", style="bold")]
        parts += [_word(batteries[link], say)] if link in batteries else []
        if link in clocks:
            parts.append(Text.assemble(say("monitor.clock"), " ", _word(clocks[link], say)))
        lines.append((link, parts))
    return lines


def _alarms(alarms: Sequence[ShownAlarm], say: Texts, width: int, room: int) -> list[Text]:
    """Say the last alarms, the newest first, in so many lines."""
    if not alarms:
        return [Text(say("monitor.none"), style="dim")]
    lines = list[Text]()
    for alarm in reversed(alarms):
        time = dt.datetime.fromtimestamp(alarm.time_ns / SECOND_NS, dt.UTC).strftime("%H:%M:%S ")
        text = say.stored(alarm.text)
        text = (
            f"{_SIGNS[alarm.level]} {alarm.link}: {text}" if alarm.link else f"{_SIGNS[alarm.level]} {text}"
        )
        text += f" ({say(f'monitor.{alarm.ended}')})" if alarm.ended else ""
        pieces = textwrap.wrap(
            printable(text), max(width - len(time), 2), max_lines=None if lines else room, placeholder="…"
        )
        if len(lines) + len(pieces) > room:
            break
        style = "dim" if alarm.ended else _PAST.get(alarm.level, "")
        for start, piece in zip([time, *[" " * len(time)] * len(pieces)], pieces, strict=False):
            lines.append(Text.assemble((start, "dim"), (piece, style)))
    return lines


def _heading(text: str) -> Rule:
    return Rule(Text(text), align="left", style="dim")


def _name(text: str, width: int) -> Text:
    text = printable(text)
    short = text if len(text) <= width else f"{text[: width - 1]}…"
    return Text(f"{short:<{width}} ", style="bold")


def _word(word: Word, say: Texts) -> Text:
    return Text(f"{_SIGNS[word.level]} {printable(say.stored(word.text))}", style=_STYLES.get(word.level, ""))


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

"""The view in a terminal: the same words as on the page, in any window."""

from __future__ import annotations

import io
import time
from dataclasses import replace

import numpy as np
import pytest
from pyproj import Geod
from rich.console import Console

from acquire.commands.texts import texts
from acquire.monitor.state import (
    Battery,
    ComputerState,
    CountedPictures,
    LinkState,
    ReceiverState,
    RecordingState,
    Track,
    Trigger,
    raised,
)
from acquire.monitor.terminal import braille_map, metres, render, round_step
from acquire.monitor.view_model import MapLayer, layers, view_of

SECOND = 1_000_000_000
NOW = time.time_ns()


@pytest.fixture
def state() -> RecordingState:
    """A field with troubles of every kind."""
    rate = tuple((NOW // SECOND - n, 20, 4000) for n in range(6, -1, -1))
    heard = LinkState(1000, 50_000, 0, NOW - 100 * SECOND, NOW, rate, clock_offset_s=0.01)
    lost = LinkState(900, 40_000, 120, NOW - 100 * SECOND, NOW - 9 * SECOND, (), 2, 5 * SECOND, "silent", NOW)
    fixed = ReceiverState("rover", "rtk_fixed", 19, 0.014, None, NOW, "rtk_fixed", NOW)
    none = ReceiverState("vehicle", "none", 4, None, None, NOW, "none", NOW)
    north = np.linspace(0, 0.002, 50)
    track = Track(np.column_stack([47.5 + north, np.full(50, 8.5)]), NOW + np.arange(50))
    made = RecordingState(
        flight="flight-20260501T090000Z.mcap",
        first_ns=NOW - 3725 * SECOND,
        last_ns=NOW,
        links={"vehicle": heard, "rover": heard, "base": lost},
        receivers={"rover": fixed, "vehicle": none},
        exposures={"vehicle": CountedPictures(30, 27, missed=(Trigger(7, NOW, (47.501, 8.5)),))},
        tracks={"vehicle/position": track},
        pictures={("vehicle", "feedback"): Track(track.points[::10], track.times_ns[::10])},
        batteries={"vehicle": Battery(15.8, 81, NOW)},
        look=ComputerState(NOW, "flight-20260501T090000Z.mcap", 10**6, ended=False, free_bytes=10**8),
        grown_ns=NOW,
    )
    return raised(made, "bad", "base", "no data for more than 3 s", NOW)


def text_of(state: RecordingState, width: int, height: int, language: str = "en") -> list[str]:
    console = Console(width=width, height=height, file=io.StringIO(), record=True, force_terminal=True)
    console.print(render(view_of(state), layers(state), texts(language), width, height))
    return console.export_text().splitlines()


WORDS = [
    "✕ base: no data",
    "1:02:05",
    "RTK fixed",
    "no fix",
    "1 missed: 7",
    "no data for 9 s",
    "20.0/s",
    "0.1 GB free",
]


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 40), (60, 20), (200, 60)])
def test_what_matters_is_there_in_every_window(state: RecordingState, width: int, height: int) -> None:
    lines = text_of(state, width, height)
    shown = "\n".join(lines)
    for word in WORDS:
        assert word in shown
    assert "no data for more than 3 s" in shown
    assert len(lines) <= height
    assert max(map(len, lines)) <= width


def test_the_view_is_said_in_portuguese_and_not_cut(state: RecordingState) -> None:
    """As wide as common windows are, and with more to say than a line of them holds."""
    link = replace(
        state.links["base"], damage_bytes=286_780, last_ns=NOW, trouble="", recent=state.links["rover"].recent
    )
    marks = CountedPictures(0, 20, missed=tuple(Trigger(n, NOW, None) for n in range(30, 36)))
    field = replace(state, links={**state.links, "base": link}, marks={"vehicle": marks})
    lines = text_of(field, 80, 40, "pt-BR")
    shown = "\n".join(lines)
    for words in (
        "solução ───",
        "imagens ───",
        "enlaces ───",
        "computador e aeronave ───",
        "alarmes (UTC) ───",
        "✓ RTK fixo  19 sat.  1,4 cm",
        "✕ sem solução  4 sat.",
        "✕ perdidas: 1 (7), marcas de tempo que faltam: 6 (30-35)",
        "30 disparos, 27 respostas  20 marcas",
        "✓ recebendo  20,0/s  4,0 kB/s  2 pausas de até 5 s  286,8 kB danificados",
        "disco   ✕ 0,1 GB livres  registro 1,0 MB",
        "✓ 15,8 V, 81 %  relógio ✓ em sincronia (+0,01 s)",
        "base: sem dados há mais de 3 s",
    ):
        assert words in shown
    assert max(map(len, lines)) <= 80
    assert "…" not in shown


def test_a_long_alarm_goes_on_below(state: RecordingState) -> None:
    addresses = "10.0.0.17:14550, before 10.0.0.16:14550"
    moved = f"data come from another address: {addresses} (3 times: do several senders share the port?)"
    lines = text_of(raised(state, "warn", "vehicle", moved, NOW), 80, 30)
    first = next(n for n, line in enumerate(lines) if "data come" in line)
    told = " ".join(line[9:].strip() for line in lines[first : first + 2])
    assert told == f"▲ vehicle: {moved}"


@pytest.mark.parametrize(("width", "height"), [(40, 12), (30, 8), (20, 5)])
def test_a_tiny_window_is_cut_and_not_broken(state: RecordingState, width: int, height: int) -> None:
    lines = text_of(state, width, height)
    assert max(map(len, lines)) <= width
    assert "RTK fixed" in "\n".join(lines)


def test_levels_are_told_by_sign_as_well_as_by_colour(state: RecordingState) -> None:
    shown = "\n".join(text_of(state, 80, 24))
    assert "✓ RTK fixed" in shown
    assert "✕ no fix" in shown
    assert "✕ 0.1 GB free" in shown


def test_nothing_yet_is_said_in_words() -> None:
    shown = "\n".join(text_of(RecordingState(), 110, 24))
    for word in (
        "waiting for a recording",
        "no data from a receiver yet",
        "no data on any link yet",
        "no position yet",
    ):
        assert word in shown


def test_the_sketch_is_north_up_and_to_scale() -> None:
    """A square of 100 m: as wide as high in dots, and the scale bar agrees."""
    geod = Geod(ellps="WGS84")
    corners = [(8.5, 47.5)]
    for azimuth in (90, 0, 270):
        longitude, latitude, _ = geod.fwd(*corners[-1], azimuth, 100)
        corners.append((longitude, latitude))
    points = np.array([[latitude, longitude] for longitude, latitude in [*corners, corners[0]]])
    lines = braille_map([MapLayer("track", "a", points, "")], texts("en"), 40, 21).plain.splitlines()
    inked = [
        (row, column)
        for row, line in enumerate(lines[:-1])
        for column, sign in enumerate(line)
        if sign != " "
    ]
    rows, columns = {row for row, _ in inked}, {column for _, column in inked}
    high, wide = max(rows) - min(rows) + 1, max(columns) - min(columns) + 1
    assert wide == pytest.approx(2 * high, abs=2)
    bar = lines[-1].split("┤")[0]
    length = float(lines[-1].split("┤ ")[1].split(" m")[0])
    assert length in (20, 50)
    assert len(bar) + 1 == pytest.approx(wide * length / 100, abs=1)
    assert lines[-1].rstrip().endswith("N ↑")


@pytest.mark.parametrize("latitude", [-60.0, 0.0, 47.5, 80.0])
def test_metres_are_those_of_the_ellipsoid(latitude: float) -> None:
    geod = Geod(ellps="WGS84")
    for azimuth in range(0, 360, 45):
        longitude, end, _ = geod.fwd(179.999, latitude, azimuth, 500)
        east, north = metres(np.array([[end, longitude]]), np.array([latitude, 179.999]))[0]
        assert np.hypot(east, north) == pytest.approx(500, rel=3e-4)
        assert np.degrees(np.arctan2(east, north)) % 360 == pytest.approx(azimuth, abs=0.05)


@pytest.mark.parametrize(
    ("value", "step"), [(1, 1), (1.9, 1), (2, 2), (4.99, 2), (5, 5), (99, 50), (0.3, 0.2)]
)
def test_round_steps(value: float, step: float) -> None:
    assert round_step(value) == pytest.approx(step)

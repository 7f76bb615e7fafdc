"""The state from messages alone: what it counts and raises; how chunks are cut leaves no trace."""

from __future__ import annotations

import io
import json
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rich.console import Console

from acquire.channels.layouts import CLOCK, EXPOSURE, GNSS_STATUS, HEALTH, STATION
from acquire.commands.texts import texts
from acquire.importing.importer import import_recordings
from acquire.log.chunk import Channel
from acquire.log.reader import LoggedMessages, LogReader
from acquire.monitor.reducer import state_after
from acquire.monitor.state import LONGEST, Battery, ComputerState, RecordingState, Track, extended, place_at
from acquire.monitor.terminal import render
from acquire.monitor.traffic import looked
from acquire.monitor.view_model import Word, layers, view_of
from acquire.recording.alarms import ALARM
from drivers.mavlink.decode import encode
from drivers.mavlink.dialect import ardupilotmega

SECOND = 1_000_000_000
START = 1_777_626_000 * SECOND


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, demo_flight: bytes) -> Path:
    folder = tmp_path_factory.mktemp("reduced")
    source, made = folder / "flight.tlog", folder / "flight.mcap"
    source.write_bytes(demo_flight)
    import_recordings([], [source], made, lambda _: None)
    return made


def chunks(path: Path) -> list[list[LoggedMessages]]:
    return list(LogReader(path).chunks())


def reduced(parts: list[list[LoggedMessages]]) -> RecordingState:
    state = RecordingState()
    for part in parts:
        state = state_after(state, part)
    return state


def rows(topic: str, layout: Any, *messages: dict[str, Any], every_s: float = 1.0) -> LoggedMessages:
    """Return messages of one channel, one after the other."""
    payloads = [json.dumps(message).encode() for message in messages]
    times = START + np.round(np.arange(len(messages)) * every_s * SECOND).astype(np.int64)
    channel = Channel(topic, "json", layout.schema())
    return LoggedMessages(channel, payloads, times, times, np.arange(len(messages)))


def raw(link: str, seconds: list[float], size: int = 10) -> LoggedMessages:
    times = START + np.round(np.array(seconds) * SECOND).astype(np.int64)
    numbers = np.arange(len(seconds))
    return LoggedMessages(Channel(f"/{link}/raw", "ubx"), [bytes(size)] * len(seconds), times, times, numbers)


def status(fix: str) -> dict[str, Any]:
    return {"link": "rover", "source": "NAV-PVT", "fix": fix, "satellites": 12, "horizontal_m": 0.02}


def told(state: RecordingState, *levels: str) -> list[str]:
    return [alarm.text for alarm in state.alarms if alarm.level in levels]


def test_a_whole_flight_is_counted_as_the_published_reader_finds_it(log: Path) -> None:
    with log.open("rb") as stream:
        found = [(c.topic, m) for _, c, m in make_reader(stream).iter_messages()]
    topics = Counter(topic for topic, _ in found)
    frames = [m.data for topic, m in found if topic == "/vehicle/raw"]
    exposures = [json.loads(m.data) for topic, m in found if topic == "/camera/exposure"]
    state = reduced(chunks(log))
    link = state.links["vehicle"]
    assert (link.frames, link.frame_bytes) == (len(frames), sum(map(len, frames)))
    assert state.exposures["vehicle"].feedbacks == topics["/camera/exposure"]
    shown = {(layer.kind, layer.name): layer.points for layer in layers(state)}
    assert set(shown) == {("track", "vehicle"), ("picture", "vehicle")}
    pictures = np.array([[e["latitude_deg"], e["longitude_deg"]] for e in exposures])
    np.testing.assert_array_equal(shown["picture", "vehicle"], pictures)
    times = [m.log_time for topic, m in found]
    assert (state.first_ns, state.last_ns) == (min(times), max(times))
    row = view_of(state).receivers[0]
    assert (row["fix"].text, row["fix"].level, row["satellites"]) == ("RTK fixed", "good", 17)


def test_how_chunks_are_cut_leaves_no_trace(log: Path) -> None:
    whole = chunks(log)
    times = np.unique(np.concatenate([part.log_ns for part in whole[0]]))
    edges = [0, *times[:: len(times) // 40].tolist(), 2**62]
    pieces = [
        [p for part in whole[0] if len((p := _between(part, a, b)).payloads)] for a, b in pairwise(edges)
    ]
    one, many = reduced(whole[:1]), reduced(pieces)
    for name in ("links", "receivers", "exposures", "batteries", "alarms", "first_ns", "last_ns"):
        assert getattr(one, name) == getattr(many, name), name
    np.testing.assert_array_equal(
        one.tracks["vehicle/position"].points, many.tracks["vehicle/position"].points
    )


def _between(part: LoggedMessages, begin: int, end: int) -> LoggedMessages:
    own = np.flatnonzero((part.log_ns >= begin) & (part.log_ns < end))
    payloads = [part.payloads[row] for row in own]
    return replace(
        part,
        payloads=payloads,
        log_ns=part.log_ns[own],
        publish_ns=part.publish_ns[own],
        sequence=part.sequence[own],
    )


def test_rates_are_those_of_the_last_seconds_and_fall_to_nothing() -> None:
    regular = [n / 20 for n in range(200)]
    state = state_after(RecordingState(), [raw("rover", regular), raw("base", [0.0, 9.9])])
    look = ComputerState(START, "a.mcap", 10, ended=False, free_bytes=None)
    state = looked(state, look)
    row = view_of(state).links[1]
    assert row["frames_per_s"] == pytest.approx(20)
    assert row["bytes_per_s"] == pytest.approx(200)
    for second in range(1, 9):
        state = looked(state, replace(look, time_ns=START + second * SECOND))
    row = view_of(state).links[1]
    assert row["frames_per_s"] == 0
    assert row["state"].text == "no data for 8 s"


def test_pauses_of_a_link_are_counted_across_chunks() -> None:
    state = state_after(RecordingState(), [raw("rover", [0, 1, 2])])
    state = state_after(state, [raw("rover", [7, 8, 10.5])])
    row = view_of(state).links[0]
    assert (row["gaps"], row["longest_gap_s"]) == (2, 5.0)


@pytest.mark.parametrize(
    ("fixes", "alarms"),
    [
        (["rtk_fixed", "none"], [("bad", "fix dropped from RTK fixed to no fix")]),
        (["rtk_fixed", "rtk_float"], [("warn", "fix dropped from RTK fixed to RTK float")]),
        (["3d", "2d"], [("bad", "fix dropped from 3D to 2D")]),
        (["none", "2d", "3d", "rtk_fixed"], []),
        # What was no fix in space cannot be lost.
        (["2d", "none"], []),
        # One that flickers is told once, and again only after it was steady for a while.
        (
            ["rtk_fixed"] + ["rtk_float", "rtk_fixed"] * 5,
            [("warn", "fix dropped from RTK fixed to RTK float")],
        ),
        (
            ["rtk_fixed", "rtk_float", *["rtk_fixed"] * 7, "3d"],
            [
                ("warn", "fix dropped from RTK fixed to RTK float"),
                ("note", "has RTK fixed"),
                ("warn", "fix dropped from RTK fixed to 3D"),
            ],
        ),
        (
            ["rtk_fixed", "3d", "none"],
            [("warn", "fix dropped from RTK fixed to 3D"), ("bad", "fix dropped from 3D to no fix")],
        ),
    ],
)
def test_a_loss_of_fix_is_told_once(fixes: list[str], alarms: list[tuple[str, str]]) -> None:
    state = state_after(RecordingState(), [rows("/gnss/rover/status", GNSS_STATUS, *map(status, fixes))])
    assert [(alarm.level, alarm.text) for alarm in state.alarms] == alarms
    assert all(alarm.link == "rover" for alarm in state.alarms)


def test_a_receiver_that_says_nothing_has_no_fix() -> None:
    parts = [rows("/gnss/rover/status", GNSS_STATUS, status("rtk_fixed")), raw("base", [0, 6.5])]
    row = view_of(state_after(RecordingState(), parts)).receivers[0]
    assert (row["fix"].text, row["fix"].level) == ("last heard 6 s ago", "bad")


def test_the_age_of_corrections_is_what_the_receiver_says_else_since_they_were_sent() -> None:
    own = {**status("rtk_fixed"), "correction_age_s": 2.5}
    times = np.array([START - 12 * SECOND])
    sent = LoggedMessages(Channel("/rover/sent", "rtcm3"), [b"\xd3"], times, times, np.zeros(1, np.int64))
    asked = LoggedMessages(
        Channel("/rover/sent", "ubx"), [b"\xb5"], times + 11 * SECOND, times, np.ones(1, np.int64)
    )
    ages = {}
    for name, message in (("told", own), ("sent", status("rtk_fixed"))):
        state = state_after(RecordingState(), [rows("/gnss/rover/status", GNSS_STATUS, message), sent, asked])
        ages[name] = view_of(state).receivers[0]
    assert ages["told"]["correction_age_s"] == 2.5
    assert ages["told"]["correction"].level == "good"
    assert ages["sent"]["correction_age_s"] == 12.0
    assert (ages["sent"]["correction"].text, ages["sent"]["correction"].level) == ("12 s old", "warn")


def test_corrections_to_a_vehicle_are_known_by_their_message() -> None:
    """The time comparisons that are sent on the same channel feed nobody."""
    dialect = ardupilotmega()
    names = ["GPS_RTCM_DATA", "TIMESYNC", "TIMESYNC"]
    frames = [encode(dialect, dialect.number(n), {}, sequence=1, system=245, component=191) for n in names]
    times = START + np.arange(3) * SECOND
    sent = LoggedMessages(Channel("/vehicle/sent", "mavlink"), frames, times, times, np.arange(3))
    told_fix = rows("/gnss/vehicle/status", GNSS_STATUS, {**status("3d"), "link": "vehicle"})
    row = view_of(state_after(RecordingState(), [told_fix, sent])).receivers[0]
    assert row["correction_age_s"] == 2.0


def test_corrections_that_stop_are_told_once_and_their_return_too() -> None:
    state = RecordingState()
    for second in range(100):
        message = {**status("rtk_fixed"), "correction_age_s": max(0, second - 20) if second < 80 else 1}
        part = rows("/gnss/rover/status", GNSS_STATUS, message)
        state = state_after(state, [replace(part, log_ns=part.log_ns + second * SECOND)])
    assert [(alarm.level, alarm.text) for alarm in state.alarms] == [
        ("bad", "has corrections older than 30 s"),
        ("note", "has recent corrections again"),
    ]
    assert [(alarm.time_ns - START) // SECOND for alarm in state.alarms] == [51, 80]


def test_pictures_without_a_place_are_where_the_rover_was_then() -> None:
    from acquire.log import foxglove

    times = START + np.arange(3) * SECOND
    nan = np.full(3, np.nan)
    latitude = np.array([47.0, 47.001, 47.002])
    fixes = foxglove.location_fixes("rover/antenna", times, latitude, np.full(3, 8.0), np.zeros(3), nan, nan)
    channel = Channel("/gnss/rover/fix", "protobuf", foxglove.schema("foxglove.LocationFix"))
    track = LoggedMessages(channel, fixes, times, times, np.arange(3))
    mark = {"link": "rover", "source": "TIM-TM2", "edge": "rising"}
    edges = [{**mark, "sequence": 1}, {**mark, "edge": "falling", "sequence": 1}, {**mark, "sequence": 2}]
    state = state_after(RecordingState(), [rows("/camera/exposure", EXPOSURE, *edges, every_s=0.75), track])
    (drawn,) = [layer for layer in layers(state) if layer.kind == "picture"]
    np.testing.assert_allclose(drawn.points, [[47.0, 8.0], [47.0015, 8.0]], atol=1e-12)
    assert view_of(state).cameras[0]["time_marks"] == 2


def test_a_time_mark_that_the_receiver_skipped_is_named() -> None:
    """The receiver counts every edge; of two within one of its epochs it tells the last one only."""
    mark = {"link": "rover", "source": "TIM-TM2", "edge": "rising"}
    edges = [{**mark, "sequence": number} for number in (65533, 65534, 65535, 0, 1, 3, 4, 7)]
    state = state_after(RecordingState(), [rows("/camera/exposure", EXPOSURE, *edges)])
    row = view_of(state).cameras[0]
    assert (row["time_marks"], row["time_marks_missed"]) == (8, 3)
    assert (row["state"].text, row["state"].level) == ("3 time marks missing: 2, 5-6", "bad")
    assert told(state, "bad") == ["did not report time mark 2", "did not report time marks 5-6"]


def test_alarms_of_the_recorder_and_texts_of_the_vehicle_are_passed_on() -> None:
    kinds = ["note", "lost", "back", "silent", "disk_low", "clock_jump", "source_changed"]
    alarms = [{"kind": kind, "link": "rover", "text": kind} for kind in kinds]
    texts = [{"link": "vehicle", "severity": s, "text": f"severity {s}"} for s in (2, 3, 4, 6)]
    state = state_after(
        RecordingState(),
        [raw("rover", [0.0]), rows("/alarm", ALARM, *alarms), rows("/health", HEALTH, *texts)],
    )
    assert told(state, "bad") == ["says: severity 2", "lost", "silent", "disk_low", "clock_jump"]
    assert told(state, "warn") == ["says: severity 3", "source_changed"]
    assert told(state, "note") == ["note", "back"]
    assert [alarm.number for alarm in state.alarms] == list(range(1, 10))
    # Silent was the last word on this link.
    assert view_of(state).links[0]["state"].level == "bad"


def test_a_log_that_does_not_grow_is_told_and_its_growth_too() -> None:
    state = RecordingState(first_ns=START, last_ns=START)
    sizes = [100, 200, 300, 300, 300, 300, 300, 300, 400, 500]
    texts = []
    for second, size in enumerate(sizes):
        look = ComputerState(START + second * SECOND, "a.mcap", size, ended=False, free_bytes=10**12)
        state = looked(state, look)
        texts.append(view_of(state).recording.text)
    assert texts == ["recording"] * 7 + ["nothing written for 5 s"] + ["recording"] * 2
    assert [alarm.level for alarm in state.alarms] == ["bad", "note"]


def test_a_log_with_its_end_is_no_failure() -> None:
    look = ComputerState(START, "a.mcap", 100, ended=False, free_bytes=None)
    state = looked(looked(RecordingState(last_ns=START), look), replace(look, ended=True))
    assert told(state, "note") == ["a.mcap is complete"]
    state = looked(state, replace(look, ended=True, time_ns=START + 60 * SECOND))
    assert told(state, "bad", "warn") == []
    assert view_of(state).recording.text == "ended"


@pytest.mark.parametrize(
    ("free", "level", "text"),
    [
        (10**12, "good", "over 100 h"),
        (9 * 10**9, "good", "25 h"),
        (3 * 10**9, "good", "8.3 h"),
        (10**8, "bad", "0.3 h"),
    ],
)
def test_room_on_the_disk_is_told_in_hours_of_this_recording(free: int, level: str, text: str) -> None:
    state = RecordingState()
    for second in range(20):
        look = ComputerState(
            START + second * SECOND, "a.mcap", 100_000 * second, ended=False, free_bytes=free
        )
        state = looked(state, look)
    disk = view_of(state).disk
    assert disk["state"].level == level
    assert disk["bytes_per_s"] == pytest.approx(100_000)
    assert disk["state"].text.endswith(text)


def test_a_long_track_is_thinned_and_keeps_its_shape() -> None:
    count = 5 * LONGEST
    angle = np.linspace(0, 2 * np.pi, count)
    circle = np.column_stack([47 + 0.1 * np.sin(angle), 8 + 0.1 * np.cos(angle)])
    track = Track()
    for begin in range(0, count, 700):
        here = slice(begin, begin + 700)
        track = extended(track, circle[here], np.arange(count)[here])
    assert LONGEST / 4 < len(track.points) <= LONGEST
    radius = np.hypot(track.points[:, 0] - 47, track.points[:, 1] - 8)
    np.testing.assert_allclose(radius, 0.1, atol=1e-9)
    place = place_at(track, count // 4)
    assert place == pytest.approx((47.1, 8.0), abs=1e-3)


def test_what_hovers_makes_no_track() -> None:
    noise = np.random.default_rng(2).normal(0, 1e-7, (5000, 2))
    track = extended(Track(), np.array([47.0, 8.0]) + noise, np.arange(5000))
    assert len(track.points) < 5


VALUES: st.SearchStrategy[Any] = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just([1]) | st.just({})
)
NAMES = st.sampled_from(
    [
        *("link", "edge", "sequence", "fix", "satellites", "horizontal_m", "kind", "text", "severity"),
        *("latitude_deg", "longitude_deg", "voltage_v", "host_minus_device_s", "device", "x_m", "y_m", "z_m"),
    ]
)
ODD = {
    "/gnss/rover/status": GNSS_STATUS,
    "/camera/exposure": EXPOSURE,
    "/alarm": ALARM,
    "/health": HEALTH,
    "/clock": CLOCK,
    "/gnss/base/station": STATION,
}


@settings(max_examples=80)
@given(
    st.dictionaries(st.sampled_from(list(ODD)), st.dictionaries(NAMES, VALUES), min_size=1),
    st.binary(max_size=30),
    st.sampled_from(["/", "/x", "raw", "/a/b/c", "//raw", "/é/raw"]),
)
def test_a_log_of_another_program_never_ends_the_view(
    messages: dict[str, dict[str, Any]], payload: bytes, topic: str
) -> None:
    from acquire.log import foxglove

    parts = [rows(name, ODD[name], {"link": "rover", **message}) for name, message in messages.items()]
    times, number = np.array([START], np.int64), np.zeros(1, np.int64)
    place = Channel("/gnss/rover/fix", "protobuf", foxglove.schema("foxglove.LocationFix"))
    channels = (place, Channel(topic, "ubx"))
    parts += [LoggedMessages(channel, [payload], times, times, number) for channel in channels]
    state = state_after(RecordingState(), [raw("rover", [0.0]), *parts])
    assert state.links["rover"].frames == 1
    json.dumps(view_of(state).as_json(), allow_nan=False)
    json.dumps([layer.points.tolist() for layer in layers(state)], allow_nan=False)
    Console(file=io.StringIO()).print(render(view_of(state), layers(state), texts("en"), 80, 24))


def test_what_cannot_be_read_is_told_once() -> None:
    odd = rows("/gnss/rover/status", GNSS_STATUS, {"link": "rover"}, {"link": "rover"})
    state = state_after(state_after(RecordingState(), [odd]), [odd, raw("base", [0.0])])
    assert told(state, "warn") == ["messages on /gnss/rover/status cannot be read"]
    assert state.links["base"].frames == 1


def test_a_battery_that_is_not_told_any_more_is_not_good() -> None:
    told = {"vehicle": Battery(15.8, 81, START)}
    said = [
        view_of(RecordingState(last_ns=START + age_s * SECOND, batteries=told)).batteries[0]
        for age_s in (2, 12)
    ]
    assert [row["state"] for row in said] == [
        Word("15.8 V, 81 %", "good"),
        Word("15.8 V, 81 %, last heard 12 s ago", "bad"),
    ]


def test_a_dead_link_makes_the_head_red() -> None:
    state = state_after(RecordingState(), [raw("rover", [0, 1, 2]), raw("base", [0, 1, 2])])
    state = looked(state, ComputerState(START + 3 * SECOND, "f.mcap", 10, ended=False, free_bytes=10**11))
    assert view_of(state).overall == Word("recording, all is well", "good")
    lost = {"kind": "lost", "link": "base", "text": "is lost: unplugged"}
    state = state_after(state, [rows("/alarm", ALARM, lost), raw("rover", [3])])
    overall = view_of(state).overall
    assert overall.level == "bad"
    assert overall.text.startswith("base: lost")


def _said(state: RecordingState) -> list[tuple[str, str, str]]:
    return [(alarm.level, alarm.text, alarm.ended) for alarm in state.alarms]


def heartbeats(*armed: bool) -> LoggedMessages:
    """One each second, of a copter."""
    table = ardupilotmega()
    told = [{"type": 2, "autopilot": 3, "base_mode": 0x81 if on else 1, "custom_mode": 3} for on in armed]
    number = table.number("HEARTBEAT")
    payloads = [encode(table, number, one, sequence=k, system=1, component=1) for k, one in enumerate(told)]
    times = START + np.arange(len(armed), dtype=np.int64) * SECOND
    return LoggedMessages(Channel("/vehicle/raw", "mavlink"), payloads, times, times, np.arange(len(armed)))


def test_an_alarm_of_a_link_is_cured_when_the_link_is_back() -> None:
    lost = {"kind": "lost", "link": "base", "text": "is lost: cable pulled?"}
    other, back = {**lost, "link": "rover"}, {"kind": "back", "link": "base", "text": "is back"}
    state = state_after(RecordingState(), [rows("/alarm", ALARM, lost, other, back)])
    assert _said(state) == [
        ("bad", "is lost: cable pulled?", "cured"),
        ("bad", "is lost: cable pulled?", ""),
        ("note", "is back", ""),
    ]
    assert state.alarms[0].ended_ns == state.alarms[2].time_ns


def test_an_alarm_of_a_fix_is_cured_by_that_fix_and_not_by_a_lesser_one() -> None:
    fixes = ["rtk_fixed"] * 8 + ["none"] * 3 + ["3d"] * 8
    state = state_after(RecordingState(), [rows("/gnss/rover/status", GNSS_STATUS, *map(status, fixes))])
    assert [said for said in _said(state) if said[0] == "bad"] == [
        ("bad", "fix dropped from RTK fixed to no fix", "")
    ]
    later = rows("/gnss/rover/status", GNSS_STATUS, *map(status, ["rtk_fixed"] * 8))
    times = later.log_ns + 30 * SECOND
    state = state_after(state, [replace(later, log_ns=times, publish_ns=times)])
    assert [said[2] for said in _said(state) if said[0] == "bad"] == ["cured"]


def test_after_landing_links_that_are_switched_off_are_no_alarm() -> None:
    lost = {"kind": "silent", "link": "rover", "text": "no data for more than 10 s"}
    before = state_after(RecordingState(), [heartbeats(False, True), rows("/alarm", ALARM, lost)])
    look = ComputerState(START + 2 * SECOND, "f.mcap", 10, ended=False, free_bytes=10**11)
    before = looked(before, look)
    assert not before.landed
    assert _said(before) == [("bad", lost["text"], "")]
    assert view_of(before).overall.level == "bad"
    landed = state_after(before, [heartbeats(True, False)])
    assert landed.landed
    assert _said(landed) == [("bad", lost["text"], "landed")]
    after = state_after(landed, [rows("/alarm", ALARM, {**lost, "link": "vehicle"})])
    assert _said(after)[1] == ("note", lost["text"], "")
    assert view_of(after).overall == Word("landed, all is well", "good")
    full = {"kind": "disk_full", "link": "", "text": "the disk is full"}
    assert _said(state_after(after, [rows("/alarm", ALARM, full)]))[2][0] == "bad"


def test_a_vehicle_that_has_not_flown_yet_has_not_landed() -> None:
    assert not state_after(RecordingState(), [heartbeats(False, False)]).landed


def test_speed_and_heading_are_those_of_the_last_position() -> None:
    """Velocities north and east of 3 and 4 m/s in cm/s; a heading of hundredths, or of none."""
    table = ardupilotmega()
    number = table.number("GLOBAL_POSITION_INT")
    for hdg, heading in ((27_050, 270.5), (0xFFFF, None)):
        values = {"relative_alt": 60_000, "vx": 300, "vy": -400, "vz": 99, "hdg": hdg}
        payload = encode(table, number, values, sequence=0, system=1, component=1)
        at = np.array([START], dtype=np.int64)
        part = LoggedMessages(Channel("/vehicle/raw", "mavlink"), [payload], at, at, np.array([0]))
        (row,) = view_of(state_after(RecordingState(), [part])).vehicles
        assert (row["height_m"], row["speed_m_s"], row["heading_deg"]) == (60.0, 5.0, heading)

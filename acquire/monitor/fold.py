"""The state after messages of the log."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar

import numpy as np

from acquire.channels.decoded import SECOND_NS
from acquire.channels.layouts import CLOCK, EXPOSURE, GNSS_STATUS, HEALTH, STATION
from acquire.log.link import DAMAGE_ENCODING
from acquire.log.reader import Messages
from acquire.log.summary import GAP_S
from acquire.monitor.exposures import Exposures, Trigger, numbers, reported, settled, triggered
from acquire.monitor.fixes import correction_age_s, fed, receiver_after
from acquire.monitor.state import Battery, Link, State, in_order, raised
from acquire.monitor.track import Track, extended, place_at
from acquire.recording.alarms import ALARM
from drivers.frames import Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.dialect import Dialect, ardupilotmega

# Rates are those of the last whole seconds.
RATE_OVER_S = 5
# Error and worse, as MAVLink counts severity.
_SEVERE = 3
_LEVELS = {"lost": "bad", "silent": "bad", "disk_full": "bad", "disk_low": "bad", "clock_jump": "bad"}
_LEVELS |= {"source_changed": "warn", "device": "warn"}
_TROUBLE = {"lost", "silent"}
_RELIEF = {"back", "heard_again"}

V = TypeVar("V")


def fold(state: State, chunk: Sequence[Messages]) -> State:
    """Return the state after the messages of a chunk.

    Parameters
    ----------
    state : State
        What was known before.
    chunk : sequence of Messages
        The messages, channel by channel.
    """
    times = [ns for part in chunk if len(part.log_ns) for ns in (part.log_ns.min(), part.log_ns.max())]
    if not times:
        return state
    known = state.raised
    state = replace(
        state, first_ns=state.first_ns or int(min(times)), last_ns=max(state.last_ns, *map(int, times))
    )
    for part in sorted(chunk, key=_rank):
        handler = _HANDLERS.get(part.channel.schema.name) if part.channel.schema else _octets
        if handler is not None and len(part.payloads):
            state = handler(state, part)
    return in_order(_settled(state), known)


def _rank(part: Messages) -> bool:
    # Pictures are put on the map where the vehicle is: positions come first.
    return part.channel.topic == "/camera/exposure"


def _octets(state: State, part: Messages) -> State:
    """Count the frames and the damage of a link, and take note of corrections that were sent to it."""
    name, what = part.channel.topic.split("/")[1:3]
    link = state.links.get(name, Link())
    if what == "sent":
        corrections = _correction_times(part)
        if not corrections:
            return state
        return replace(state, links=_with(state.links, name, replace(link, corrected_ns=corrections[-1])))
    size = sum(map(len, part.payloads))
    if part.channel.encoding == DAMAGE_ENCODING:
        link = replace(link, damage_bytes=link.damage_bytes + size)
    elif what == "raw":
        link = _after_frames(link, part, size)
    return replace(state, links=_with(state.links, name, link))


def _after_frames(link: Link, part: Messages, size: int) -> Link:
    times = np.sort(part.log_ns)
    steps = np.diff(times, prepend=link.last_ns or times[0])
    sizes = np.fromiter(map(len, part.payloads), np.int64, len(part.payloads))
    per_second = {second: (frames, octets) for second, frames, octets in link.recent}
    seconds = part.log_ns // SECOND_NS
    for second in np.unique(seconds).tolist():
        own = seconds == second
        frames, octets = per_second.get(second, (0, 0))
        per_second[second] = frames + int(own.sum()), octets + int(sizes[own].sum())
    newest = max(per_second)
    return replace(
        link,
        frames=link.frames + len(times),
        frame_bytes=link.frame_bytes + size,
        first_ns=link.first_ns or int(times[0]),
        last_ns=max(link.last_ns, int(times[-1])),
        recent=tuple((s, *v) for s, v in sorted(per_second.items()) if s >= newest - RATE_OVER_S - 1),
        gaps=link.gaps + int((steps > GAP_S * SECOND_NS).sum()),
        longest_gap_ns=max(link.longest_gap_ns, int(steps.max())),
    )


def _correction_times(part: Messages) -> list[int]:
    times: list[int] = part.log_ns.tolist()
    if part.channel.encoding != Wire.MAVLINK.encoding:
        return times if part.channel.encoding == Wire.RTCM3.encoding else []
    dialect = _dialect()
    kinds = batch_of_payloads(Wire.MAVLINK, part.payloads, dialect).kind
    return [t for t, k in zip(times, kinds.tolist(), strict=True) if k == dialect.number("GPS_RTCM_DATA")]


def _fix_status(state: State, part: Messages) -> State:
    name = part.channel.topic.removeprefix("/gnss/").removesuffix("/status")
    receiver = state.receivers.get(name)
    for row, time_ns in _rows(part):
        receiver, told = receiver_after(receiver, row, time_ns)
        for level, text in told:
            state = raised(state, level, name, text, time_ns)
    return state if receiver is None else replace(state, receivers=_with(state.receivers, name, receiver))


def _location(state: State, part: Messages) -> State:
    message = _location_fix()
    points = []
    for payload in part.payloads:
        fix = message.FromString(payload)
        points.append((fix.latitude, fix.longitude))
    name = part.channel.topic.strip("/")
    track = extended(state.tracks.get(name, Track()), np.array(points), part.log_ns)
    return replace(state, tracks=_with(state.tracks, name, track))


def _exposure(state: State, part: Messages) -> State:
    for row, time_ns in _rows(part):
        name, edge, number = row["link"], row["edge"], int(row["sequence"])
        if edge == "falling":
            continue
        place = _told_place(row) or _whereabouts(state, name, time_ns)
        counts = state.marks if edge == "rising" else state.exposures
        counted = counts.get(name, Exposures())
        if edge == "trigger":
            state = _pictures(state, name, triggered(counted, Trigger(number, time_ns, place)))
            continue
        counted = reported(counted, number, time_ns, place)
        state = _marks(state, name, counted) if edge == "rising" else _pictures(state, name, counted)
        if place is not None:
            key = (name, edge)
            picture = state.pictures.get(key, Track())
            # Each picture is shown, however near to the last one.
            shown = Track(np.vstack([picture.points, place]), np.append(picture.times_ns, time_ns))
            state = replace(state, pictures=_with(state.pictures, key, shown))
    return state


def _pictures(state: State, name: str, counted: Exposures) -> State:
    before = state.exposures.get(name, Exposures())
    state = replace(state, exposures=_with(state.exposures, name, counted))
    if len(counted.unreported) < len(before.unreported):
        return raised(state, "note", name, "feedback came late after all", state.last_ns)
    return _lost(state, name, before, counted, "no feedback for picture")


def _marks(state: State, name: str, counted: Exposures) -> State:
    before = state.marks.get(name, Exposures())
    state = replace(state, marks=_with(state.marks, name, counted))
    return _lost(state, name, before, counted, "did not tell time mark")


def _lost(state: State, name: str, before: Exposures, after: Exposures, what: str) -> State:
    new = after.unreported[len(before.unreported) :]
    if not new:
        return state
    text = f"{what}{'s' if len(new) > 1 else ''} {numbers(new)}"
    return raised(state, "bad", name, text, state.last_ns)


def _settled(state: State) -> State:
    for name, counted in state.exposures.items():
        state = _pictures(state, name, settled(counted, state.last_ns))
    for name, receiver in state.receivers.items():
        age_s = correction_age_s(receiver, state.links.get(receiver.link, Link()), state.last_ns)
        now, told = fed(receiver, age_s)
        state = replace(state, receivers=_with(state.receivers, name, now))
        for level, text in told:
            state = raised(state, level, name, text, state.last_ns)
    return state


def _clock(state: State, part: Messages) -> State:
    for row, _ in _rows(part):
        offset = row.get("host_minus_device_s")
        if offset is not None and row.get("device") is not None:
            link = replace(state.links.get(row["link"], Link()), clock_offset_s=float(offset))
            state = replace(state, links=_with(state.links, row["link"], link))
    return state


def _alarm(state: State, part: Messages) -> State:
    for row, time_ns in _rows(part):
        kind, name, text = row["kind"], row["link"], row["text"]
        if name and kind in _TROUBLE | _RELIEF:
            link = replace(state.links.get(name, Link()), trouble=kind if kind in _TROUBLE else "")
            state = replace(state, links=_with(state.links, name, link))
        state = raised(state, _LEVELS.get(kind, "note"), name, text, time_ns)
    return state


def _health(state: State, part: Messages) -> State:
    for row, time_ns in _rows(part):
        name = row["link"]
        if row.get("text") and row.get("severity", 7) <= _SEVERE:
            state = raised(state, "warn", name, f"says: {row['text']}", time_ns)
        if row.get("voltage_v") is not None:
            percent = row.get("battery_percent", -1)
            battery = Battery(row["voltage_v"], percent if percent >= 0 else None)
            state = replace(state, batteries=_with(state.batteries, name, battery))
    return state


def _station(state: State, part: Messages) -> State:
    (row, _) = _rows(part)[-1]
    if all(row[axis] == 0 for axis in ("x_m", "y_m", "z_m")):
        return state
    longitude, latitude, _height = _geodetic().transform(row["x_m"], row["y_m"], row["z_m"])
    name = part.channel.topic.split("/")[2]
    return replace(state, stations=_with(state.stations, name, (latitude, longitude)))


_HANDLERS: dict[str, Callable[[State, Messages], State]] = {
    GNSS_STATUS.name: _fix_status,
    "foxglove.LocationFix": _location,
    EXPOSURE.name: _exposure,
    CLOCK.name: _clock,
    ALARM.name: _alarm,
    HEALTH.name: _health,
    STATION.name: _station,
}


def _rows(part: Messages) -> list[tuple[dict[str, Any], int]]:
    rows = map(json.loads, part.payloads)
    return list(zip(rows, part.log_ns.tolist(), strict=True))


def _with(mapping: Mapping[Any, V], key: Any, value: V) -> dict[Any, V]:
    return {**mapping, key: value}


def _told_place(row: Mapping[str, Any]) -> tuple[float, float] | None:
    latitude, longitude = row.get("latitude_deg") or 0.0, row.get("longitude_deg") or 0.0
    return (latitude, longitude) if latitude or longitude else None


def _whereabouts(state: State, link: str, time_ns: int) -> tuple[float, float] | None:
    """Return where the device of a link was: by its filter, its receiver, or another filter."""
    wanted = (f"{link}/position", f"gnss/{link}/fix")
    named = [state.tracks[name] for name in wanted if name in state.tracks]
    others = [track for name, track in state.tracks.items() if name.endswith("/position")]
    places = (place_at(track, time_ns) for track in (*named, *others))
    return next((place for place in places if place is not None), None)


@cache
def _dialect() -> Dialect:
    return ardupilotmega()


@cache
def _location_fix() -> Any:
    from foxglove_schemas_protobuf import LocationFix_pb2

    return LocationFix_pb2.LocationFix


@cache
def _geodetic() -> Any:
    from pyproj import Transformer

    return Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)

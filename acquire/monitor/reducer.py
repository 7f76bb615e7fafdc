"""The state after messages of the log."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from acquire.channels.layouts import CLOCK, EXPOSURE, GNSS_STATUS, HEALTH, STATION
from acquire.log.reader import LoggedMessages
from acquire.monitor.state import (
    OF_FLIGHT,
    Battery,
    CountedPictures,
    LinkState,
    RecordingState,
    ShownAlarm,
    Track,
    Trigger,
    ended,
    extended,
    in_order,
    numbers,
    place_at,
    raised,
    reported,
    settled,
    triggered,
    vehicle_after,
)
from acquire.monitor.traffic import OCTETS, WORTH, correction_age_s, fed, link_after, number, receiver_after
from acquire.recording.alarms import ALARM
from drivers.frames import Wire
from photocal.base.geodesy import geodetic

# Critical, as a failsafe is, and error, as MAVLink counts severity from the worst.
_CRITICAL, _SEVERE = 2, 3
_LEVELS = dict.fromkeys(("lost", "silent", "disk_full", "disk_low", "disk_slow", "clock_jump"), "bad")
_LEVELS |= {"file_gone": "bad", "source_changed": "warn", "device": "warn", "flood": "warn"}
_TEXTS = {"link", "edge", "fix", "kind", "text"}
_TROUBLE = {"lost", "silent"}
_RELIEF = {"back", "heard_again"}

V = TypeVar("V")


def state_after(state: RecordingState, chunk: Sequence[LoggedMessages]) -> RecordingState:
    """Return the state after the messages of a chunk."""
    times = [ns for part in chunk if len(part.log_ns) for ns in (part.log_ns.min(), part.log_ns.max())]
    if not times:
        return state
    known = state.raised
    state = replace(
        state, first_ns=state.first_ns or int(min(times)), last_ns=max(state.last_ns, *map(int, times))
    )
    # Pictures are put on the map where the vehicle is: positions come first.
    for part in sorted(chunk, key=lambda part: part.channel.topic == "/camera/exposure"):
        handler = _HANDLERS.get(part.channel.schema.name) if part.channel.schema else _octets
        if handler is not None and len(part.payloads):
            state = _read(state, handler, part)
    return in_order(_settled(state), known)


def _read(
    state: RecordingState,
    handler: Callable[[RecordingState, LoggedMessages], RecordingState],
    part: LoggedMessages,
) -> RecordingState:
    """Return the state after messages; those that do not match their schema are reported and skipped."""
    try:
        return handler(state, part)
    except (LookupError, ValueError, TypeError, OverflowError):
        # A log of another program must not end the view of the rest.
        text = f"messages on {part.channel.topic} cannot be read"
        if any(alarm.text == text for alarm in state.alarms):
            return state
        return raised(state, "warn", "", text, state.last_ns)


def _octets(state: RecordingState, part: LoggedMessages) -> RecordingState:
    name, _, what = part.channel.topic.removeprefix("/").partition("/")
    if what not in OCTETS:
        return state
    link = link_after(state.links.get(name, LinkState()), what, part)
    state = replace(state, links=_with(state.links, name, link))
    vehicle = state.vehicles.get(name)
    if part.channel.encoding == Wire.MAVLINK.encoding and what == "raw":
        vehicle = vehicle_after(vehicle, part)
    if vehicle is None:
        return state
    flew = not state.landed
    state = replace(state, vehicles=_with(state.vehicles, name, vehicle))
    if flew and state.landed:
        return ended(state, "landed", state.last_ns, lambda alarm: alarm.about.partition(" ")[0] in OF_FLIGHT)
    return state


def _fix_status(state: RecordingState, part: LoggedMessages) -> RecordingState:
    name = part.channel.topic.removeprefix("/gnss/").removesuffix("/status")
    receiver = state.receivers.get(name)
    for row, time_ns in _rows(part):
        fallen = "" if receiver is None else f"fix {receiver.expected}"
        receiver, alarms = receiver_after(receiver, row, time_ns)
        for level, text in alarms:
            if level == "note":
                state = _fix_cured(state, name, receiver.fix, time_ns)
            state = raised(state, level, name, text, time_ns, "" if level == "note" else fallen)
    return state if receiver is None else replace(state, receivers=_with(state.receivers, name, receiver))


def _fix_cured(state: RecordingState, name: str, fix: str, time_ns: int) -> RecordingState:
    """End the alarms of a receiver that has again at least the fix from which it fell."""

    def reached(alarm: ShownAlarm) -> bool:
        """Whether it is about a fix of this receiver, and no better one."""
        kind, _, fell_from = alarm.about.partition(" ")
        return alarm.link == name and kind == "fix" and WORTH.get(fell_from, 0) <= WORTH.get(fix, 0)

    return ended(state, "cured", time_ns, reached)


def _cured(state: RecordingState, name: str, about: str, time_ns: int) -> RecordingState:
    return ended(state, "cured", time_ns, lambda alarm: (alarm.link, alarm.about) == (name, about))


def _location(state: RecordingState, part: LoggedMessages) -> RecordingState:
    points = np.array([_latitude_longitude(payload) for payload in part.payloads])
    there = np.array([_on_earth(*point) for point in points.tolist()])
    name = part.channel.topic.strip("/")
    track = extended(state.tracks.get(name, Track()), points[there], part.log_ns[there])
    return replace(state, tracks=_with(state.tracks, name, track))


def _exposure(state: RecordingState, part: LoggedMessages) -> RecordingState:
    for row, time_ns in _rows(part):
        name, edge, count = row["link"], row["edge"], int(row["sequence"])
        if edge == "falling":
            continue
        place = _told_place(row) or _whereabouts(state, name, time_ns)
        counts = state.marks if edge == "rising" else state.exposures
        counted = counts.get(name, CountedPictures())
        if edge == "trigger":
            state = _pictures(state, name, triggered(counted, Trigger(count, time_ns, place)))
            continue
        counted = reported(counted, count, time_ns, place)
        state = _marks(state, name, counted) if edge == "rising" else _pictures(state, name, counted)
        if place is not None:
            key = (name, edge)
            picture = state.pictures.get(key, Track())
            # Each picture is shown, however near to the last one.
            shown = Track(np.vstack([picture.points, place]), np.append(picture.times_ns, time_ns))
            state = replace(state, pictures=_with(state.pictures, key, shown))
    return state


def _pictures(state: RecordingState, name: str, counted: CountedPictures) -> RecordingState:
    before = state.exposures.get(name, CountedPictures())
    state = replace(state, exposures=_with(state.exposures, name, counted))
    if len(counted.unreported) < len(before.unreported):
        return raised(state, "note", name, "feedback came late after all", state.last_ns)
    return _lost(state, name, before, counted, "no feedback for picture")


def _marks(state: RecordingState, name: str, counted: CountedPictures) -> RecordingState:
    before = state.marks.get(name, CountedPictures())
    state = replace(state, marks=_with(state.marks, name, counted))
    return _lost(state, name, before, counted, "did not report time mark")


def _lost(
    state: RecordingState, name: str, before: CountedPictures, after: CountedPictures, what: str
) -> RecordingState:
    new = after.unreported[len(before.unreported) :]
    if not new:
        return state
    text = f"{what}{'s' if len(new) > 1 else ''} {numbers(new)}"
    return raised(state, "bad", name, text, state.last_ns)


def _settled(state: RecordingState) -> RecordingState:
    for name, counted in state.exposures.items():
        state = _pictures(state, name, settled(counted, state.last_ns))
    for name, receiver in state.receivers.items():
        age_s = correction_age_s(receiver, state.links.get(receiver.link, LinkState()), state.last_ns)
        now, alarms = fed(receiver, age_s)
        state = replace(state, receivers=_with(state.receivers, name, now))
        for level, text in alarms:
            if level == "note":
                state = _cured(state, name, "corrections", state.last_ns)
            about = "" if level == "note" else "corrections"
            state = raised(state, level, name, text, state.last_ns, about)
    return state


def _clock(state: RecordingState, part: LoggedMessages) -> RecordingState:
    for row, _ in _rows(part):
        offset = number(row, "host_minus_device_s")
        if offset is not None and row.get("device") is not None:
            link = replace(state.links.get(row["link"], LinkState()), clock_offset_s=offset)
            state = replace(state, links=_with(state.links, row["link"], link))
    return state


def _alarm(state: RecordingState, part: LoggedMessages) -> RecordingState:
    for row, time_ns in _rows(part):
        kind, name, text = row["kind"], row["link"], row["text"]
        if name and kind in _TROUBLE | _RELIEF:
            link = replace(state.links.get(name, LinkState()), trouble=kind if kind in _TROUBLE else "")
            state = replace(state, links=_with(state.links, name, link))
            if kind in _RELIEF:
                state = _cured(state, name, "link", time_ns)
        about = "link" if kind in _TROUBLE else ""
        state = raised(state, _LEVELS.get(kind, "note"), name, text, time_ns, about)
    return state


def _health(state: RecordingState, part: LoggedMessages) -> RecordingState:
    for row, time_ns in _rows(part):
        name = row["link"]
        severity = row.get("severity", 7)
        if row.get("text") and severity <= _SEVERE:
            level = "bad" if severity <= _CRITICAL else "warn"
            state = raised(state, level, name, f"says: {row['text']}", time_ns)
        voltage, percent = number(row, "voltage_v"), number(row, "battery_percent")
        if voltage is not None:
            left = None if percent is None or percent < 0 else round(percent)
            battery = Battery(voltage, left, time_ns)
            state = replace(state, batteries=_with(state.batteries, name, battery))
    return state


def _station(state: RecordingState, part: LoggedMessages) -> RecordingState:
    (row, _) = _rows(part)[-1]
    xyz_m = np.array([row[axis] for axis in ("x_m", "y_m", "z_m")], np.float64)
    if not xyz_m.any():
        return state
    latitude, longitude, _ = map(float, geodetic(xyz_m))
    if not _on_earth(latitude, longitude):
        raise ValueError("a place on earth was expected")
    name = part.channel.topic.split("/")[2]
    return replace(state, stations=_with(state.stations, name, (latitude, longitude)))


_HANDLERS: dict[str, Callable[[RecordingState, LoggedMessages], RecordingState]] = {
    GNSS_STATUS.name: _fix_status,
    "foxglove.LocationFix": _location,
    EXPOSURE.name: _exposure,
    CLOCK.name: _clock,
    ALARM.name: _alarm,
    HEALTH.name: _health,
    STATION.name: _station,
}


def _rows(part: LoggedMessages) -> list[tuple[dict[str, Any], int]]:
    # What JSON does not know (NaN) is nothing.
    rows = [json.loads(payload, parse_constant=lambda _: None) for payload in part.payloads]
    for row in rows:
        if any(not isinstance(row[name], str) for name in _TEXTS & row.keys()):
            raise TypeError("a text was expected")
    return list(zip(rows, part.log_ns.tolist(), strict=True))


def _with(mapping: Mapping[Any, V], key: Any, value: V) -> dict[Any, V]:
    return {**mapping, key: value}


def _told_place(row: Mapping[str, Any]) -> tuple[float, float] | None:
    latitude, longitude = number(row, "latitude_deg") or 0.0, number(row, "longitude_deg") or 0.0
    there = (latitude or longitude) and _on_earth(latitude, longitude)
    return (latitude, longitude) if there else None


def _on_earth(latitude: float, longitude: float) -> bool:
    return abs(latitude) <= 90 and abs(longitude) <= 360


def _whereabouts(state: RecordingState, link: str, time_ns: int) -> tuple[float, float] | None:
    """Return where the device of a link was: by its filter, its receiver, or another filter."""
    wanted = (f"{link}/position", f"gnss/{link}/fix")
    named = [state.tracks[name] for name in wanted if name in state.tracks]
    others = [track for name, track in state.tracks.items() if name.endswith("/position")]
    places = (place_at(track, time_ns) for track in (*named, *others))
    return next((place for place in places if place is not None), None)


def _latitude_longitude(payload: bytes) -> tuple[float, float]:
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
    from google.protobuf.message import DecodeError

    try:
        fix = LocationFix.FromString(payload)
    except DecodeError as damage:
        raise ValueError("a LocationFix was expected") from damage
    return fix.latitude, fix.longitude

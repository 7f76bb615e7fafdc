"""What a person is shown of a state: figures with their units, and a word and a level for each."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from acquire.monitor.planned import covered
from acquire.monitor.state import (
    Battery,
    CountedPictures,
    LinkState,
    ReceiverState,
    RecordingState,
    ShownAlarm,
    VehicleState,
    numbers,
)
from acquire.monitor.traffic import (
    DEAD_CORRECTION_S,
    LEAST_WORTH,
    NAMES,
    OLD_CORRECTION_S,
    RATE_OVER_S,
    WORTH,
    bytes_per_s,
    correction_age_s,
)
from photocal.base.arrays import Floats, picked
from photocal.base.time_scales import SECOND_NS


@dataclass(frozen=True)
class MapLayer:
    """A line or points of one name.

    kind: ``track``, ``picture``, ``missed``, ``station``, ``plan`` or ``coverage``: four corners a picture.
    points (n, 2): latitude and longitude, degrees.
    edition: as long as it stays, points were only added.
    labels: of the points; empty for none.
    """

    kind: str
    name: str
    points: Floats
    edition: str
    labels: tuple[str, ...] = ()


def layers(state: RecordingState, footprint: tuple[float, float] | None = None) -> list[MapLayer]:
    """Return what is drawn of a state: one track for each vehicle and receiver, each picture once.

    footprint: of a picture along and across the flight, m, to show what is covered.
    """
    tracks = _shown_tracks(state)
    drawn = [
        MapLayer("track", name, track.points, f"{state.flight} {key} {track.thinned}")
        for name, key in tracks.items()
        for track in [state.tracks[key]]
    ]
    # Both the vehicle and the receiver tell of the same picture: what the camera reported counts.
    kind = "feedback" if "feedback" in {kind for _, kind in state.pictures} else "rising"
    for (name, source), track in sorted(state.pictures.items()):
        if source == kind:
            drawn.append(MapLayer("picture", name, track.points, f"{state.flight} {source}"))
            flown = tracks.get(name) or next(iter(tracks.values()), "")
            if footprint is not None and flown:
                corners = covered(track, state.tracks[flown], footprint)
                drawn.append(MapLayer("coverage", name, corners, f"{state.flight} {source}"))
    for name, counted in (*sorted(state.exposures.items()), *sorted(state.marks.items())):
        missed = [(str(t.number), t.place) for t in counted.unreported if t.place is not None]
        if missed:
            points = np.array([place for _, place in missed])
            labels = tuple(label for label, _ in missed)
            drawn.append(MapLayer("missed", name, points, f"{state.flight} {labels}", labels))
    drawn += [
        MapLayer("station", name, np.array([place]), f"{state.flight} {place}")
        for name, place in sorted(state.stations.items())
    ]
    return drawn


def _shown_tracks(state: RecordingState) -> dict[str, str]:
    """Return the topic of the track by its name: the filter of a vehicle rather than its receivers."""
    shown: dict[str, str] = {}
    for key in sorted(state.tracks):
        parts = key.split("/")
        name = parts[1] if parts[0] == "gnss" else key.removesuffix("/position")
        if parts[0] != "gnss" or name not in shown:
            shown[name] = key
    # A vehicle's second receiver lies under the track of its filter.
    filters = {key.split("/")[0] for key in state.tracks if key.endswith("/position")}
    return {
        name: key
        for name, key in shown.items()
        if not (key.startswith("gnss/") and name.removesuffix("-2") in filters)
    }


SCHEMA = "acquire.monitor/1"
# From so much silence of a link or a receiver on it is said.
_SILENT_S, _STALE_S = 3.0, 5.0
_GB = 1e9
_LITTLE_ROOM, _NO_ROOM = (2 * _GB, 2.0), (0.5 * _GB, 0.5)
# What remains of a battery, percent: time to come home, and time to land.
_LOW, _EMPTY = 30, 15


@dataclass(frozen=True)
class Word:
    """How something is: in words, and as a level: ``good``, ``warn``, ``bad`` or ``off`` (nothing to say)."""

    text: str
    level: str


# A row of the page: what it is called, words for how it is, and figures with the unit in their names; None is
# what is not known.
Row = dict[str, Any]


@dataclass(frozen=True)
class PageView:
    """Everything but the map, see `view_of`.

    links: rates of the last seconds, silence, pauses and damage so far.
    receivers: fix and for how long each has had it, satellites, accuracy, age of the corrections.
    cameras: pictures of a link that were asked for, reported, missed (and which), time marks.
    clocks: clock of this computer less that of a device.
    vehicles: mode of flight, height above the take-off, speed over ground, heading.
    disk: what is left on it, and for how long that is enough.
    """

    flight: str
    file: str
    recording: Word
    duration_s: float
    bytes: int
    time_ns: int
    links: tuple[Row, ...]
    receivers: tuple[Row, ...]
    cameras: tuple[Row, ...]
    clocks: tuple[Row, ...]
    vehicles: tuple[Row, ...]
    batteries: tuple[Row, ...]
    disk: Row
    alarms: tuple[ShownAlarm, ...]
    landed: bool = False

    @property
    def overall(self) -> Word:
        """How it is altogether: the worst of all, and what that is."""
        if self.recording.level in ("off", "bad"):
            return self.recording
        states = [(row["link"], row["state"]) for row in self.cameras]
        states += [(f"clock, {row['link']}", row["state"]) for row in self.clocks]
        states.append(("disk", self.disk["state"]))
        if not self.landed:
            states = [*self._in_flight(), *states]
        for level in ("bad", "warn"):
            worst = [(name, word) for name, word in states if word.level == level]
            if worst:
                name, word = worst[0]
                more = f", and {len(worst) - 1} more" if len(worst) > 1 else ""
                return Word(f"{name}: {word.text}{more}", level)
        return Word("landed, all is well" if self.landed else "recording, all is well", "good")

    def _in_flight(self) -> list[tuple[str, Word]]:
        """States that no longer matter once the crew has landed and switches off."""
        states = [(row["name"], row["state"]) for row in self.links]
        states += [(row["name"], row[word]) for word in ("fix", "correction") for row in self.receivers]
        states += [(row["link"], row["state"]) for row in self.batteries]
        return [*states, *((row["link"], row["mode"]) for row in self.vehicles)]

    def as_json(self) -> dict[str, Any]:
        """Return it for programs."""
        return {"schema": SCHEMA, "overall": asdict(self.overall), **asdict(self)}


def view_of(state: RecordingState) -> PageView:
    """Return what a person is shown of a state."""
    now_ns = _now_ns(state)
    return PageView(
        flight=state.flight,
        file=state.look.file if state.look else "",
        recording=_recording(state),
        duration_s=_seconds(now_ns - state.first_ns) if state.first_ns else 0.0,
        bytes=state.look.size if state.look else 0,
        time_ns=now_ns,
        links=tuple(_link(name, link, state, now_ns) for name, link in sorted(state.links.items())),
        receivers=tuple(_receiver(name, r, state, now_ns) for name, r in sorted(state.receivers.items())),
        cameras=tuple(_camera(name, state) for name in sorted({*state.exposures, *state.marks})),
        clocks=tuple(
            _clock(name, link.clock_offset_s)
            for name, link in sorted(state.links.items())
            if link.clock_offset_s is not None
        ),
        vehicles=tuple(
            {
                "link": name,
                "mode": _mode(vehicle, now_ns),
                **picked(vehicle, "armed", "height_m", "speed_m_s", "heading_deg"),
            }
            for name, vehicle in sorted(state.vehicles.items())
        ),
        batteries=tuple(_battery(name, battery, now_ns) for name, battery in sorted(state.batteries.items())),
        disk=_disk(state),
        alarms=state.alarms,
        landed=state.landed,
    )


def _now_ns(state: RecordingState) -> int:
    """Return the time of the flight: the clock of the log, going on while nothing is written."""
    if state.look is None or state.look.ended:
        return state.last_ns
    return state.last_ns + max(state.look.time_ns - state.grown_ns, 0)


def _recording(state: RecordingState) -> Word:
    look = state.look
    if look is None or not look.file:
        return Word("waiting for a recording", "off")
    if look.trouble:
        return Word("cannot be read", "bad")
    if look.ended:
        return Word("ended", "off")
    if state.stalled:
        return Word(f"nothing written for {_seconds(look.time_ns - state.grown_ns):.0f} s", "bad")
    return Word("recording", "good") if state.first_ns else Word("no data yet", "off")


def _link(name: str, link: LinkState, state: RecordingState, now_ns: int) -> Row:
    # Whole seconds that the log holds; a log that has stopped holds seconds without frames.
    end = max(state.last_ns // SECOND_NS, now_ns // SECOND_NS - 1)
    counted = [
        (frames, octets) for second, frames, octets in link.recent if end - RATE_OVER_S <= second < end
    ]
    over_s = max(min(RATE_OVER_S, end - link.first_ns // SECOND_NS), 1)
    silent_s = _seconds(now_ns - link.last_ns) if link.last_ns else None
    if silent_s is None:
        word = Word(link.trouble or "no data yet", "bad" if link.trouble else "warn")
    elif link.trouble:
        trouble = "no data" if link.trouble == "silent" else link.trouble
        word = Word(f"{trouble} for {silent_s:.0f} s", "bad")
    elif silent_s > _SILENT_S:
        word = Word(f"no data for {silent_s:.0f} s", "warn")
    else:
        word = Word("receiving", "good")
    return {
        "name": name,
        "state": word,
        "frames": link.frames,
        "frames_per_s": sum(frames for frames, _ in counted) / over_s,
        "bytes_per_s": sum(octets for _, octets in counted) / over_s,
        "silent_s": silent_s,
        "gaps": link.gaps,
        "longest_gap_s": _seconds(link.longest_gap_ns),
        "damage_bytes": link.damage_bytes,
    }


def _receiver(name: str, receiver: ReceiverState, state: RecordingState, now_ns: int) -> Row:
    stale_s = _seconds(now_ns - receiver.time_ns)
    age_s = correction_age_s(receiver, state.links.get(receiver.link, LinkState()), now_ns)
    return {
        "name": name,
        "fix": _fix(receiver.fix, stale_s),
        "for_s": _seconds(now_ns - receiver.since_ns),
        "satellites": receiver.satellites if receiver.satellites >= 0 else None,
        "horizontal_m": receiver.horizontal_m,
        "correction": _correction(age_s),
        "correction_age_s": age_s,
    }


def _fix(fix: str, stale_s: float) -> Word:
    if stale_s > _STALE_S:
        return Word(f"last heard {stale_s:.0f} s ago", "bad")
    worth = WORTH.get(fix, 0)
    level = "bad" if worth < LEAST_WORTH else "good" if fix == "rtk_fixed" else "warn"
    return Word(NAMES.get(fix, fix), level)


def _correction(age_s: float | None) -> Word:
    if age_s is None:
        return Word("none reported", "off")
    level = "good" if age_s <= OLD_CORRECTION_S else "warn" if age_s <= DEAD_CORRECTION_S else "bad"
    return Word(f"{age_s:.1f} s old" if age_s < 10 else f"{age_s:.0f} s old", level)


def _camera(name: str, state: RecordingState) -> Row:
    # One or two answers may still be on their way.
    unheard_triggers = 3
    counted = state.exposures.get(name, CountedPictures())
    marks = state.marks.get(name, CountedPictures())
    missed, untold = numbers(counted.unreported), numbers(marks.unreported)
    words = []
    if counted.unreported:
        words.append(f"{len(counted.unreported)} missed: {_shortened(missed)}")
    if marks.unreported:
        words.append(f"{len(marks.unreported)} time marks missing: {_shortened(untold)}")
    if words:
        word = Word(", ".join(words), "bad")
    elif counted.feedbacks:
        word = Word("all reported", "good")
    elif counted.triggers:
        # A camera without feedback is no failure, but nobody knows whether it takes pictures.
        word = Word("no feedback so far", "warn" if counted.triggers >= unheard_triggers else "good")
    else:
        word = Word("all time marks received", "good")
    return {
        "link": name,
        "state": word,
        "triggered": counted.triggers,
        "reported": counted.feedbacks,
        "missed": len(counted.unreported),
        "missed_numbers": missed,
        "time_marks": marks.feedbacks,
        "time_marks_missed": len(marks.unreported),
    }


def _shortened(missed: str) -> str:
    # As many as a line of the page holds.
    listed_missed = 4
    parts = missed.split(", ")
    return missed if len(parts) <= listed_missed else "…, " + ", ".join(parts[-listed_missed:])


def _mode(vehicle: VehicleState, now_ns: int) -> Word:
    if not vehicle.mode:
        return Word("not reported", "off")
    return _unless_stale(Word(vehicle.mode, "good"), vehicle.time_ns, now_ns)


def _unless_stale(word: Word, told_ns: int, now_ns: int) -> Word:
    """A value that was received too long ago is no longer known, however good it was."""
    silent_s = _seconds(now_ns - told_ns)
    return Word(f"{word.text}, last heard {silent_s:.0f} s ago", "bad") if silent_s > _STALE_S else word


def _battery(name: str, battery: Battery, now_ns: int) -> Row:
    parts = [] if battery.voltage_v is None else [f"{battery.voltage_v:.1f} V"]
    parts += [] if battery.percent is None else [f"{battery.percent} %"]
    left = battery.percent
    level = "off" if left is None else "bad" if left < _EMPTY else "warn" if left < _LOW else "good"
    state = _unless_stale(Word(", ".join(parts), level), battery.time_ns, now_ns)
    return {"link": name, "state": state, "voltage_v": battery.voltage_v, "percent": left}


def _clock(name: str, offset_s: float) -> Row:
    # A receiver's message comes some tenths of a second after its time; more is a wrong clock.
    clock_limit_s = 1.0
    good = abs(offset_s) <= clock_limit_s
    word = Word(f"in step ({offset_s:+.2f} s)", "good") if good else Word(f"off by {offset_s:+.1f} s", "bad")
    return {"link": name, "state": word, "host_minus_device_s": offset_s}


def _disk(state: RecordingState) -> Row:
    free = state.look.free_bytes if state.look else None
    speed = bytes_per_s(state)
    if free is None:
        return {"state": Word("unknown", "off"), "free_bytes": None, "bytes_per_s": speed, "hours": None}
    hours = free / speed / 3600 if speed else None

    def below(limit: tuple[float, float]) -> bool:
        """Whether room or time left on the disk is below a limit."""
        return free < limit[0] or (hours is not None and hours < limit[1])

    level = "bad" if below(_NO_ROOM) else "warn" if below(_LITTLE_ROOM) else "good"
    text = f"{free / _GB:.1f} GB free"
    if hours is not None:
        text += f", {hours:.1f} h" if hours < 10 else f", {hours:.0f} h" if hours < 100 else ", over 100 h"
    return {"state": Word(text, level), "free_bytes": free, "bytes_per_s": speed, "hours": hours}


def _seconds(nanoseconds: int) -> float:
    return nanoseconds / SECOND_NS

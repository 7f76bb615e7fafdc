"""The state of a recording, as far as it is known from its log and from the computer.

Trigger count against feedback count: which pictures were asked for and never reported.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from acquire.log.reader import LoggedMessages
from drivers.mavlink.decode import GROUND_STATION, NO_AUTOPILOT
from photocal.base.arrays import Floats, Integers

# So long after a trigger its feedback may come: shutters need tenths of a second. What a slow radio brings
# later is taken back from the missed ones.
GRACE_NS = 700_000_000


@dataclass(frozen=True)
class Trigger:
    """A picture that was asked for: number, moment (UTC ns), latitude and longitude (deg; None: unknown)."""

    number: int
    time_ns: int
    place: tuple[float, float] | None = None


@dataclass(frozen=True)
class CountedPictures:
    """The pictures of one link, counted.

    A picture that was asked for by trigger message, or whose number the feedback has skipped, counts as
    missed as long as its own feedback has not come.

    triggers, feedbacks: how many pictures were asked for, and how many were reported.
    pending, missed: those that may still be reported, and those that were not.
    before: those that were not before the device last started again: their numbers have come to mean others.
    offset: number of a feedback less that of its trigger: devices begin to count at 0 or 1.
    """

    triggers: int = 0
    feedbacks: int = 0
    pending: tuple[Trigger, ...] = ()
    missed: tuple[Trigger, ...] = ()
    before: tuple[Trigger, ...] = ()
    last_trigger: int | None = None
    last_feedback: int | None = None
    offset: int | None = None

    @property
    def unreported(self) -> tuple[Trigger, ...]:
        """All that were missed."""
        return self.before + self.missed


def triggered(counted: CountedPictures, trigger: Trigger) -> CountedPictures:
    """Take note of a trigger; one that is repeated counts once."""
    # What waits for an answer is kept up to this number.
    most_pending = 1000
    last = counted.last_trigger
    if last == trigger.number:
        return counted
    if last is not None and trigger.number < last:
        # The device has started again: what was open stays open for good.
        counted = _restarted(counted)
    return replace(
        counted,
        triggers=counted.triggers + 1,
        pending=(*counted.pending, trigger)[-most_pending:],
        last_trigger=trigger.number,
    )


def reported(
    counted: CountedPictures, number: int, time_ns: int, place: tuple[float, float] | None = None
) -> CountedPictures:
    """Take note of a feedback: closes its trigger, and shows which numbers were skipped before it."""
    last = counted.last_feedback
    if last == number:
        return counted
    if counted.offset is None:
        announced = not counted.pending or any(trigger.number == number for trigger in counted.pending)
        counted = replace(counted, offset=0 if announced else number - counted.pending[-1].number)
    offset = counted.offset or 0
    wanted = number - offset
    open_ = {trigger.number for trigger in counted.missed}
    if wanted in open_:
        # It only came late.
        missed = tuple(trigger for trigger in counted.missed if trigger.number != wanted)
        return replace(counted, feedbacks=counted.feedbacks + 1, missed=missed)
    if last is not None and number < last:
        # The offset is found anew: the device may have begun at another number.
        return reported(_restarted(counted), number, time_ns, place)
    pending_numbers = {trigger.number for trigger in counted.pending}
    # A longer jump of the numbers is another way of counting, not so many lost pictures.
    longest_gap = 1000
    first = number if last is None or number - last > longest_gap else last + 1
    skipped = [
        Trigger(skip, time_ns, place)
        for skip in range(first - offset, wanted)
        if skip not in pending_numbers and skip not in open_
    ]
    passed = [trigger for trigger in counted.pending if trigger.number < wanted]
    return replace(
        counted,
        # A picture whose trigger was not reported was requested all the same.
        triggers=counted.triggers + len(skipped) + (wanted not in pending_numbers),
        feedbacks=counted.feedbacks + 1,
        pending=tuple(trigger for trigger in counted.pending if trigger.number > wanted),
        missed=(*counted.missed, *sorted([*passed, *skipped], key=lambda trigger: trigger.number)),
        last_feedback=number,
    )


def settled(counted: CountedPictures, now_ns: int) -> CountedPictures:
    """Count as missed what has waited for too long; without any feedback so far nothing is expected."""
    if not counted.feedbacks or not counted.pending or now_ns - counted.pending[0].time_ns <= GRACE_NS:
        return counted
    late = tuple(t for t in counted.pending if now_ns - t.time_ns > GRACE_NS)
    return replace(counted, pending=counted.pending[len(late) :], missed=(*counted.missed, *late))


def numbers(missed: tuple[Trigger, ...]) -> str:
    """Return numbers in words: ``"7, 12-15"``."""
    parts: list[list[int]] = []
    for trigger in missed:
        if parts and trigger.number == parts[-1][1] + 1:
            parts[-1][1] = trigger.number
        else:
            parts.append([trigger.number, trigger.number])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts)


def _restarted(counted: CountedPictures) -> CountedPictures:
    still_open = counted.pending if counted.feedbacks else ()
    before = (*counted.before, *counted.missed, *still_open)
    return CountedPictures(counted.triggers, counted.feedbacks, before=before)


LONGEST = 4000


@dataclass(frozen=True)
class Track:
    """Points in order.

    points (n, 2): latitude and longitude, degrees.
    times_ns (n,): when it was there, UTC.
    thinned: how many times every second point was left out; as long as it stays, points are only added.
    """

    points: Floats = field(default_factory=lambda: np.empty((0, 2)))
    times_ns: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    thinned: int = 0


def extended(track: Track, points: Floats, times_ns: Integers) -> Track:
    """Add points."""
    metres_per_deg = 111_195.0  # mean sphere: only a threshold depends on it
    if not len(points):
        return track
    # Points that lie closer to the last one show nothing new.
    step_m = 0.5
    least_m2 = (step_m * 2**track.thinned) ** 2
    per_degree = np.array([metres_per_deg, metres_per_deg * np.cos(np.radians(points[0, 0]))])
    metres = (points * per_degree).tolist()
    last = (track.points[-1] * per_degree).tolist() if len(track.points) else [np.inf, np.inf]
    new = []
    for row, here in enumerate(metres):
        if not (here[0] - last[0]) ** 2 + (here[1] - last[1]) ** 2 < least_m2:
            new.append(row)
            last = here
    longer = replace(
        track,
        points=np.concatenate([track.points, points[new]]),
        times_ns=np.concatenate([track.times_ns, times_ns[new]]),
    )
    while len(longer.points) > LONGEST:
        longer = Track(longer.points[::2], longer.times_ns[::2], longer.thinned + 1)
    return longer


def place_at(track: Track, time_ns: int) -> tuple[float, float] | None:
    """Return latitude and longitude (deg) at a moment, on the straight line between points; None: unknown."""
    if not len(track.points):
        return None
    # Differences to the moment fit a double; nanoseconds since 1970 do not.
    since = (track.times_ns - time_ns).astype(float)
    latitude, longitude = (float(np.interp(0.0, since, track.points[:, axis])) for axis in (0, 1))
    return latitude, longitude


_HEARTBEAT, _POSITION = 0, 33


@dataclass(frozen=True)
class VehicleState:
    """The last that an autopilot told.

    mode: its mode of flight, as ground stations call it; empty until it is known.
    armed, flown: whether its motors may turn, and whether they ever might.
    height_m: above the take-off.
    speed_m_s, heading_deg: over ground, and where its nose points, from north by east; None if unknown.
    time_ns: when it told its mode last, UTC.
    """

    mode: str = ""
    armed: bool = False
    flown: bool = False
    height_m: float | None = None
    time_ns: int = 0
    speed_m_s: float | None = None
    heading_deg: float | None = None


def vehicle_after(vehicle: VehicleState | None, part: LoggedMessages) -> VehicleState | None:
    """Return the vehicle after frames of its link: of each message the last one counts."""
    # MAV_MODE_FLAG_SAFETY_ARMED.
    armed_bit = 0x80
    wanted = {_HEARTBEAT, _POSITION}
    v2 = 0xFD
    # What MAVLink says of a heading that is not known.
    no_heading = 0xFFFF
    for payload, time_ns in zip(reversed(part.payloads), part.log_ns[::-1].tolist(), strict=True):
        kind = int.from_bytes(payload[7:10], "little") if payload[0] == v2 else payload[5]
        message = _decoded(payload) if kind in wanted else None
        if message is None:
            continue
        if kind == _HEARTBEAT and (message.type == GROUND_STATION or message.autopilot == NO_AUTOPILOT):
            continue
        wanted.discard(kind)
        vehicle = vehicle or VehicleState()
        if kind == _POSITION:
            heading = None if message.hdg == no_heading else message.hdg * 1e-2
            speed = math.hypot(message.vx, message.vy) * 1e-2
            height = message.relative_alt * 1e-3
            vehicle = replace(vehicle, height_m=height, speed_m_s=speed, heading_deg=heading)
        else:
            from pymavlink import mavutil

            mode, armed = str(mavutil.mode_string_v10(message)), bool(message.base_mode & armed_bit)
            if mode.startswith("Mode("):
                # A number that ground stations have no name for.
                mode = f"mode {message.custom_mode}"
            flown = vehicle.flown or armed
            vehicle = replace(vehicle, mode=mode, armed=armed, flown=flown, time_ns=time_ns)
        if not wanted:
            break
    return vehicle


def _decoded(payload: bytes) -> Any:
    from pymavlink.dialects.v20 import ardupilotmega as tables

    try:
        return tables.MAVLink(None).decode(bytearray(payload))
    except (tables.MAVError, TypeError, ValueError):
        return None


# What alarms are about that mean nothing after landing.
OF_FLIGHT = ("link", "fix", "corrections")


@dataclass(frozen=True)
class ShownAlarm:
    """Something to be reported.

    number: counts all alarms of the recording.
    level: ``bad`` (act now), ``warn`` (look at it) or ``note``.
    link: what is concerned; may be empty.
    about: what of it, to know its cure by: ``link``, ``fix NAME``, ``corrections``, ``log`` or nothing.
    ended, ended_ns: ``cured`` or ``landed``, and when; empty while it stands.
    """

    number: int
    level: str
    link: str
    text: str
    time_ns: int
    about: str = ""
    ended: str = ""
    ended_ns: int = 0


@dataclass(frozen=True)
class LinkState:
    """What came over a link.

    first_ns, last_ns: receipt of the first and the last frame, UTC; 0 before there was one.
    recent: of the last seconds: second since 1970, frames, bytes.
    trouble: what the recorder says of it: ``lost`` or ``silent``; empty when all is well.
    corrected_ns: when a correction was sent to its device last, UTC; 0 for never.
    clock_offset_s: clock of this computer less clock of the device.
    """

    frames: int = 0
    frame_bytes: int = 0
    damage_bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0
    recent: tuple[tuple[int, int, int], ...] = ()
    gaps: int = 0
    longest_gap_ns: int = 0
    trouble: str = ""
    corrected_ns: int = 0
    clock_offset_s: float | None = None


@dataclass(frozen=True)
class ReceiverState:
    """The last fix of a receiver.

    fix: as `acquire.channels.layouts.GNSS_STATUS` names it.
    satellites: number used; negative when unknown.
    expected: the best fix that it has had for a while: a lesser one is a loss.
    starved: whether an alarm has reported that its corrections are too old.
    """

    link: str
    fix: str
    satellites: int
    horizontal_m: float | None
    correction_age_s: float | None
    time_ns: int
    expected: str
    since_ns: int
    starved: bool = False


@dataclass(frozen=True)
class Battery:
    """The battery of a vehicle: volts and percent, None when unknown, and the time of its message, UTC."""

    voltage_v: float | None
    percent: int | None
    time_ns: int


@dataclass(frozen=True)
class ComputerState:
    """What the computer says.

    file: name of the log that is read.
    size: bytes of it.
    trouble: why nothing can be read; empty when all is well.
    """

    time_ns: int
    file: str
    size: int
    ended: bool
    free_bytes: int | None
    trouble: str = ""


@dataclass(frozen=True)
class RecordingState:
    """A recording.

    first_ns, last_ns: receipt of the first and the last message, UTC; 0 before there was one.
    pictures: where pictures were taken, by the link and the kind of their report.
    stations: latitude and longitude of base stations, degrees.
    marks: rising edges on the time mark input of a receiver: reported, and skipped by its counter.
    grown_ns: when the log was seen to have grown last, clock of this computer, UTC.
    growth: earlier looks as (time, size), to tell how fast it grows.
    """

    flight: str = ""
    first_ns: int = 0
    last_ns: int = 0
    links: Mapping[str, LinkState] = field(default_factory=dict)
    receivers: Mapping[str, ReceiverState] = field(default_factory=dict)
    exposures: Mapping[str, CountedPictures] = field(default_factory=dict)
    pictures: Mapping[tuple[str, str], Track] = field(default_factory=dict)
    tracks: Mapping[str, Track] = field(default_factory=dict)
    stations: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    marks: Mapping[str, CountedPictures] = field(default_factory=dict)
    batteries: Mapping[str, Battery] = field(default_factory=dict)
    vehicles: Mapping[str, VehicleState] = field(default_factory=dict)
    alarms: tuple[ShownAlarm, ...] = ()
    raised: int = 0
    look: ComputerState | None = None
    grown_ns: int = 0
    stalled: bool = False
    growth: tuple[tuple[int, int], ...] = ()

    @property
    def landed(self) -> bool:
        """Whether vehicles have flown and none may turn its motors any more."""
        told = self.vehicles.values()
        return any(one.flown for one in told) and not any(one.armed for one in told)


def raised(
    state: RecordingState, level: str, link: str, text: str, time_ns: int, about: str = ""
) -> RecordingState:
    """Raise an alarm; of what a crew switches off after landing it is a note."""
    if state.landed and about.partition(" ")[0] in OF_FLIGHT:
        level = "note"
    alarm = ShownAlarm(state.raised + 1, level, link, text, time_ns, about)
    # How many alarms are kept.
    most_alarms = 200
    return replace(state, alarms=(*state.alarms, alarm)[-most_alarms:], raised=alarm.number)


def ended(
    state: RecordingState, how: str, time_ns: int, about: Callable[[ShownAlarm], bool]
) -> RecordingState:
    """End the alarms that still stand and are about something: ``cured`` or ``landed``."""
    if not any(not alarm.ended and about(alarm) for alarm in state.alarms):
        return state
    alarms = tuple(
        replace(alarm, ended=how, ended_ns=time_ns) if not alarm.ended and about(alarm) else alarm
        for alarm in state.alarms
    )
    return replace(state, alarms=alarms)


def in_order(state: RecordingState, known: int) -> RecordingState:
    """Put the alarms after number `known` in the order of their times: channels are taken one by one."""
    old = tuple(alarm for alarm in state.alarms if alarm.number <= known)
    new = sorted(state.alarms[len(old) :], key=lambda alarm: alarm.time_ns)
    first = state.raised - len(new) + 1
    numbered = (replace(alarm, number=number) for number, alarm in enumerate(new, first))
    return replace(state, alarms=(*old, *numbered))

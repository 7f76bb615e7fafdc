"""The state of a recording, as far as it is known from its log and from the computer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from acquire.monitor.exposures import Exposures
from acquire.monitor.track import Track
from acquire.monitor.vehicle import Vehicle

# How many alarms are kept.
_MOST_ALARMS = 200


@dataclass(frozen=True)
class Alarm:
    """Something to be told.

    Parameters
    ----------
    number : int
        Counts all alarms of the recording.
    level : str
        ``bad`` (act now), ``warn`` (look at it) or ``note``.
    link : str
        What is concerned; may be empty.
    text : str
        What happened.
    time_ns : int
        When, UTC.
    """

    number: int
    level: str
    link: str
    text: str
    time_ns: int


@dataclass(frozen=True)
class Link:
    """What came over a link.

    Parameters
    ----------
    frames, frame_bytes, damage_bytes : int
        Number and size.
    first_ns, last_ns : int
        Receipt of the first and the last frame, UTC; 0 before there was one.
    recent : tuple of (int, int, int)
        Of the last seconds: second since 1970, frames, bytes.
    gaps : int
        Number of pauses.
    longest_gap_ns : int
        The longest of them.
    trouble : str
        What the recorder says of it: ``lost`` or ``silent``; empty when all is well.
    corrected_ns : int
        When a correction was sent to its device last, UTC; 0 for never.
    clock_offset_s : float or None
        Clock of this computer less clock of the device.
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
class Receiver:
    """The last fix of a receiver.

    Parameters
    ----------
    link : str
        The link that told it.
    fix : str
        As `acquire.channels.layouts.GNSS_STATUS` names it.
    satellites : int
        Number used; negative when unknown.
    horizontal_m, correction_age_s : float or None
        What the receiver claims.
    time_ns : int
        When it was received, UTC.
    expected : str
        The best fix that it has had for a while: a lesser one is a loss.
    since_ns : int
        Since when the fix is what it is.
    starved : bool
        Whether it was told that its corrections are too old.
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
    """The battery of a vehicle: volts, and what remains in percent; None when unknown."""

    voltage_v: float | None
    percent: int | None


@dataclass(frozen=True)
class Look:
    """What the computer says.

    Parameters
    ----------
    time_ns : int
        Its clock, UTC.
    file : str
        Name of the log that is read.
    size : int
        Bytes of it.
    ended : bool
        Whether the log has its end.
    free_bytes : int or None
        What is left on its disk.
    trouble : str
        Why nothing can be read; empty when all is well.
    """

    time_ns: int
    file: str
    size: int
    ended: bool
    free_bytes: int | None
    trouble: str = ""


@dataclass(frozen=True)
class State:
    """A recording.

    Parameters
    ----------
    flight : str
        Name of its first file.
    first_ns, last_ns : int
        Receipt of the first and the last message, UTC; 0 before there was one.
    links, receivers, exposures, tracks, batteries, vehicles : mapping
        By name of link or receiver.
    pictures : mapping of str to Track
        Where pictures were taken, by the link and the kind of their report.
    stations : mapping of str to (float, float)
        Latitude and longitude of base stations, degrees.
    marks : mapping of str to Exposures
        Rising edges on the time mark input of a receiver: reported, and skipped by its counter.
    alarms : tuple of Alarm
        The latest ones.
    raised : int
        Number of all alarms.
    look : Look or None
        The last one.
    grown_ns : int
        When the log was seen to have grown last, clock of this computer, UTC.
    stalled : bool
        Whether it has not for too long.
    growth : tuple of (int, int)
        Earlier looks as (time, size), to tell how fast it grows.
    """

    flight: str = ""
    first_ns: int = 0
    last_ns: int = 0
    links: Mapping[str, Link] = field(default_factory=dict)
    receivers: Mapping[str, Receiver] = field(default_factory=dict)
    exposures: Mapping[str, Exposures] = field(default_factory=dict)
    pictures: Mapping[tuple[str, str], Track] = field(default_factory=dict)
    tracks: Mapping[str, Track] = field(default_factory=dict)
    stations: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    marks: Mapping[str, Exposures] = field(default_factory=dict)
    batteries: Mapping[str, Battery] = field(default_factory=dict)
    vehicles: Mapping[str, Vehicle] = field(default_factory=dict)
    alarms: tuple[Alarm, ...] = ()
    raised: int = 0
    look: Look | None = None
    grown_ns: int = 0
    stalled: bool = False
    growth: tuple[tuple[int, int], ...] = ()


def raised(state: State, level: str, link: str, text: str, time_ns: int) -> State:
    """Raise an alarm."""
    alarm = Alarm(state.raised + 1, level, link, text, time_ns)
    return replace(state, alarms=(*state.alarms, alarm)[-_MOST_ALARMS:], raised=alarm.number)


def in_order(state: State, known: int) -> State:
    """Put the alarms after number `known` in the order of their times: channels are taken one by one."""
    old = tuple(alarm for alarm in state.alarms if alarm.number <= known)
    new = sorted(state.alarms[len(old) :], key=lambda alarm: alarm.time_ns)
    first = state.raised - len(new) + 1
    numbered = (replace(alarm, number=number) for number, alarm in enumerate(new, first))
    return replace(state, alarms=(*old, *numbered))

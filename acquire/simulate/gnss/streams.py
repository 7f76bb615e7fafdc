"""What receivers put on the wire: frames with the moments at which they are sent.

TIM-TM2: edges at the receiver's pin.

Source: u-blox F9 HPG 1.32 interface description, TIM-TM2.

NAV-PVT and NAV-SVIN: what a receiver itself says where it is.

Source: u-blox F9 HPG 1.32 interface description, NAV-PVT and NAV-SVIN.
"""

import datetime as dt
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.gnss import msm, navigation_messages
from acquire.simulate.gnss.observations import Clock, SatelliteObservations, Session, correlated
from acquire.simulate.gnss.settings import SIGNALS, UBX_SYSTEM
from drivers import rtcm3, ubx
from drivers.ubx.decode import signal_layout
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import GPS_EPOCH_NS, SECOND_NS, WEEK_S

SOLUTION_KIND, SURVEY_KIND = 0x0107, 0x013B
_SOLUTION_LATENCY_NS = 80_000_000
_EVERYTHING_VALID, _CONFIRMED, _FIX_OK = 0x07, 0xE0, 0x01
_LEAST_SATELLITES = 4
# Errors of the receiver's own solution by codes (east, north, up), how long they stay, and of its speed.
_SIGMA_M, _CORRELATION_S, _SPEED_SIGMA_M_S = (0.9, 0.9, 1.6), 60.0, 0.04


def solution_messages(
    observations: SatelliteObservations, geoid_m: float, leap_s: int, rng: np.random.Generator
) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload of NAV-PVT, one per epoch with four satellites.

    geoid_m: height of the geoid above the ellipsoid that the receiver uses for heights above sea level.
    """
    clock, place = observations.clock, observations.place
    count = len(clock)
    step = float(np.median(np.diff(clock.tag_gps_ns))) / SECOND_NS if count > 1 else 1.0
    error = correlated(rng.standard_normal((3, count)), step / _CORRELATION_S).T * _SIGMA_M
    frame = place.axes
    metres_per_rad = 6_378_137.0
    lat = np.degrees(place.lat + error[:, 1] / metres_per_rad)
    lon = np.degrees(place.lon + error[:, 0] / metres_per_rad / np.cos(place.lat))
    height = place.height_m + error[:, 2]
    speed = np.einsum("nij,nj->ni", frame, place.velocity_m_s)
    speed = speed + _SPEED_SIGMA_M_S * rng.standard_normal((count, 3))
    ground = np.hypot(speed[:, 0], speed[:, 1])
    course = np.degrees(np.arctan2(speed[:, 0], speed[:, 1])) % 360
    numbers, pdop = dilution(observations)
    horizontal, vertical = float(np.hypot(*_SIGMA_M[:2])), _SIGMA_M[2]
    true_ns = clock.true_gps_ns
    for k in np.flatnonzero(numbers >= _LEAST_SATELLITES).tolist():
        nominal = int(clock.tag_gps_ns[k])
        utc_ns = int(true_ns[k]) + GPS_EPOCH_NS - leap_s * SECOND_NS
        second = (utc_ns + 5_000_000) // SECOND_NS
        civil, nano = dt.datetime.fromtimestamp(second, dt.UTC), utc_ns - second * SECOND_NS
        east, north, up = speed[k]
        metres = (height[k], height[k] - geoid_m, horizontal, vertical, north, east, -up, ground[k])
        yield (
            int(true_ns[k]) + _SOLUTION_LATENCY_NS,
            struct.pack(
                "<IH5BBIiBBBBiiiiIIiiiiiIIHBB4xihH",
                nominal % (WEEK_S * SECOND_NS) // 1_000_000,
                *civil.timetuple()[:6],
                *(_EVERYTHING_VALID, 25, nano, 3, _FIX_OK, _CONFIRMED, int(numbers[k])),
                *(round(angle * 1e7) for angle in (lon[k], lat[k])),
                *(round(value * 1e3) for value in metres),
                round(course[k] * 1e5),
                round(_SPEED_SIGMA_M_S * np.sqrt(3) * 1e3),
                round(np.degrees(np.arctan2(_SPEED_SIGMA_M_S, max(ground[k], 1e-3))) * 1e5),
                min(round(pdop[k] * 100), 9999),
                *[0] * 5,
            ),
        )


def survey_messages(observations: SatelliteObservations, announced_m: Floats) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending and payload of NAV-SVIN, every second: its survey ended before the session."""
    clock = observations.clock
    whole = clock.tag_gps_ns % SECOND_NS == 0
    hundredths = np.rint(announced_m * 100).astype(int)
    fine = np.rint((announced_m - hundredths / 100) * 1e4).astype(int)
    first = int(clock.tag_gps_ns[0]) if len(clock) else 0
    for tag, true in zip(clock.tag_gps_ns[whole].tolist(), clock.true_gps_ns[whole].tolist(), strict=True):
        passed = 3600 + (tag - first) // SECOND_NS
        yield (
            true + _SOLUTION_LATENCY_NS,
            struct.pack(
                "<B3xII3i3bxIIBB2x",
                *(0, tag % (WEEK_S * SECOND_NS) // 1_000_000, passed),
                *(*hundredths.tolist(), *fine.tolist()),
                *(9500, passed, 1, 0),
            ),
        )


def dilution(observations: SatelliteObservations) -> tuple[Integers, Floats]:
    """Return the number of satellites and the PDOP of each epoch (99 where it is not defined)."""
    rows = observations.rows[observations.rows["signal"] == 0]
    count = len(observations.clock)
    cosine = np.cos(rows["elevation"])
    plane = cosine * np.sin(rows["azimuth"]), cosine * np.cos(rows["azimuth"])
    design = np.column_stack([*plane, np.sin(rows["elevation"]), np.ones(len(rows))])
    normal = np.zeros((count, 4, 4))
    np.add.at(normal, rows["epoch"], design[:, :, None] * design[:, None, :])
    numbers = np.bincount(rows["epoch"], minlength=count)
    pdop = np.full(count, 99.0)
    good = (numbers >= _LEAST_SATELLITES) & (np.linalg.cond(normal) < 1e8)
    pdop[good] = np.sqrt(np.trace(np.linalg.inv(normal[good])[:, :3, :3], axis1=1, axis2=2))
    return numbers, pdop


TIME_MARK_KIND = 0x0D03
TimeBase = Literal["receiver", "gnss", "utc"]
_RUNNING, _FALLING, _UTC_KNOWN, _VALID, _RISING = 0x01, 0x04, 0x20, 0x40, 0x80
_BASE = {"receiver": 0, "gnss": 1, "utc": 2}


@dataclass(frozen=True)
class Pulses:
    """Pulses at the receiver's pin.

    rising_gps_ns (n,): true GPS times of the rising edges, rising.
    falling_gps_ns (n,) or (0,): of the falling edge of each pulse; empty: falling edges are not marked.
    time_base: what the messages say that their times are.
    stamped_in: what they are: another one than `time_base` is a fault.
    accuracy_s: standard deviation of the marks, which the messages tell.
    first_count: counter of rising edges before the first one.
    """

    rising_gps_ns: Integers
    falling_gps_ns: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    time_base: TimeBase = "gnss"
    stamped_in: TimeBase = "gnss"
    accuracy_s: float = 20e-9
    first_count: int = 0


def time_mark_messages(
    events: Pulses, clock: Clock, leap_s: int, rng: np.random.Generator
) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload.

    Edges are reported with the next epoch of navigation, one of each kind in a message; several pulses
    between two epochs give several messages.

    leap_s: GPS time minus UTC.
    """
    # From an edge to its message on the wire.
    latency_ns = 90_000_000
    true_ns = clock.true_gps_ns
    latest = [0, 0]
    for epoch, count, edges in _marks(events, true_ns):
        flags = _RUNNING | _BASE[events.time_base] << 3 | _UTC_KNOWN | _VALID
        for kind, (edge_ns, bit) in enumerate(zip(edges, (_RISING, _FALLING), strict=True)):
            noise = round(float(rng.normal(0, events.accuracy_s)) * SECOND_NS)
            if edge_ns is not None:
                flags |= bit
                latest[kind] = _stamp(edge_ns + noise, events, clock, leap_s)
        (rising_week, *rising), (falling_week, *falling) = (
            (*divmod(stamp // 1_000_000, WEEK_S * 1000), stamp % 1_000_000) for stamp in latest
        )
        accuracy_ns = max(round(events.accuracy_s * SECOND_NS), 1)
        head = struct.pack("<BBHHH", 0, flags, count % 65_536, rising_week, falling_week)
        body = struct.pack("<5I", *rising, *falling, accuracy_ns)
        yield int(true_ns[epoch]) + latency_ns, head + body


def _marks(events: Pulses, true_ns: Integers) -> Iterator[tuple[int, int, tuple[int | None, int | None]]]:
    """Yield the epoch that tells of a mark, the number of its rising edge, and its edges."""
    rising = np.searchsorted(true_ns, events.rising_gps_ns).tolist()
    falling = np.searchsorted(true_ns, events.falling_gps_ns).tolist()
    for place, epoch in enumerate(rising):
        count = events.first_count + place + 1
        edge = int(events.rising_gps_ns[place])
        if place < len(falling) and falling[place] == epoch:
            end = int(events.falling_gps_ns[place])
            if epoch < len(true_ns):
                yield epoch, count, (edge, end)
            continue
        if epoch < len(true_ns):
            yield epoch, count, (edge, None)
        if place < len(falling) and falling[place] < len(true_ns):
            yield falling[place], count, (None, int(events.falling_gps_ns[place]))


def _stamp(gps_ns: int, events: Pulses, clock: Clock, leap_s: int) -> int:
    if events.stamped_in == "utc":
        return gps_ns - leap_s * SECOND_NS
    if events.stamped_in == "receiver":
        at = int(np.searchsorted(clock.tag_gps_ns, gps_ns)) - 1
        return gps_ns + round(float(clock.bias_s[max(at, 0)]) * SECOND_NS)
    return gps_ns


_LEAP_KNOWN, _CLOCK_RESET, _VERSION = 0x01, 0x02, 1
Timed = tuple[int, bytes]


def messages(observations: SatelliteObservations, leap_s: int) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload, one per epoch that has signals."""
    # From the measurement until the message is complete on a fast line.
    latency_ns = 60_000_000
    rows = observations.rows
    records = _records(observations).tobytes()
    clock = observations.clock
    bounds = np.searchsorted(rows["epoch"], np.arange(len(clock) + 1))
    true_ns = clock.true_gps_ns
    for epoch, (first, after) in enumerate(zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)):
        if first == after:
            continue
        week, of_week = divmod(int(clock.tag_gps_ns[epoch]), WEEK_S * SECOND_NS)
        status = _LEAP_KNOWN | (_CLOCK_RESET if clock.step[epoch] else 0)
        head = struct.pack("<dHbBBB2x", of_week / SECOND_NS, week, leap_s, after - first, status, _VERSION)
        yield int(true_ns[epoch]) + latency_ns, head + records[first * 32 : after * 32]


def _records(observations: SatelliteObservations) -> NDArray[np.void]:
    # The interface description caps the time of lock here.
    longest_lock_ms = 64_500
    rows = observations.rows
    satellites = observations.satellites
    out = np.zeros(len(rows), signal_layout())
    systems = np.array([UBX_SYSTEM[s.system] for s in satellites], np.uint8)
    numbers = np.array([s.truth.number for s in satellites], np.uint8)
    signals = np.array([[signal.ubx for signal in SIGNALS[s.system]] for s in satellites], np.uint8)
    out["prMes"], out["cpMes"], out["doMes"] = rows["code_m"], rows["phase_cycles"], rows["doppler_hz"]
    out["gnssId"], out["svId"] = systems[rows["satellite"]], numbers[rows["satellite"]]
    out["sigId"] = signals[rows["satellite"], rows["signal"]]
    out["locktime"] = np.minimum(np.floor(rows["lock_s"] * 1e3), longest_lock_ms)
    out["cno"] = np.rint(rows["cn0_dbhz"])
    out["prStdev"] = _power_of_two(rows["code_sigma_m"], 0.01)
    phase_sigma = np.clip(np.ceil(rows["phase_sigma_cycles"] / 0.004), 1, 15)
    out["cpStdev"] = np.where(rows["has_phase"], phase_sigma, 15)
    out["doStdev"] = _power_of_two(rows["doppler_sigma_hz"], 0.002)
    out["trkStat"] = (
        1 + 2 * rows["has_phase"].astype(np.uint8) + 4 * rows["half_valid"] + 8 * rows["half_subtracted"]
    )
    return out


def _power_of_two(sigma: Floats, unit: float) -> Floats:
    return np.clip(np.ceil(np.log2(np.maximum(sigma, unit) / unit)), 0, 15)


@dataclass(frozen=True)
class Stream:
    """Frames of one receiver.

    time_gps_ns (n,): when each one is complete on the wire, GPS nanoseconds, not decreasing.
    frames (n,): the frames.
    """

    time_gps_ns: Integers
    frames: list[bytes]

    @property
    def data(self) -> bytes:
        """All bytes one after another."""
        return b"".join(self.frames)


def rover_ubx(
    session: Session, events: Pulses | None = None, geoid_m: float = 0.0, *, rng: np.random.Generator
) -> Stream:
    """Return the rover's stream: RXM-RAWX, RXM-SFRBX, NAV-PVT and TIM-TM2."""
    for_position, for_marks = rng.spawn(2)
    solved = solution_messages(session.rover, geoid_m, session.sky.leap_s, for_position)
    parts = [*_raw(session, session.rover), _ubx(SOLUTION_KIND, solved)]
    if events is not None:
        marks = time_mark_messages(events, session.rover.clock, session.sky.leap_s, for_marks)
        parts.append(_ubx(TIME_MARK_KIND, marks))
    return _stream(parts)


def base_ubx(session: Session) -> Stream:
    """Return the base's stream of u-blox: RXM-RAWX, RXM-SFRBX and NAV-SVIN with the announced position."""
    surveyed = survey_messages(session.base, session.announced_m)
    return _stream([*_raw(session, session.base), _ubx(SURVEY_KIND, surveyed)])


def _raw(session: Session, receiver: SatelliteObservations) -> list[list[Timed]]:
    """Return what a receiver measured, and what the satellites told it."""
    # UBX-RXM-RAWX.
    raw_kind = 0x0215
    broadcast = navigation_messages.messages(receiver, session.span_gps_ns, session.sky)
    return [_ubx(raw_kind, messages(receiver, session.sky.leap_s)), _ubx(navigation_messages.KIND, broadcast)]


def base_rtcm(session: Session) -> Stream:
    """Return the base's stream of RTCM 3: 1006, 1013, 1077 and 1097, with ephemerides 1019 and 1046."""
    parts = (
        msm.positions(session),
        msm.dates(session),
        msm.observation_messages(session.base),
        msm.ephemerides(session),
    )
    return _stream([[(time, rtcm3.encode(payload)) for time, payload in part] for part in parts])


def _ubx(kind: int, messages: Iterable[Timed]) -> list[Timed]:
    return [(time, ubx.encode(kind, payload)) for time, payload in messages]


def _stream(parts: Iterable[list[Timed]]) -> Stream:
    timed = sorted((item for part in parts for item in part), key=lambda item: item[0])
    return Stream(np.array([time for time, _ in timed], np.int64), [frame for _, frame in timed])

"""What receivers put on the wire: frames with the moments at which they are sent."""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.gnss import msm, navigation_messages, navigation_solution, time_marks
from acquire.simulate.gnss.observations import SatelliteObservations
from acquire.simulate.gnss.session import Session
from acquire.simulate.gnss.settings import SIGNALS, UBX_SYSTEM
from acquire.simulate.gnss.time_marks import Pulses
from drivers import rtcm3, ubx
from drivers.ubx.decode import signal_layout
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import SECOND_NS, WEEK_S

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
    solved = navigation_solution.messages(session.rover, geoid_m, session.sky.leap_s, for_position)
    parts = [*_raw(session, session.rover), _ubx(navigation_solution.KIND, solved)]
    if events is not None:
        marks = time_marks.messages(events, session.rover.clock, session.sky.leap_s, for_marks)
        parts.append(_ubx(time_marks.KIND, marks))
    return _stream(parts)


def base_ubx(session: Session) -> Stream:
    """Return the base's stream of u-blox: RXM-RAWX, RXM-SFRBX and NAV-SVIN with the announced position."""
    surveyed = navigation_solution.survey_messages(session.base, session.announced_m)
    return _stream([*_raw(session, session.base), _ubx(navigation_solution.SURVEY_KIND, surveyed)])


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

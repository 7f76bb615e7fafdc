"""What receivers put on the wire: frames with the moments at which they are sent."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from acquire.simulate.gnss import navigation_solution, rawx, rtcm_station, subframes, time_marks
from acquire.simulate.gnss.msm import observation_messages
from acquire.simulate.gnss.navigation_solution import OwnPosition
from acquire.simulate.gnss.session import Session
from acquire.simulate.gnss.time_marks import Events
from drivers import rtcm3, ubx
from drivers.arrays import Integers

Timed = tuple[int, bytes]


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
    session: Session,
    events: Events | None = None,
    own_position: OwnPosition | None = None,
    *,
    rng: np.random.Generator,
) -> Stream:
    """Return the rover's stream: RXM-RAWX, RXM-SFRBX, NAV-PVT and TIM-TM2."""
    for_position, for_marks = rng.spawn(2)
    parts = [
        _ubx(rawx.KIND, rawx.messages(session.rover, session.sky.leap_s)),
        _ubx(subframes.KIND, subframes.messages(session.rover, session.span_gps_ns, session.sky)),
        _ubx(
            navigation_solution.KIND,
            navigation_solution.messages(
                session.rover, own_position or OwnPosition(), session.sky.leap_s, for_position
            ),
        ),
    ]
    if events is not None:
        marks = time_marks.messages(events, session.rover.clock, session.sky.leap_s, for_marks)
        parts.append(_ubx(time_marks.KIND, marks))
    return _stream(parts)


def base_ubx(session: Session) -> Stream:
    """Return the base's stream of u-blox: RXM-RAWX, RXM-SFRBX and NAV-SVIN with the announced position."""
    return _stream(
        [
            _ubx(rawx.KIND, rawx.messages(session.base, session.sky.leap_s)),
            _ubx(subframes.KIND, subframes.messages(session.base, session.span_gps_ns, session.sky)),
            _ubx(
                navigation_solution.SURVEY_KIND,
                navigation_solution.survey_messages(session.base, session.announced_m),
            ),
        ]
    )


def base_rtcm(
    session: Session, *, station: int = 1, ephemerides: bool = True, every_s: float = 1.0
) -> Stream:
    """Return the base's stream of RTCM 3: 1006, 1013, 1077 and 1097, with ephemerides 1019 and 1046."""
    parts = [
        rtcm_station.positions(session, station),
        rtcm_station.dates(session, station),
        observation_messages(session.base, station, every_s),
    ]
    if ephemerides:
        parts.append(rtcm_station.ephemerides(session))
    return _stream([[(time, rtcm3.encode(payload)) for time, payload in part] for part in parts])


def _ubx(kind: int, messages: Iterable[Timed]) -> list[Timed]:
    return [(time, ubx.encode(kind, payload)) for time, payload in messages]


def _stream(parts: Iterable[list[Timed]]) -> Stream:
    timed = [item for part in parts for item in part]
    order = np.argsort(np.array([time for time, _ in timed], np.int64), kind="stable")
    return Stream(
        np.array([timed[i][0] for i in order.tolist()], np.int64), [timed[i][1] for i in order.tolist()]
    )

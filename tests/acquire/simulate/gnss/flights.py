"""A short flight beside a base, measured and on the wire."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from acquire.simulate.gnss.constellation import Antenna
from acquire.simulate.gnss.observations import Session, simulate
from acquire.simulate.gnss.settings import ROVER, ReceiverModel, SkySettings
from acquire.simulate.gnss.streams import Pulses, Stream, base_rtcm, base_ubx, rover_ubx

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

SECOND = 1_000_000_000
BASE_DEG = (-22.7, -43.2, 30.0)
DURATION_S = 110


def gps_ns(*civil: int) -> int:
    """GPS time of a date and time counted in GPS time."""
    return int((dt.datetime(*civil) - dt.datetime(1980, 1, 6)).total_seconds()) * SECOND  # type: ignore[arg-type]


# Page 18 of subframe 4, the ionosphere, comes within: every 12.5 minutes, at 13:16:18.
START = gps_ns(2025, 6, 15, 13, 15, 20)


def ecef(lat_deg: float, lon_deg: float, height_m: float) -> Floats:
    transformer = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.array(transformer.transform(lon_deg, lat_deg, height_m))


BASE_M = ecef(*BASE_DEG)


def local_axes() -> Floats:
    """Rows east, north, up at the base, from differences of geodetic coordinates."""
    lat, lon, height = BASE_DEG
    rows = [
        ecef(lat, lon + 1e-7, height) - ecef(lat, lon - 1e-7, height),
        ecef(lat + 1e-7, lon, height) - ecef(lat - 1e-7, lon, height),
        ecef(lat, lon, height + 1) - ecef(lat, lon, height - 1),
    ]
    return np.array([row / np.linalg.norm(row) for row in rows])


AXES = local_axes()


@dataclass(frozen=True)
class Loop:
    """A closed way beside the base: 300 m to the north, 10 m/s, up and down."""

    start_gps_ns: int
    turn_s: float = 90.0

    def enu(self, time: Times) -> Floats:
        angle = 2 * np.pi * (time - self.start_gps_ns) / 1e9 / self.turn_s
        return np.stack([140 * np.sin(angle), 300 + 140 * np.cos(angle), 50 + 8 * np.sin(2 * angle)], axis=1)

    def position(self, time: Times) -> Floats:
        return BASE_M + self.enu(time) @ AXES

    def velocity(self, time: Times) -> Floats:
        step = SECOND // 1000
        return (self.position(time + step) - self.position(time - step)) / 2e-3

    def antenna(self) -> Antenna:
        return Antenna(self.position, self.velocity)


def fly(
    start: int = START,
    duration_s: int = DURATION_S,
    seed: int = 3,
    rover_model: ReceiverModel = ROVER,
    base_shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sky: SkySettings | None = None,
) -> Session:
    return simulate(
        Loop(start).antenna(),
        Antenna.still(BASE_M),
        (start, start + duration_s * SECOND),
        rng=np.random.default_rng(seed),
        rover_model=rover_model,
        base_shift_m=base_shift_m,
        sky=sky,
    )


def pulses(session: Session, every_s: float = 2.0) -> Pulses:
    first, last = session.span_gps_ns
    rising = np.arange(first + 5 * SECOND, last - 5 * SECOND, round(every_s * 1e9)) + 123_456_789
    return Pulses(rising, rising + 150_000_000)


@dataclass(frozen=True)
class Flight:
    """A session with its streams and the events on the rover's pin."""

    session: Session
    events: Pulses
    rover: Stream
    base_ubx: Stream
    base_rtcm: Stream


def streams(session: Session) -> Flight:
    events = pulses(session)
    rover = rover_ubx(session, events, rng=np.random.default_rng(1))
    return Flight(session, events, rover, base_ubx(session), base_rtcm(session))

"""What lies between a satellite and an antenna: range, its rate, direction."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from acquire.simulate.gnss.constellation import Satellite
from acquire.simulate.gnss.settings import EARTH_RATE_RAD_S, LIGHT_M_S
from photocal.base.arrays import Columns, Floats, Integers
from photocal.base.geodesy import enu_axes, geodetic

Path = Callable[[Integers], Floats]


@dataclass(frozen=True)
class Antenna:
    """The way of an antenna's phase centre.

    position, velocity: from GPS nanoseconds, int64 (n,), to metres and metres per second, earth-centred,
        earth-fixed, float64 (n, 3). They are asked up to a second before and after a session.
    """

    position: Path
    velocity: Path

    @classmethod
    def still(cls, ecef_m: Floats) -> Self:
        """Return an antenna that does not move, at float64 (3,)."""
        place = np.array(ecef_m, np.float64)
        return cls(lambda t: np.tile(place, (len(t), 1)), lambda t: np.zeros((len(t), 3)))


@dataclass(frozen=True)
class AntennaTrack(Columns):
    """An antenna at the epochs of a receiver.

    position_m, velocity_m_s (n, 3): Earth-centred, earth-fixed.
    lat, lon, height_m (n,): geodetic, radians and metres above WGS 84's ellipsoid.
    """

    position_m: Floats
    velocity_m_s: Floats
    lat: Floats
    lon: Floats
    height_m: Floats

    @property
    def axes(self) -> Floats:
        """Unit vectors to the east, the north and up, float64 (n, 3, 3)."""
        return enu_axes(np.degrees(self.lat), np.degrees(self.lon))


def place(position_m: Floats, velocity_m_s: Floats) -> AntennaTrack:
    """Return an antenna with its geodetic coordinates."""
    lat, lon, height = geodetic(position_m)
    return AntennaTrack(position_m, velocity_m_s, np.radians(lat), np.radians(lon), height)


@dataclass(frozen=True)
class SatelliteView:
    """A satellite as an antenna receives it.

    range_m, range_rate_m_s (n,): way of the signal that arrives at the epoch, and its derivative.
    azimuth, elevation (n,): radians.
    clock_s, clock_rate (n,): satellite clock at the moment of transmission.
    wind_up (n,): cycles by which the phase grows as satellite and antenna turn against each other.
    """

    range_m: Floats
    range_rate_m_s: Floats
    azimuth: Floats
    elevation: Floats
    clock_s: Floats
    clock_rate: Floats
    wind_up: Floats


def link(satellite: Satellite, seconds: Floats, origin_gps_ns: int, at: AntennaTrack) -> SatelliteView:
    """Solve the light time equation.

    The earth turns while the signal travels (Sagnac effect): the satellite's position at transmission is
    turned into the earth-fixed frame of the arrival.

    seconds (n,): GPS time of arrival since `origin_gps_ns`.
    """
    travel = np.full(len(seconds), 0.075)
    # The satellite moves 4 km/s: the error shrinks by 1e-5 with each step, from 60 m.
    for _ in range(3):
        state = satellite.state(seconds - travel, origin_gps_ns)
        position = _turned(state.position_m, EARTH_RATE_RAD_S * travel)
        towards = position - at.position_m
        distance = np.linalg.norm(towards, axis=1)
        travel = distance / LIGHT_M_S
    unit = towards / distance[:, None]
    velocity = _turned(state.velocity_m_s, EARTH_RATE_RAD_S * travel)
    # d/dt of |R(w tau) x(t - tau) - a(t)| with tau = range / c, solved for the rate of the range.
    swept = np.stack([position[:, 1], -position[:, 0], np.zeros(len(position))], axis=1) * EARTH_RATE_RAD_S
    steady = np.einsum("ij,ij->i", unit, velocity - at.velocity_m_s)
    rate = steady / (1 + np.einsum("ij,ij->i", unit, velocity - swept) / LIGHT_M_S)
    east, north, up = np.moveaxis(at.axes, 1, 0)
    e, n, u = (np.einsum("ij,ij->i", axis, unit) for axis in (east, north, up))
    clock_rate = state.clock_rate * (1 - rate / LIGHT_M_S)
    turns = _wind_up(position, -unit, _sun(seconds, origin_gps_ns), (east, north))
    return SatelliteView(distance, rate, np.arctan2(e, n), np.arcsin(u), state.clock_s, clock_rate, turns)


def _wind_up(satellite: Floats, ray: Floats, sun: Floats, antenna: tuple[Floats, Floats]) -> Floats:
    """Turns between a satellite with its panels to the sun and an antenna on the ground (Wu et al. 1993)."""
    down = -_unit(satellite)
    across = _unit(np.cross(down, sun))
    along = np.cross(across, down)

    def dipole(x: Floats, y: Floats, sign: float) -> Floats:
        """Effective dipole of an antenna for a circularly polarised signal (Wu et al. 1993)."""
        return np.asarray(x - ray * np.einsum("ij,ij->i", ray, x)[:, None] + sign * np.cross(ray, y))

    sent, received = dipole(along, across, -1.0), dipole(*antenna, 1.0)
    cosine = np.einsum("ij,ij->i", _unit(sent), _unit(received))
    sense = np.sign(np.einsum("ij,ij->i", ray, np.cross(sent, received)))
    return np.asarray(np.unwrap(sense * np.arccos(np.clip(cosine, -1, 1))) / (2 * np.pi))


def _sun(seconds: Floats, origin_gps_ns: int) -> Floats:
    """Direction of the sun, earth-fixed, to a hundredth of a degree (Montenbruck and Gill 2000, 3.3.2)."""
    # Days since 2000 January 1, 12 h; universal time lies 18 s and less behind GPS time.
    days = (origin_gps_ns / 1e9 + seconds - 18.0) / 86_400 - 7_300.5
    anomaly = np.radians(357.5256 + 0.985600259 * days)
    longitude = anomaly + np.radians(282.94 + (6892 * np.sin(anomaly) + 72 * np.sin(2 * anomaly)) / 3600)
    tilt = np.radians(23.4393)
    x, y = np.cos(longitude), np.cos(tilt) * np.sin(longitude)
    inertial = np.stack([x, y, np.sin(tilt) * np.sin(longitude)], axis=1)
    return _turned(inertial, np.radians(280.46062 + 360.98564737 * days))


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _turned(vectors: Floats, angle: Floats) -> Floats:
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[:, 0], vectors[:, 1]
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, vectors[:, 2]], axis=1)

"""A sky of GPS and Galileo satellites by chance, with parameters of the size that real messages have.

What lies between a satellite and an antenna: range, its rate, direction.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from acquire.simulate.gnss.ephemeris import Ephemeris, gravity, quantised, renewed
from acquire.simulate.gnss.settings import EARTH_RATE_RAD_S, GALILEO, GPS, LIGHT_M_S
from photocal.base.arrays import Columns, Floats, Integers
from photocal.base.geodesy import enu_axes, geodetic
from photocal.base.time_scales import SECOND_NS

# GPS: sets of two hours, valid around their end. Galileo: a set every ten minutes, of a time just past.
_GPS_SET_S, _GALILEO_SET_S = 7200, 600
_SLOTS = {
    # Satellites in each plane, highest satellite number.
    GPS: ((6, 5, 5, 5, 5, 5), 32),
    GALILEO: ((8, 8, 8), 36),
}


@dataclass(frozen=True)
class Orbit:
    """State of a satellite at given times.

    position_m, velocity_m_s (n, 3): Earth-centred, earth-fixed.
    clock_s (n,): satellite time minus system time, with the relativistic term, without group delays.
    clock_rate (n,): its derivative.
    """

    position_m: Floats
    velocity_m_s: Floats
    clock_s: Floats
    clock_rate: Floats


@dataclass(frozen=True)
class Satellite:
    """A satellite: the orbit that it flies and the sets that it transmits.

    sets: in the order of time. The satellite flies the first one for the whole session; the later ones are
        its continuations, quantised anew.
    """

    sets: tuple[Ephemeris, ...]

    @property
    def truth(self) -> Ephemeris:
        """What the satellite flies."""
        return self.sets[0]

    @property
    def system(self) -> str:
        """``G`` or ``E``."""
        return self.truth.system

    @property
    def name(self) -> str:
        """Satellite as RINEX names it."""
        return self.truth.name

    def transmitted(self, gps_ns: int) -> Ephemeris:
        """Return the set that is on the air at a time."""
        return [s for s in self.sets if s.from_gps_ns <= gps_ns or s is self.sets[0]][-1]

    def state(self, seconds: Floats, origin_gps_ns: int) -> Orbit:
        """Evaluate the ephemeris that it flies.

        seconds (n,): GPS time since `origin_gps_ns`, seconds: small numbers keep the time exact.
        """
        v = self.truth.value
        tk = seconds + (origin_gps_ns - self.truth.toe_gps_ns) / SECOND_NS
        axis = v("sqrt_a") ** 2
        mu = gravity(self.system)
        motion = np.sqrt(mu / axis**3) + v("delta_n")
        ecc = v("e")
        mean = v("m0") + motion * tk
        anomaly = mean + ecc * np.sin(mean)
        # Newton's steps on nearly circular orbits: the error is squared each time, from 1e-4.
        for _ in range(3):
            anomaly -= (anomaly - ecc * np.sin(anomaly) - mean) / (1 - ecc * np.cos(anomaly))
        sin_e, cos_e = np.sin(anomaly), np.cos(anomaly)
        anomaly_rate = motion / (1 - ecc * cos_e)
        root = np.sqrt(1 - ecc**2)
        phi = np.arctan2(root * sin_e, cos_e - ecc) + v("omega")
        phi_rate = root * anomaly_rate / (1 - ecc * cos_e)
        sin_2, cos_2 = np.sin(2 * phi), np.cos(2 * phi)
        u = phi + v("cus") * sin_2 + v("cuc") * cos_2
        r = axis * (1 - ecc * cos_e) + v("crs") * sin_2 + v("crc") * cos_2
        i = v("i0") + v("idot") * tk + v("cis") * sin_2 + v("cic") * cos_2
        u_rate = phi_rate * (1 + 2 * (v("cus") * cos_2 - v("cuc") * sin_2))
        r_rate = axis * ecc * sin_e * anomaly_rate + 2 * phi_rate * (v("crs") * cos_2 - v("crc") * sin_2)
        i_rate = v("idot") + 2 * phi_rate * (v("cis") * cos_2 - v("cic") * sin_2)
        x, y = r * np.cos(u), r * np.sin(u)
        x_rate = r_rate * np.cos(u) - y * u_rate
        y_rate = r_rate * np.sin(u) + x * u_rate
        node_rate = v("omega_dot") - EARTH_RATE_RAD_S
        node = v("omega0") + node_rate * tk - EARTH_RATE_RAD_S * v("toe")
        sin_n, cos_n, sin_i, cos_i = np.sin(node), np.cos(node), np.sin(i), np.cos(i)
        position = np.stack(
            [x * cos_n - y * cos_i * sin_n, x * sin_n + y * cos_i * cos_n, y * sin_i], axis=-1
        )
        across = y_rate * cos_i - y * sin_i * i_rate
        velocity = np.stack(
            [
                x_rate * cos_n - across * sin_n - node_rate * position[:, 1],
                x_rate * sin_n + across * cos_n + node_rate * position[:, 0],
                y_rate * sin_i + y * cos_i * i_rate,
            ],
            axis=-1,
        )
        # toc equals toe here. The relativistic term is the same in both documents: F = -2 sqrt(mu) / c^2.
        relativity = -2 * np.sqrt(mu * axis) * ecc / LIGHT_M_S**2
        clock = v("af0") + (v("af1") + v("af2") * tk) * tk + relativity * sin_e
        rate = v("af1") + 2 * v("af2") * tk + relativity * cos_e * anomaly_rate
        return Orbit(position, velocity, clock, rate)


def constellation(
    start_gps_ns: int, stop_gps_ns: int, rng: np.random.Generator, unhealthy: tuple[str, ...] = ()
) -> tuple[Satellite, ...]:
    """Return 31 satellites of GPS and 24 of Galileo with the sets of a session."""
    satellites = []
    for system in (GPS, GALILEO):
        planes, highest = _SLOTS[system]
        count = sum(planes)
        numbers = np.sort(rng.permutation(np.arange(1, highest + 1))[:count])
        slots = rng.permutation([(p, k, n) for p, n in enumerate(planes) for k in range(n)])
        node, phase = rng.uniform(0, 2 * np.pi, 2)
        for number, (plane, place, in_plane) in zip(numbers.tolist(), slots.tolist(), strict=True):
            turn = node + 2 * np.pi * plane / len(planes)
            latitude = phase + 2 * np.pi * (place / in_plane + plane / count)
            wished = (_gps if system == GPS else _galileo)(turn, latitude, rng)
            bad = f"{system}{number:02d}" in unhealthy
            satellites.append(Satellite(_sets(system, number, wished, start_gps_ns, stop_gps_ns, bad, rng)))
    return tuple(satellites)


def _sets(
    system: str,
    number: int,
    wished: dict[str, float],
    start_gps_ns: int,
    stop_gps_ns: int,
    bad: bool,
    rng: np.random.Generator,
) -> tuple[Ephemeris, ...]:
    every = (_GPS_SET_S if system == GPS else _GALILEO_SET_S) * SECOND_NS
    begin = start_gps_ns // every * every
    # GPS gives the end of the two hours, Galileo a time ten minutes before the first transmission.
    ahead = every if system == GPS else -every
    issue = int(rng.integers(0, 200))
    health = (0b111111 if system == GPS else 1) if bad else 0
    accuracy = int(rng.integers(0, 2)) if system == GPS else 107
    week, raw = quantised(system, wished, begin + ahead)
    first = Ephemeris(system, number, week, issue, health, accuracy, raw, begin)
    later = range(begin + every, stop_gps_ns + 1, every)
    return (
        first,
        *(renewed(first, t + ahead, issue=(issue + k) % 240, from_gps_ns=t) for k, t in enumerate(later, 1)),
    )


def _common(turn: float, latitude: float, rng: np.random.Generator) -> dict[str, float]:
    omega = rng.uniform(-np.pi, np.pi)
    return {
        "omega0": turn + rng.normal(0, 0.02),
        "omega": omega,
        "m0": latitude + rng.normal(0, 0.03) - omega,
        "idot": rng.normal(0, 2e-10),
        "cic": rng.normal(0, 8e-8),
        "cis": rng.normal(0, 8e-8),
        "cuc": rng.normal(0, 2e-6),
        "cus": rng.normal(7e-6, 2e-6),
        "crs": rng.normal(0, 50.0),
        "af2": 0.0,
    }


def _gps(turn: float, latitude: float, rng: np.random.Generator) -> dict[str, float]:
    return _common(turn, latitude, rng) | {
        "sqrt_a": 5153.65 + rng.normal(0, 0.03),
        "e": rng.uniform(0.001, 0.015),
        "i0": np.radians(55.0 + rng.normal(0, 0.7)),
        "omega_dot": -8.1e-9 + rng.normal(0, 1.5e-10),
        "delta_n": 4.4e-9 + rng.normal(0, 2e-10),
        "crc": rng.normal(240.0, 50.0),
        "af0": rng.uniform(-5e-4, 5e-4),
        "af1": rng.normal(0, 6e-12),
        "tgd": rng.normal(-4e-9, 6e-9),
    }


def _galileo(turn: float, latitude: float, rng: np.random.Generator) -> dict[str, float]:
    group = rng.normal(0, 3e-9)
    return _common(turn, latitude, rng) | {
        "sqrt_a": 5440.61 + rng.normal(0, 0.01),
        "e": rng.uniform(5e-5, 5e-4),
        "i0": np.radians(56.0 + rng.normal(0, 0.7)),
        "omega_dot": -5.6e-9 + rng.normal(0, 1e-10),
        "delta_n": 3.1e-9 + rng.normal(0, 1.5e-10),
        "crc": rng.normal(180.0, 40.0),
        "af0": rng.uniform(-8e-4, 8e-4),
        "af1": rng.normal(0, 4e-12),
        "bgd_e5a": group,
        "bgd_e5b": group * 1.12,
    }


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

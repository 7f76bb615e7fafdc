"""A sky of GPS and Galileo satellites by chance, with parameters of the size that real messages have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.gnss.ephemeris import Ephemeris, quantised, renewed
from acquire.simulate.gnss.orbit import Orbit, evaluate
from acquire.simulate.gnss.signals import GALILEO, GPS
from drivers.arrays import Floats
from drivers.gnsstime import SECOND_NS

# GPS: sets of two hours, valid around their end. Galileo: a set every ten minutes, of a time just past.
_GPS_SET_S, _GALILEO_SET_S = 7200, 600
_SLOTS = {
    # Satellites in each plane, highest satellite number.
    GPS: ((6, 5, 5, 5, 5, 5), 32),
    GALILEO: ((8, 8, 8), 36),
}


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
        """Return position and clock, see `orbit.evaluate`."""
        return evaluate(self.truth, seconds, origin_gps_ns)


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
    first = quantised(
        system,
        number,
        wished,
        begin + ahead,
        issue=issue,
        health=(0b111111 if system == GPS else 1) if bad else 0,
        accuracy=int(rng.integers(0, 2)) if system == GPS else 107,
        from_gps_ns=begin,
    )
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

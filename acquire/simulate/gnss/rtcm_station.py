"""RTCM 3 messages of a station beside its observations: position, date, ephemerides.

Source: RTCM standard 10403.3, tables 3.5-7 (1006), 3.5-17 (1013), 3.5-21 (1019), 3.5-105 (1046).
"""

from __future__ import annotations

from collections.abc import Iterator

from acquire.simulate.gnss.bits import joined, octets
from acquire.simulate.gnss.ephemeris import Ephemeris
from acquire.simulate.gnss.inav import GST_BEHIND_WEEKS
from acquire.simulate.gnss.session import Session
from acquire.simulate.gnss.signals import GPS
from drivers.gnsstime import DAY_NS, GPS_EPOCH_NS, SECOND_NS

_STATION_EVERY_S, _EPHEMERIS_EVERY_S = 10, 30
_LATENCY_NS = 110_000_000
_MJD_1970 = 40_587


def _times(session: Session, every_s: int) -> range:
    start, stop = session.span_gps_ns
    return range(start, stop, every_s * SECOND_NS)


def positions(session: Session, station: int) -> list[tuple[int, bytes]]:
    """Return 1006: the announced position; the antenna stands on its mark."""
    x, y, z = (round(float(value) * 1e4) for value in session.announced_m)
    flags = [(1, 1), (0, 1), (1, 1), (0, 1)]  # GPS, no GLONASS, Galileo, a real station
    bits = joined(
        [
            (1006, 12),
            (station, 12),
            (0, 6),
            *flags,
            (x, 38),
            (1, 1),
            (0, 1),
            (y, 38),
            (0, 2),
            (z, 38),
            (0, 16),
        ]
    )
    return [(time + _LATENCY_NS, octets(bits)) for time in _times(session, _STATION_EVERY_S)]


def dates(session: Session, station: int) -> Iterator[tuple[int, bytes]]:
    """Yield 1013: modified Julian day, second of the day and leap seconds."""
    leap_s = session.sky.leap_s
    for time in _times(session, _STATION_EVERY_S):
        day, of_day = divmod(time + GPS_EPOCH_NS - leap_s * SECOND_NS, DAY_NS)
        fields = [(day + _MJD_1970, 16), (of_day // SECOND_NS, 17), (0, 5), (leap_s, 8)]
        yield time + _LATENCY_NS, octets(joined([(1013, 12), (station, 12), *fields]))


def ephemerides(session: Session) -> Iterator[tuple[int, bytes]]:
    """Yield 1019 and 1046 of the satellites that the base tracks."""
    observations = session.base
    tags = observations.clock.tag_gps_ns
    rows = observations.rows
    for time in _times(session, _EPHEMERIS_EVERY_S):
        now = (tags[rows["epoch"]] >= time) & (tags[rows["epoch"]] < time + _EPHEMERIS_EVERY_S * SECOND_NS)
        for index in sorted(set(rows["satellite"][now].tolist())):
            sent = session.satellites[index].transmitted(time)
            bits = _gps(sent) if sent.system == GPS else _galileo(sent)
            yield time + _LATENCY_NS, octets(bits)


def _gps(e: Ephemeris) -> str:
    r = e.raw
    return joined(
        [
            *[(1019, 12), (e.number, 6), (e.week % 1024, 10), (e.accuracy, 4), (1, 2), (r["idot"], 14)],
            *[(e.issue & 0xFF, 8), (r["toc"], 16), (r["af2"], 8), (r["af1"], 16), (r["af0"], 22)],
            *[(e.issue, 10), (r["crs"], 16), (r["delta_n"], 16), (r["m0"], 32), (r["cuc"], 16), (r["e"], 32)],
            *[(r["cus"], 16), (r["sqrt_a"], 32), (r["toe"], 16), (r["cic"], 16), (r["omega0"], 32)],
            *[(r["cis"], 16), (r["i0"], 32), (r["crc"], 16), (r["omega"], 32), (r["omega_dot"], 24)],
            *[(r["tgd"], 8), (e.health, 6), (0, 1), (0, 1)],
        ]
    )


def _galileo(e: Ephemeris) -> str:
    r = e.raw
    bad = int(e.health != 0)
    return joined(
        [
            *[(1046, 12), (e.number, 6), ((e.week - GST_BEHIND_WEEKS) % 4096, 12), (e.issue, 10)],
            *[(e.accuracy, 8), (r["idot"], 14), (r["toc"], 14), (r["af2"], 6), (r["af1"], 21)],
            *[(r["af0"], 31), (r["crs"], 16), (r["delta_n"], 16), (r["m0"], 32), (r["cuc"], 16)],
            *[(r["e"], 32), (r["cus"], 16), (r["sqrt_a"], 32), (r["toe"], 14), (r["cic"], 16)],
            *[(r["omega0"], 32), (r["cis"], 16), (r["i0"], 32), (r["crc"], 16), (r["omega"], 32)],
            *[(r["omega_dot"], 24), (r["bgd_e5a"], 10), (r["bgd_e5b"], 10)],
            *[(e.health, 2), (bad, 1), (e.health, 2), (bad, 1), (0, 2)],
        ]
    )

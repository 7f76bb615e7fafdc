"""RTCM 3 of a base station: observations (MSM7), its place, receiver and what it announces."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.gnss.ephemeris import Ephemeris
from acquire.simulate.gnss.navigation_messages import GST_BEHIND_WEEKS, field, joined, octets
from acquire.simulate.gnss.observations import SatelliteObservations, Session
from acquire.simulate.gnss.settings import GALILEO, GPS, LIGHT_M_S
from photocal.base.time_scales import DAY_NS, GPS_EPOCH_NS, SECOND_NS, WEEK_S

_NUMBER = {GPS: 1077, GALILEO: 1097}
_STATION = 1
_MS_M = LIGHT_M_S * 1e-3
# What stands for "no value" in the signed fields.
_NO_FINE_CODE, _NO_FINE_PHASE, _NO_FINE_RATE, _NO_RATE = -(1 << 19), -(1 << 23), -(1 << 14), -(1 << 13)
_STATION_EVERY_S, _EPHEMERIS_EVERY_S = 10, 30
_STATION_LATENCY_NS = 110_000_000
# In the order of 1019 and 1046.
_ORBIT = "crs delta_n m0 cuc e cus sqrt_a toe cic omega0 cis i0 crc omega omega_dot"


def observation_messages(observations: SatelliteObservations) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload: 1077 and 1097 of each epoch at a whole second."""
    rows = observations.rows
    clock = observations.clock
    systems = np.array([s.system for s in observations.satellites])
    true_ns = clock.true_gps_ns
    latency_ns = 100_000_000
    for epoch in np.flatnonzero(clock.tag_gps_ns % SECOND_NS == 0).tolist():
        first, after = np.searchsorted(rows["epoch"], [epoch, epoch + 1])
        here = rows[first:after]
        present = [system for system in _NUMBER if (systems[here["satellite"]] == system).any()]
        for place, system in enumerate(present):
            of_system = here[systems[here["satellite"]] == system]
            more = place + 1 < len(present)
            tow_ms = int(clock.tag_gps_ns[epoch]) % (WEEK_S * SECOND_NS) // 1_000_000
            head = joined([(_NUMBER[system], 12), (_STATION, 12), (tow_ms, 30), (int(more), 1), (0, 18)])
            yield int(true_ns[epoch]) + latency_ns, octets(head + _body(of_system, observations))


def _body(rows: NDArray[np.void], observations: SatelliteObservations) -> str:
    """Return the masks, the satellites and the signals of one system."""
    # A message carries at most 64 cells.
    most_cells = 64
    satellites = np.unique(rows["satellite"]).tolist()
    signals = sorted({observations.signal(s, n).msm for s in satellites for n in np.unique(rows["signal"])})
    numbers = [observations.satellites[s].truth.number for s in satellites]
    place = {(int(r["satellite"]), observations.signal(r["satellite"], r["signal"]).msm): r for r in rows}
    cells = [(s, m) for s in satellites for m in signals]
    if len(cells) > most_cells:
        raise OverflowError(f"{len(cells)} cells in one message, {most_cells} are allowed")
    masks = _mask(numbers, 64) + _mask(signals, 32) + "".join(str(int(cell in place)) for cell in cells)
    kept = [place[cell] for cell in cells if cell in place]
    firsts = {s: next(r for r in kept if r["satellite"] == s) for s in satellites}
    rough = {s: round(float(r["code_m"]) / _MS_M * 1024) for s, r in firsts.items()}
    rate = {s: round(_rate(observations, r)) for s, r in firsts.items()}
    columns = [
        "".join(field(rough[s] >> 10, 8) for s in satellites),
        "0" * 4 * len(satellites),
        "".join(field(rough[s] & 1023, 10) for s in satellites),
        "".join(field(rate[s] if abs(rate[s]) < 8192 else _NO_RATE, 14) for s in satellites),
    ]
    fine = [_signal(r, rough[int(r["satellite"])], rate[int(r["satellite"])], observations) for r in kept]
    return masks + "".join(columns) + "".join("".join(column) for column in zip(*fine, strict=True))


def _signal(row: np.void, rough: int, rate: int, observations: SatelliteObservations) -> tuple[str, ...]:
    signal = observations.signal(row["satellite"], row["signal"])
    base_ms = rough / 1024
    code = round((float(row["code_m"]) / _MS_M - base_ms) * 2**29)
    phase = round((float(row["phase_cycles"]) * signal.wavelength_m / _MS_M - base_ms) * 2**31)
    swing = round((_rate(observations, row) - rate) * 1e4)
    has_phase = bool(row["has_phase"])
    return (
        field(code if abs(code) < 1 << 19 else _NO_FINE_CODE, 20),
        field(phase if has_phase and abs(phase) < 1 << 23 else _NO_FINE_PHASE, 24),
        field(lock_indicator(int(float(row["lock_s"]) * 1e3)), 10),
        str(int(not row["half_valid"])),
        field(round(float(row["cn0_dbhz"]) * 16), 10),
        field(swing if abs(swing) < 1 << 14 else _NO_FINE_RATE, 15),
    )


def _rate(observations: SatelliteObservations, row: np.void) -> float:
    return -float(row["doppler_hz"]) * observations.signal(row["satellite"], row["signal"]).wavelength_m


def lock_indicator(milliseconds: int) -> int:
    """Return DF407: linear to 64 ms, then each 32 steps twice as coarse, to 704."""
    if milliseconds < 64:
        return max(milliseconds, 0)
    power = milliseconds.bit_length() - 6
    return min(32 * power + (milliseconds >> power), 704)


def _mask(numbers: list[int], width: int) -> str:
    return "".join("1" if n + 1 in numbers else "0" for n in range(width))


def _times(session: Session, every_s: int) -> range:
    start, stop = session.span_gps_ns
    return range(start, stop, every_s * SECOND_NS)


def positions(session: Session) -> list[tuple[int, bytes]]:
    """Return 1006: the announced position; the antenna stands on its mark."""
    x, y, z = (round(float(value) * 1e4) for value in session.announced_m)
    flags = [(1, 1), (0, 1), (1, 1), (0, 1)]  # GPS, no GLONASS, Galileo, a real station
    place = [(x, 38), (1, 1), (0, 1), (y, 38), (0, 2), (z, 38), (0, 16)]
    bits = joined([(1006, 12), (_STATION, 12), (0, 6), *flags, *place])
    return [(time + _STATION_LATENCY_NS, octets(bits)) for time in _times(session, _STATION_EVERY_S)]


def dates(session: Session) -> Iterator[tuple[int, bytes]]:
    """Yield 1013: modified Julian day, second of the day and leap seconds."""
    # Modified Julian Date of 1970-01-01.
    mjd_1970 = 40_587
    leap_s = session.sky.leap_s
    for time in _times(session, _STATION_EVERY_S):
        day, of_day = divmod(time + GPS_EPOCH_NS - leap_s * SECOND_NS, DAY_NS)
        fields = [(day + mjd_1970, 16), (of_day // SECOND_NS, 17), (0, 5), (leap_s, 8)]
        yield time + _STATION_LATENCY_NS, octets(joined([(1013, 12), (_STATION, 12), *fields]))


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
            yield time + _STATION_LATENCY_NS, octets(bits)


def _gps(e: Ephemeris) -> str:
    head = [(1019, 12), (e.number, 6), (e.week % 1024, 10), (e.accuracy, 4), (1, 2), *e.bits("idot")]
    clock = [(e.issue & 0xFF, 8), *e.bits("toc af2 af1 af0"), (e.issue, 10)]
    return joined([*head, *clock, *e.bits(f"{_ORBIT} tgd"), (e.health, 6), (0, 1), (0, 1)])


def _galileo(e: Ephemeris) -> str:
    bad = int(e.health != 0)
    week = (e.week - GST_BEHIND_WEEKS) % 4096
    head = [(1046, 12), (e.number, 6), (week, 12), (e.issue, 10), (e.accuracy, 8)]
    health = [(e.health, 2), (bad, 1), (e.health, 2), (bad, 1), (0, 2)]
    return joined([*head, *e.bits(f"idot toc af2 af1 af0 {_ORBIT} bgd_e5a bgd_e5b"), *health])

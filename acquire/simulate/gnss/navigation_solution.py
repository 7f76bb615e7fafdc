"""NAV-PVT and NAV-SVIN: what a receiver itself says where it is.

Source: u-blox F9 HPG 1.32 interface description, NAV-PVT and NAV-SVIN.
"""

import datetime as dt
import struct
from collections.abc import Iterator

import numpy as np

from acquire.simulate.gnss.observations import SatelliteObservations, correlated
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import GPS_EPOCH_NS, SECOND_NS, WEEK_S

KIND, SURVEY_KIND = 0x0107, 0x013B
_LATENCY_NS = 80_000_000
_EVERYTHING_VALID, _CONFIRMED, _FIX_OK = 0x07, 0xE0, 0x01
_LEAST_SATELLITES = 4
# Errors of the receiver's own solution by codes (east, north, up), how long they stay, and of its speed.
_SIGMA_M, _CORRELATION_S, _SPEED_SIGMA_M_S = (0.9, 0.9, 1.6), 60.0, 0.04


def messages(
    observations: SatelliteObservations, geoid_m: float, leap_s: int, rng: np.random.Generator
) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload of NAV-PVT, one per epoch with four satellites.

    geoid_m: height of the geoid above the ellipsoid that the receiver uses for heights above sea level.
    """
    clock, place = observations.clock, observations.place
    count = len(clock)
    step = float(np.median(np.diff(clock.tag_gps_ns))) / SECOND_NS if count > 1 else 1.0
    error = correlated(count, step / _CORRELATION_S, 3, rng).T * _SIGMA_M
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
            int(true_ns[k]) + _LATENCY_NS,
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
            true + _LATENCY_NS,
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

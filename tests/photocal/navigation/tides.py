"""Tides of the solid earth by the formula of the second degree, with low-precision sun and moon."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_EARTH_M = 6_378_136.6
# Masses of sun and moon in that of the earth (IERS Conventions 2010, table 1.1).
_MASSES = (332_946.0482, 0.0123000371)


def displacement(gps_ns: NDArray[np.int64], place_m: Floats) -> Floats:
    """How far the tide moves a place, (n, 3) in m, earth-fixed (IERS Conventions 2010, equation 7.5)."""
    up = place_m / np.linalg.norm(place_m)
    polar = (3 * up[2] ** 2 - 1) / 2
    h, shida = 0.6078 - 0.0006 * polar, 0.0847 + 0.0002 * polar
    moved = np.zeros((len(gps_ns), 3))
    for body, mass in zip(_sun_and_moon(gps_ns), _MASSES, strict=True):
        distance = np.linalg.norm(body, axis=1, keepdims=True)
        towards = body / distance
        cosine = (towards @ up)[:, None]
        vertical = h * up * (1.5 * cosine**2 - 0.5)
        moved += mass * _EARTH_M**4 / distance**3 * (vertical + 3 * shida * cosine * (towards - cosine * up))
    return moved


def _sun_and_moon(gps_ns: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Earth-fixed positions to a few arc minutes (Montenbruck and Gill 2000, section 3.3.2)."""
    universal = 2_444_244.5 + (gps_ns / 1e9 - 18) / 86_400 - 2_451_545.0
    century = (universal + 69.184 / 86_400) / 36_525
    since = np.radians(1.3972 * century)
    anomaly = np.radians(357.5256 + 35_999.049 * century)
    longitude = np.radians(282.94 + (6892 * np.sin(anomaly) + 72 * np.sin(2 * anomaly)) / 3600) + anomaly
    distance = (149.619 - 2.499 * np.cos(anomaly) - 0.021 * np.cos(2 * anomaly)) * 1e9
    sun = _equatorial(longitude + since, 0 * longitude, distance)
    mean = np.radians(218.31617 + 481_267.88088 * century) - since
    m, s, f, d = (
        np.radians(start + rate * century)
        for start, rate in (
            (134.96292, 477_198.86753),
            (357.52543, 35_999.04944),
            (93.27283, 483_202.01873),
            (297.85027, 445_267.11135),
        )
    )
    along = 22_640 * np.sin(m) + 769 * np.sin(2 * m) - 4586 * np.sin(m - 2 * d) + 2370 * np.sin(2 * d)
    along += (
        -668 * np.sin(s) - 412 * np.sin(2 * f) - 212 * np.sin(2 * m - 2 * d) - 206 * np.sin(m + s - 2 * d)
    )
    along += 192 * np.sin(m + 2 * d) - 165 * np.sin(s - 2 * d) + 148 * np.sin(m - s) - 125 * np.sin(d)
    along += -110 * np.sin(m + s) - 55 * np.sin(2 * f - 2 * d)
    lon = mean + np.radians(along / 3600)
    wave = f + lon - mean + np.radians((412 * np.sin(2 * f) + 541 * np.sin(s)) / 3600)
    across = 18_520 * np.sin(wave) - 526 * np.sin(f - 2 * d) + 44 * np.sin(m + f - 2 * d)
    across += -31 * np.sin(-m + f - 2 * d) - 25 * np.sin(-2 * m + f) - 23 * np.sin(s + f - 2 * d)
    radius = (
        385_000 - 20_905 * np.cos(m) - 3699 * np.cos(2 * d - m) - 2956 * np.cos(2 * d) - 570 * np.cos(2 * m)
    )
    radius += 246 * np.cos(2 * m - 2 * d) - 205 * np.cos(s - 2 * d) - 171 * np.cos(m + 2 * d)
    moon = _equatorial(lon + since, np.radians(across / 3600), radius * 1e3)
    turned = 2 * np.pi * (0.7790572732640 + 1.00273781191135448 * universal)
    turned += np.radians(4612.156534 * century / 3600)
    return _earth_fixed(sun, turned), _earth_fixed(moon, turned)


def _equatorial(longitude: Floats, latitude: Floats, distance: Floats) -> Floats:
    tilt = np.radians(23.43929111)
    x, y, z = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)
    turned = np.stack([x, np.cos(tilt) * y - np.sin(tilt) * z, np.sin(tilt) * y + np.cos(tilt) * z], axis=1)
    return np.asarray(distance[:, None] * turned)


def _earth_fixed(vectors: Floats, angle: Floats) -> Floats:
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)

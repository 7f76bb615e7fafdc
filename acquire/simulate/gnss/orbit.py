"""Where a satellite is and what its clock shows: the user algorithm of the interface documents.

Sources: IS-GPS-200N, table 20-IV and section 20.3.3.3.3.1; Galileo OS SIS ICD 2.1, tables 66 and 69.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.gnss.ephemeris import Ephemeris, gravity
from acquire.simulate.gnss.signals import EARTH_RATE_RAD_S, LIGHT_M_S
from drivers.arrays import Floats
from drivers.gnsstime import SECOND_NS


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


def evaluate(ephemeris: Ephemeris, seconds: Floats, origin_gps_ns: int) -> Orbit:
    """Evaluate an ephemeris.

    seconds (n,): GPS time since `origin_gps_ns`, seconds: small numbers keep the time exact.
    """
    v = ephemeris.value
    tk = seconds + (origin_gps_ns - ephemeris.toe_gps_ns) / SECOND_NS
    axis = v("sqrt_a") ** 2
    mu = gravity(ephemeris.system)
    motion = np.sqrt(mu / axis**3) + v("delta_n")
    ecc = v("e")
    anomaly = _eccentric(v("m0") + motion * tk, ecc)
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
    position = np.stack([x * cos_n - y * cos_i * sin_n, x * sin_n + y * cos_i * cos_n, y * sin_i], axis=-1)
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


def _eccentric(mean: Floats, ecc: float) -> Floats:
    anomaly = mean + ecc * np.sin(mean)
    # Newton's steps on nearly circular orbits: the error is squared each time, from 1e-4.
    for _ in range(3):
        anomaly = anomaly - (anomaly - ecc * np.sin(anomaly) - mean) / (1 - ecc * np.cos(anomaly))
    return np.asarray(anomaly)

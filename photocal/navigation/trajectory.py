"""The path of an antenna: positions with full covariance, status and velocity, and its file."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Flags, Floats, Integers
from photocal.navigation.time import GpsTime

COLUMNS = (
    "time_gps_ns", "lat_deg", "lon_deg", "height_m", "status", "se", "sn", "su", "sen", "seu", "snu",
)  # fmt: skip


@dataclass(frozen=True)
class Trajectory:
    """Positions of the rover's antenna reference point.

    time: epochs, increasing.
    lat_deg, lon_deg, height_m (n,): geodetic position, ellipsoidal height.
    status: ``fixed``, ``float`` or ``single``.
    covariance_m2 (n, 3, 3): east, north, up.
    velocity_m_s (n, 3): east, north, up from Doppler; NaN where it is not known.
    velocity_sigma_m_s: standard deviation of each component.
    """

    time: GpsTime
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    status: NDArray[np.str_]
    covariance_m2: Floats
    velocity_m_s: Floats
    velocity_sigma_m_s: float

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, chosen: Flags | Integers) -> Trajectory:
        """Return some of the epochs."""
        return Trajectory(
            self.time[chosen],
            self.lat_deg[chosen],
            self.lon_deg[chosen],
            self.height_m[chosen],
            self.status[chosen],
            self.covariance_m2[chosen],
            self.velocity_m_s[chosen],
            self.velocity_sigma_m_s,
        )


def covariance_cells(covariance_m2: Floats) -> list[str]:
    """Return se, sn, su (standard deviations, m) and sen, seu, snu of one epoch.

    The last three are roots of the covariances with the covariances' signs, in metres, as RTKLIB writes
    them (RTKLIB manual 2.4.2, appendix B.1).
    """
    c = covariance_m2
    roots = [np.sign(c[i, j]) * np.sqrt(abs(c[i, j])) for i, j in ((0, 1), (0, 2), (1, 2))]
    return [f"{v:.5f}" for v in (*np.sqrt(np.diag(c)), *roots)]


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write the trajectory as CSV with `COLUMNS`."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        t = trajectory
        for i in range(len(t)):
            position = (f"{t.lat_deg[i]:.10f}", f"{t.lon_deg[i]:.10f}", f"{t.height_m[i]:.4f}")
            cells = covariance_cells(t.covariance_m2[i])
            writer.writerow([int(t.time.ns[i]), *position, str(t.status[i]), *cells])


def enu_offsets(lat_deg: Floats, lon_deg: Floats, height_m: Floats, origin: Floats) -> Floats:
    """Return topocentric east, north, up of geodetic positions on WGS 84."""
    centre = geocentric(origin[None, 0], origin[None, 1], origin[None, 2])[0]
    return np.asarray((geocentric(lat_deg, lon_deg, height_m) - centre) @ enu_axes(*origin[:2]).T)


def enu_axes(lat_deg: float, lon_deg: float) -> Floats:
    """Return the rotation (3, 3) from earth-centred to east, north, up axes."""
    (sb, cb), (sl, cl) = ((np.sin(a), np.cos(a)) for a in np.radians([lat_deg, lon_deg]))
    return np.array([[-sl, cl, 0.0], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]])


def geocentric(lat_deg: Floats, lon_deg: Floats, height_m: Floats) -> Floats:
    """Return earth-centred coordinates (n, 3) of geodetic ones on WGS 84 (Bowring 1976, section 1)."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    normal = _SEMI_MAJOR_M / np.sqrt(1 - _ECCENTRICITY2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (normal + height_m) * np.cos(lat) * np.cos(lon),
            (normal + height_m) * np.cos(lat) * np.sin(lon),
            (normal * (1 - _ECCENTRICITY2) + height_m) * np.sin(lat),
        ],
        axis=-1,
    )


def geodetic(xyz_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return latitude, longitude (deg) and ellipsoidal height (m) of earth-centred coordinates (n, 3).

    Iteration of the latitude (Torge and Mueller 2012, eq. 4.31), exact to 1e-12 rad near the earth.
    """
    x, y, z = np.moveaxis(np.asarray(xyz_m, np.float64), -1, 0)
    distance = np.hypot(x, y)
    lat = np.arctan2(z, distance * (1 - _ECCENTRICITY2))
    normal = np.zeros_like(lat)
    for _ in range(8):
        normal = _SEMI_MAJOR_M / np.sqrt(1 - _ECCENTRICITY2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + _ECCENTRICITY2 * normal * np.sin(lat), distance)
    height = distance * np.cos(lat) + z * np.sin(lat) - _SEMI_MAJOR_M**2 / normal
    return np.degrees(lat), np.degrees(np.arctan2(y, x)), height


_SEMI_MAJOR_M = 6_378_137.0
_FLATTENING = 1 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2 - _FLATTENING)

"""`positions.csv` and `attitudes.csv` of a block, from exposures at the antenna."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from photocal.block.motion import strips
from photocal.block.mounting import ATTITUDE_COLUMNS, POSITION_COLUMNS, POSITION_EXTRAS, RATE_COLUMNS
from photocal.navigation.exposure_files import projected, with_images
from photocal.navigation.exposures import Exposures

# Of a rate between two attitudes of an autopilot, some hundredths of a second apart, deg/s.
_RATE_SIGMA = 2.0


def write_positions(path: Path, antenna: Exposures, crs: str) -> None:
    """Write where the antenna was."""
    rows = with_images(antenna)
    p = antenna.placed
    xyz, turn = projected(p.lat_deg[rows], p.lon_deg[rows], p.height_m[rows], crs)
    covariance = turn @ p.covariance_m2[rows] @ np.swapaxes(turn, 1, 2)
    velocity = np.einsum("nab,nb->na", turn, p.velocity_m_s[rows])
    seconds = (antenna.time.ns[rows] - antenna.time.ns[rows[0]]) / 1e9
    strip, elapsed = strips(seconds, velocity)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    lines = []
    for k, row in enumerate(rows.tolist()):
        cells = [f"{v:.4f}" for v in xyz[k]] + [f"{v:.5f}" for v in sigma[k]]
        cells += [f"{covariance[k][a, b]:.4e}" for a, b in ((0, 1), (0, 2), (1, 2))]
        cells += [f"{v:.4f}" for v in velocity[k]] + [f"strip {strip[k] + 1}", f"{elapsed[k]:.3f}"]
        lines += [[name, *cells] for name in antenna.image[row].split()]
    _write(path, (*POSITION_COLUMNS, *POSITION_EXTRAS), lines)


def write_attitudes(path: Path, antenna: Exposures) -> None:
    """Write how the vehicle was turned, degrees; exposures without attitude are left out."""
    lines = []
    for row in with_images(antenna).tolist():
        angles, sigma = antenna.angles[row], antenna.angle_sigma[row]
        if np.isfinite(angles).all():
            cells = [f"{v:.6f}" for v in np.degrees([*angles, *sigma])]
            rate = np.degrees(antenna.attitude.rate[row])
            cells += [f"{v:.4f}" for v in rate] + 3 * [f"{_RATE_SIGMA}"] if rate.any() else [""] * 6
            lines += [[name, *cells] for name in antenna.image[row].split()]
    _write(path, (*ATTITUDE_COLUMNS, *RATE_COLUMNS), lines)


def _write(path: Path, columns: tuple[str, ...], lines: Iterable[list[str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(lines)

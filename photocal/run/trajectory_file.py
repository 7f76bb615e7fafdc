"""A trajectory with its velocities and all its digits, from one stage to the next."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import Trajectory

_COLUMNS = ("lat_deg", "lon_deg", "height_m", "status", "covariance_m2", "velocity_m_s")


def keep_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory."""
    columns = {name: getattr(trajectory, name) for name in _COLUMNS}
    sigma = trajectory.velocity_sigma_m_s
    np.savez(path, time_gps_ns=trajectory.time.ns, velocity_sigma_m_s=sigma, **columns)


def kept_trajectory(path: Path) -> Trajectory:
    """Read what `keep_trajectory` has written."""
    with np.load(path) as kept:
        return Trajectory(
            time=GpsTime(kept["time_gps_ns"]),
            velocity_sigma_m_s=float(kept["velocity_sigma_m_s"]),
            **{name: kept[name] for name in _COLUMNS},
        )

"""Stage `ppk`: the trajectory of the rover's antenna."""

from pathlib import Path

import numpy as np

from photocal.base.progress import Progress
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import Trajectory
from photocal.project import Project
from photocal.run.stage import Stage

_COLUMNS = ("lat_deg", "lon_deg", "height_m", "status", "covariance_m2", "velocity_m_s")
TRAJECTORY = "trajectory.npz"
FIGURES = "ppk.json"


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


def ppk_stage(project: Project) -> Stage:
    """Describe the stage."""
    flight = project.flight
    inputs = {f"log {k + 1}": path for k, path in enumerate(flight.logs)}
    inputs |= {f"navigation {k + 1}": path for k, path in enumerate(flight.navigation)}
    named = {"rover_rinex": flight.rover_rinex, "base_rinex": flight.base_rinex}
    inputs |= {name: path for name, path in named.items() if path is not None}
    settings = flight.model_dump(
        mode="json",
        include={
            "rover",
            "base",
            "base_position",
            "base_antenna_height_m",
            "rover_antenna_height_m",
            "base_sigma_m",
            "weather",
        },
    )
    return Stage(
        "ppk", "positions of the antenna", lambda out, show: _make(project, out, show), inputs, settings
    )


def _make(project: Project, folder: Path, show: Progress) -> None:
    import tempfile

    from photocal.navigation.engine import Rtklib
    from photocal.navigation.exposure_run import choices_of_project
    from photocal.navigation.ppk_report import solved, write_ppk

    sources = choices_of_project(project).sources
    with show("positions of the antenna", None), tempfile.TemporaryDirectory() as scratch:
        result, figures = solved(sources, Rtklib(), Path(scratch))
    write_ppk(folder, result, figures)
    keep_trajectory(folder / TRAJECTORY, result.trajectory)

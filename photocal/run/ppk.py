"""Stage `ppk`: the trajectory of the rover's antenna."""

from pathlib import Path

from photocal.base.progress import Progress
from photocal.block.project import Project
from photocal.run.stage import Stage

# The second as `photocal.navigation.ppk_result` names it, which reads no log only to be asked for a name.
TRAJECTORY, FIGURES = "trajectory.parquet", "ppk.json"


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
            "base_frame",
            "weather",
        },
    )
    settings["crs"] = project.crs
    return Stage(
        "ppk", "positions of the antenna", lambda out, show: _make(project, out, show), inputs, settings
    )


def _make(project: Project, folder: Path, show: Progress) -> None:
    import tempfile

    from photocal.navigation.exposure_run import choices_of_project
    from photocal.navigation.ppk import solved
    from photocal.navigation.ppk_result import write_ppk

    sources = choices_of_project(project).sources
    with show("positions of the antenna", None), tempfile.TemporaryDirectory() as scratch:
        made = solved(sources, Path(scratch))
    write_ppk(folder, made)
    made.trajectory.write(folder / TRAJECTORY)

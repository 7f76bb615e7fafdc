"""The stages of a project, in their order."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from pathlib import Path

from drivers.errors import ConfigurationError, PhotocalError
from photocal.project import Project
from photocal.run.block import block_stage, given_block_stage
from photocal.run.calibration import analysis_stage, calibration_stage, certificate_stage
from photocal.run.digests import Digests
from photocal.run.exposures import exposures_stage
from photocal.run.folders import alone
from photocal.run.georeferencing import georeferencing_stage
from photocal.run.measurements import measurements_stage
from photocal.run.ppk import ppk_stage
from photocal.run.project_checks import check_project, explained
from photocal.run.stage import Progress, Stage, StageResult, made_in, update_stage, written

_MEMORY = ".digests.json"
# In the work folder while a run works: how far it is.
PROGRESS = "progress.json"


def stages(project: Project, day: dt.date) -> tuple[Stage, ...]:
    """List the stages of a project."""
    work = made_in(project.output)
    block, calibration = work / "block", work / "calibration"
    given = project.contents.measurements
    if given is not None and given.block is not None:
        first: tuple[Stage, ...] = (given_block_stage(given.block),)
    else:
        ppk, exposures, measurements = (work / name for name in ("ppk", "exposures", "measurements"))
        # Observations that were given have no other start values than those of a flight.
        flown = project.contents.flight is not None or given is not None
        placed = exposures if flown else None
        first = (
            *((ppk_stage(project), exposures_stage(project, ppk)) if flown else ()),
            measurements_stage(project, placed),
            block_stage(project, placed, measurements),
        )
    made = (
        *first,
        calibration_stage(block),
        georeferencing_stage(project, block),
        analysis_stage(block, calibration),
    )
    return (*made, certificate_stage(project, work, day, tuple(work / one.name for one in made)))


def run_project(
    project: Project,
    day: dt.date,
    progress: Progress,
    until: str | None = None,
    again: str | None = None,
    rehash: bool = False,
    told: Callable[[StageResult], None] = lambda _: None,
) -> tuple[StageResult, ...]:
    """Bring the stages of a project up to date.

    raises PhotocalError: as the first stage that fails does; the stages that do not need it are made
        nevertheless, for they may tell why.
    """
    wanted = stages(project, day)
    names = [stage.name for stage in wanted]
    for option, name in (("--until", until), ("--again", again)):
        if name is not None and name not in names:
            raise ConfigurationError(
                f"{name!r} is no stage of this project", where=option, remedy=f"take {', '.join(names)}"
            )
    check_project(project)
    with alone(project.output):
        digests = Digests(project.output / _MEMORY, again=rehash)
        shown = written(progress, project.output / PROGRESS)
        made: list[StageResult] = []
        missing: set[Path] = set()
        failure: PhotocalError | None = None
        try:
            for stage in wanted[: None if until is None else names.index(until) + 1]:
                try:
                    if missing.isdisjoint(stage.after):
                        made.append(
                            update_stage(stage, project.output, digests, shown, again=stage.name == again)
                        )
                        told(made[-1])
                        continue
                except PhotocalError as refusal:
                    failure = failure or refusal
                missing.add(made_in(project.output) / stage.name)
        finally:
            (project.output / PROGRESS).unlink(missing_ok=True)
            digests.keep()
    if failure is not None:
        raise explained(project, failure) from failure
    return tuple(made)

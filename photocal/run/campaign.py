"""Several projects: one by one, on several processes, or on a cluster."""

from __future__ import annotations

import datetime as dt
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError, PhotocalError
from photocal.findings.catalogue import catalogue
from photocal.findings.texts import finding_text, plain
from photocal.project import read_project
from photocal.run.stage import Progress, StageResult
from photocal.run.summary import summary
from photocal.run.warnings import gather, kind
from photocal.run.workflow import run_project

Task = tuple[Path, dt.date, str | None, str | None, bool]


@dataclass(frozen=True)
class Outcome:
    """How the run of one project ended.

    figures: empty when it failed.
    told: what it said on the way, where nobody could listen.
    """

    figures: dict[str, Any]
    failure: PhotocalError | None
    told: tuple[str, ...] = ()


def run_projects(
    paths: Sequence[Path],
    day: dt.date,
    progress: Progress,
    until: str | None = None,
    again: str | None = None,
    rehash: bool = False,
    workers: int = 1,
    cluster: str | None = None,
) -> list[dict[str, Any]]:
    """Run projects, which do not depend on each other.

    raises PhotocalError: of the first project that failed, when the others have ended.
    """
    # All are read first: a mistake in the last file should not wait for hours.
    outputs = [read_project(path).output.resolve() for path in paths]
    for k, output in enumerate(outputs):
        if output in outputs[:k]:
            raise ConfigurationError(
                "two projects have the same output", where=paths[k], remedy="give each its own folder"
            )
    tasks: list[Task] = [(path.resolve(), day, until, again, rehash) for path in paths]
    if cluster is None and (workers == 1 or len(tasks) == 1):
        outcomes = [_outcome(task, progress, _say) for task in tasks]
    else:
        from photocal.tasks.cluster import Cluster
        from photocal.tasks.workers import run_tasks

        crew = min(workers, len(tasks)) if cluster is None else Cluster(cluster)
        outcomes = []
        for one in run_tasks(_elsewhere, tasks, crew):
            outcomes.append(one)
            for line in one.told:
                _say(line)
    for one in outcomes:
        if one.failure is not None:
            raise one.failure
    return [one.figures for one in outcomes]


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Any]:
    """Show no progress."""
    yield lambda _: None


def _say(line: str) -> None:
    sys.stderr.write(line + "\n")


def _elsewhere(task: Task) -> Outcome:
    """Run a project in another process: what it says and what ends it come back with its figures."""
    told: list[str] = []
    one = _outcome(task, quiet, told.append)
    return Outcome(one.figures, one.failure, tuple(told))


def _outcome(task: Task, progress: Progress, say: Callable[[str], None]) -> Outcome:
    try:
        return Outcome(run_one(*task, progress, say), None)
    except PhotocalError as failure:
        return Outcome({}, failure)


def run_one(
    path: Path,
    day: dt.date,
    until: str | None = None,
    again: str | None = None,
    rehash: bool = False,
    progress: Progress = quiet,
    say: Callable[[str], None] = _say,
) -> dict[str, Any]:
    """Run one project and give its figures.

    raises PhotocalError: as `workflow.run_project` does.
    """
    project = read_project(path)
    made: list[StageResult] = []

    def told(one: StageResult) -> None:
        made.append(one)
        say(f"{project.name}: {one.name}: " + ("kept" if one.kept else f"{one.seconds:.1f} s"))
        for line in one.foreign:
            say(f"{project.name}: {one.name}: {line}")

    try:
        run_project(project, day, progress, until, again, rehash, told)
    except PhotocalError:
        # What other stages found doubtful is often why one cannot go on.
        for warning in gather(project.output, {one.name for one in made}):
            text = finding_text(warning, catalogue("en"), plain)
            say(f"{project.name}: {kind(warning)}: {warning.code}: {text}")
        raise
    return summary(project.name, project.output, made)

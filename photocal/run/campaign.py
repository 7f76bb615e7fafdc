"""Several projects: one by one, on several processes, or on a cluster."""

from __future__ import annotations

import datetime as dt
import importlib
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError, DeviceError, PhotocalError, ProgramMissingError
from photocal.project import read_project
from photocal.run.stage import Made, Progress
from photocal.run.summary import summary
from photocal.run.warnings import gather
from photocal.run.workflow import run_project


def run_projects(
    paths: Sequence[Path],
    day: dt.date,
    progress: Progress,
    until: str | None = None,
    again: str | None = None,
    workers: int = 1,
    cluster: str | None = None,
) -> list[dict[str, Any]]:
    """Run projects, which do not depend on each other.

    Parameters
    ----------
    paths : sequence of Path
        Project files.
    day : date
        Of certificates that are made now.
    progress : callable
        Shows what goes on, where it goes on here.
    until, again : str, optional
        As in `workflow.run_project`.
    workers : int
        Processes.
    cluster : str, optional
        Address of a Dask scheduler whose workers see the same files.

    Returns
    -------
    list of dict
        Figures of each project, in order.

    Raises
    ------
    PhotocalError
        Of the first project that failed, when the others have ended.
    """
    # All are read first: a mistake in the last file should not wait for hours.
    outputs = [read_project(path).output.resolve() for path in paths]
    for k, output in enumerate(outputs):
        if output in outputs[:k]:
            raise ConfigurationError(
                "two projects have the same output", where=paths[k], remedy="give each its own folder"
            )
    tasks = [(path.resolve(), day, until, again) for path in paths]
    if cluster is not None:
        return _on_cluster(tasks, cluster)
    if workers > 1 and len(paths) > 1:
        with ProcessPoolExecutor(min(workers, len(paths))) as pool:
            futures = [pool.submit(run_one, *task) for task in tasks]
            failures = [future.exception() for future in futures]
            _raise_first(failures)
            return [future.result() for future in futures]
    return [run_one(*task, progress=progress) for task in tasks]


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Any]:
    """Show no progress."""
    yield lambda _: None


def run_one(
    path: Path, day: dt.date, until: str | None, again: str | None, progress: Progress = quiet
) -> dict[str, Any]:
    """Run one project and give its figures; each stage that is done is told on standard error."""
    project = read_project(path)
    made: list[Made] = []

    def told(one: Made) -> None:
        made.append(one)
        what = "kept" if one.kept else f"{one.seconds:.1f} s"
        sys.stderr.write(f"{project.name}: {one.name}: {what}\n")

    try:
        run_project(project, day, progress, until, again, told)
    except PhotocalError:
        # What other stages found doubtful is often why one cannot go on.
        for warning in gather(project.output, {one.name for one in made}):
            kind = "note" if warning.note else "warning"
            sys.stderr.write(f"{project.name}: {kind}: {warning.code}: {warning.text}\n")
        raise
    return summary(project.name, project.output, made)


def _on_cluster(tasks: Sequence[tuple[Any, ...]], address: str) -> list[dict[str, Any]]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as refusal:
        raise ProgramMissingError(
            "dask.distributed is not installed", remedy="install photocal[cluster]"
        ) from refusal
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, ValueError) as refusal:
        raise DeviceError(
            "no scheduler answers there", where=address, remedy="start `dask scheduler` and name its address"
        ) from refusal
    with client:
        futures = [client.submit(run_one, *task, pure=False) for task in tasks]
        _raise_first([future.exception() for future in futures])
        figures: list[dict[str, Any]] = client.gather(futures)
    return figures


def _raise_first(failures: Sequence[BaseException | None]) -> None:
    for failure in failures:
        if isinstance(failure, PhotocalError):
            raise failure
        if failure is not None:
            raise failure

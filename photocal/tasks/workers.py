"""Pieces of work on several processes or machines, in the order they were given, few in memory at a time."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

from drivers.errors import ProgramMissingError
from photocal.tasks.cluster import Cluster

Task = TypeVar("Task")
Result = TypeVar("Result")

# Processes of this machine, 1 for this very process; or a cluster.
Workers = int | Cluster

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def run_tasks(
    function: Callable[[Task], Result], tasks: Iterable[Task], workers: Workers
) -> Iterator[Result]:
    """Do a piece of work for each task.

    raises ProgramMissingError: when a worker process died, for want of memory as a rule.
    raises DeviceError: when a cluster does not answer.
    """
    if isinstance(workers, Cluster):
        yield from workers.run(function, tasks)
    elif workers <= 1:
        yield from map(function, tasks)
    else:
        yield from _on_processes(function, tasks, workers)


def _on_processes(
    function: Callable[[Task], Result], tasks: Iterable[Task], processes: int
) -> Iterator[Result]:
    waiting: deque[Future[Result]] = deque()
    with _one_thread_each(), ProcessPoolExecutor(processes, get_context("spawn"), _prepare) as pool:
        try:
            for task in tasks:
                waiting.append(pool.submit(function, task))
                if len(waiting) > 2 * processes:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except BrokenPipeError as death:
            raise _died() from death
        except RuntimeError as death:
            # concurrent.futures' BrokenProcessPool is a RuntimeError.
            if type(death).__name__ != "BrokenProcessPool":
                raise
            raise _died() from death
        finally:
            for future in waiting:
                future.cancel()


def _died() -> ProgramMissingError:
    return ProgramMissingError(
        "a worker process died, probably for want of memory",
        remedy="use fewer workers (--workers 1); finished images are not computed again",
    )


def _prepare() -> None:
    import cv2

    cv2.setNumThreads(1)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let the processes that start now compute with one thread each."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

"""Pieces of work that come back: each to the process that keeps what it computed for it before.

A home is a number; all work of one home goes to one process as long as that lives. When it dies another
process takes its homes over: work must be able to begin anew from files.
"""

import os
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from photocal.base.errors import ProgramMissingError
from photocal.base.workers import Cluster, Workers, one_thread_each, own_processes

Task = TypeVar("Task")
Result = TypeVar("Result")
# A piece of work is begun so often, when processes die; so many wait for each process.
_TRIES, _AHEAD = 3, 6
# After so long without a result it is asked whether the worker still lives, s.
_PATIENCE_S = 2.0


class Homes(Protocol):
    """Processes that keep what they computed."""

    def each(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], home: Callable[[Task], int]
    ) -> Iterator[Result]:
        """Do a piece of work for each task, at its home; results come in the order of the tasks.

        raises ProgramMissingError: when processes die again and again.
        raises DeviceError: when a cluster is lost.
        """
        ...


@contextmanager
def homes(workers: Workers) -> Iterator[Homes]:
    """Open homes in this process, in others of this computer, or on a cluster."""
    if isinstance(workers, Cluster):
        with workers.client() as client:
            yield _OnCluster(client)
    elif workers <= 1:
        yield _Here()
    else:
        with _OnProcesses(workers).opened() as opened:
            yield opened


@dataclass(frozen=True)
class _Here:
    """All homes are this process."""

    def each(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], home: Callable[[Task], int]
    ) -> Iterator[Result]:
        """See `Homes`."""
        del home
        return map(function, tasks)


@dataclass(frozen=True)
class _OnProcesses:
    """So many processes of this computer, each a pool of its own."""

    count: int
    pools: dict[int, ProcessPoolExecutor] = field(default_factory=dict)

    @contextmanager
    def opened(self) -> Iterator["_OnProcesses"]:
        """Start no process yet; end all that were started."""
        try:
            yield self
        finally:
            for pool in self.pools.values():
                pool.shutdown(cancel_futures=True)

    def _submit(self, function: Callable[[Task], Result], task: Task, place: int) -> Future[Result]:
        if place not in self.pools:
            with one_thread_each():
                self.pools[place] = own_processes(1)
                # Processes start with the first task.
                self.pools[place].submit(os.getpid).result()
        return self.pools[place].submit(function, task)

    def each(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], home: Callable[[Task], int]
    ) -> Iterator[Result]:
        """See `Homes`."""
        waiting: deque[tuple[Task, int, Future[Result]]] = deque()

        def begun(task: Task) -> None:
            """Begin a piece of work at its home."""
            place = home(task) % self.count
            waiting.append((task, place, self._begun(function, task, place)))

        for task in tasks:
            begun(task)
            if len(waiting) > _AHEAD * self.count:
                yield self._ended(function, *waiting.popleft())
        while waiting:
            yield self._ended(function, *waiting.popleft())

    def _begun(self, function: Callable[[Task], Result], task: Task, place: int) -> Future[Result]:
        try:
            return self._submit(function, task, place)
        except BrokenExecutor:
            # Found dead before it had anything to do.
            self.pools.pop(place, None)
            return self._submit(function, task, place)

    def _ended(
        self, function: Callable[[Task], Result], task: Task, place: int, future: Future[Result]
    ) -> Result:
        for _ in range(_TRIES):
            pool = self.pools.get(place)
            try:
                return future.result()
            except BrokenExecutor:
                if self.pools.get(place) is pool:
                    self.pools.pop(place, None)
                future = self._begun(function, task, place)
        raise ProgramMissingError(
            "a worker process died again and again, probably for lack of memory",
            "use fewer workers, or more parts",
        )


@dataclass(frozen=True)
class _OnCluster:
    """The workers of a Dask cluster.

    names: address of the worker of each place, as far as it was asked for.
    """

    client: Any
    names: list[str] = field(default_factory=list)

    def _place(self, number: int) -> str:
        """Address of the worker of a home; that of a dead one is taken over."""
        alive = sorted(self.client.ncores())
        if not self.names:
            self.names.extend(alive)
        place = number % len(self.names)
        if self.names[place] not in alive and alive:
            new = [name for name in alive if name not in self.names]
            self.names[place] = (new or alive)[number % len(new or alive)]
        return self.names[place]

    def each(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], home: Callable[[Task], int]
    ) -> Iterator[Result]:
        """See `Homes`."""
        waiting: deque[tuple[Task, str, Any]] = deque()
        ahead = _AHEAD * sum(self.client.ncores().values())
        for task in tasks:
            place = self._place(home(task))
            waiting.append((task, place, self._submit(function, task, place)))
            if len(waiting) > ahead:
                yield self._ended(function, home, *waiting.popleft())
        while waiting:
            yield self._ended(function, home, *waiting.popleft())

    def _submit(self, function: Callable[[Task], Result], task: Task, place: str) -> Any:
        with warnings.catch_warnings():
            # Covariances of separators go with the task: a few megabytes.
            warnings.filterwarnings("ignore", message="Sending large graph")
            return self.client.submit(function, task, pure=False, workers=[place])

    def _ended(
        self,
        function: Callable[[Task], Result],
        home: Callable[[Task], int],
        task: Task,
        place: str,
        future: Any,
    ) -> Any:
        for _ in range(_TRIES):
            while True:
                try:
                    return future.result(timeout=_PATIENCE_S)
                except TimeoutError:
                    if future.done():
                        # The work itself has raised it.
                        raise
                    if place not in self.client.ncores() and self.client.ncores():
                        break
            future.cancel()
            place = self._place(home(task))
            future = self._submit(function, task, place)
        raise ProgramMissingError(
            "workers of the cluster died again and again, probably for lack of memory",
            "give them more memory, or use more parts",
        )

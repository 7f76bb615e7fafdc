"""Pieces of work on several processes or machines, in the order they were given, few in memory at a time."""

import importlib
import os
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from ipaddress import ip_address
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Lock, Thread
from types import ModuleType
from typing import Any, TypeVar

from photocal.base.errors import ConfigurationError, DeviceError, PhotocalError, ProgramMissingError
from photocal.base.operating_system import available_memory

Task = TypeVar("Task")
Result = TypeVar("Result")

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_CREW: ContextVar[dict[int, ProcessPoolExecutor] | None] = ContextVar("crew", default=None)
_STARTING = Lock()
_TIMEOUT_S = 10
_UNPROTECTED = "unprotected+"


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    workers: "Workers",
    done: Callable[[float], None] = lambda _: None,
    at_hand: Callable[[Task], bool] = lambda _: False,
) -> Iterator[Result]:
    """Do a piece of work for each task, and tell `done` when its result was taken.

    at_hand: whether the result of a task is kept: this process takes it, and starts others only for the rest.

    raises ProgramMissingError: when a worker process died, for lack of memory as a rule.
    raises DeviceError: when a cluster does not answer.
    """
    results: Iterable[Result]
    if isinstance(workers, Cluster):
        results = workers.run(function, tasks)
    elif workers <= 1:
        results = map(function, tasks)
    else:
        results = _on_processes(function, tasks, workers, at_hand)
    for result in results:
        yield result
        done(1)


@contextmanager
def one_crew() -> Iterator[None]:
    """Let all work within go to the same processes: each takes seconds to start."""
    if _CREW.get() is not None:
        yield
        return
    crew: dict[int, ProcessPoolExecutor] = {}
    before = _CREW.set(crew)
    try:
        yield
    finally:
        _CREW.reset(before)
        for pool in crew.values():
            pool.shutdown(cancel_futures=True)


class _Processes(ProcessPoolExecutor):
    """Processes that do not run the script again that started them: it may have no guard against that."""

    def submit(self, function: Callable[..., Result], /, *args: Any, **keys: Any) -> Future[Result]:
        """Give work to a process; one that begins now runs what stands as main here."""
        with _STARTING:
            script = sys.modules["__main__"]
            sys.modules["__main__"] = ModuleType("__main__")
            try:
                return super().submit(function, *args, **keys)
            finally:
                sys.modules["__main__"] = script


def own_processes(processes: int, prepare: Callable[[], None] | None = None) -> ProcessPoolExecutor:
    """Give processes that end when this one does, however it ends; each prepares itself.

    They do work of modules, and know nothing of the script that was started.
    """
    return _Processes(processes, get_context("spawn"), _begin, (prepare,))


def _begin(prepare: Callable[[], None] | None) -> None:
    """Begin a process that works for another."""
    # One that is killed, for lack of memory as a rule, ends none: they would wait for work for ever.
    Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    crew = _CREW.get()
    if crew is not None and processes in crew:
        yield crew[processes]
        return
    pool = own_processes(processes, _prepare)
    if crew is not None:
        crew[processes] = pool
        yield pool
        return
    with pool:
        yield pool


def _on_processes(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    processes: int,
    at_hand: Callable[[Task], bool],
) -> Iterator[Result]:
    waiting: deque[Future[Result]] = deque()
    pool: ProcessPoolExecutor | None = None
    with ExitStack() as opened:
        try:
            for task in tasks:
                if at_hand(task):
                    waiting.append(_ended(function(task)))
                else:
                    if pool is None:
                        opened.enter_context(one_thread_each())
                        pool = opened.enter_context(_pool(processes))
                    waiting.append(pool.submit(function, task))
                if len(waiting) > 2 * processes:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except (BrokenPipeError, BrokenExecutor) as death:
            raise ProgramMissingError(
                "a worker process died, probably for lack of memory",
                "use fewer workers (--workers 1); finished images are not computed again",
            ) from death
        finally:
            for future in waiting:
                future.cancel()


def _ended(result: Result) -> Future[Result]:
    future: Future[Result] = Future()
    future.set_result(result)
    return future


def _prepare() -> None:
    import cv2

    cv2.setNumThreads(1)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let the processes that start now compute with one thread each."""
    before = {name: os.environ[name] for name in _THREADS if name in os.environ}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name in _THREADS:
            os.environ.pop(name, None)
        os.environ.update(before)


def protected(address: str) -> str:
    """Return the address of a scheduler that may be joined; raises ConfigurationError for one open to all."""
    scheme, _, place = (address if "://" in address else f"tcp://{address}").partition("://")
    if scheme.startswith(_UNPROTECTED):
        return f"{scheme.removeprefix(_UNPROTECTED)}://{place}"
    host = place.rpartition(":")[0].strip("[]") or place
    try:
        here = host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        here = False
    if scheme == "tls" or here:
        return address
    raise ConfigurationError(
        "the scheduler is on another computer and the connection is not protected: the scheduler, and "
        "anyone who intercepts the connection, can run any program here",
        f"start it with TLS (tls://HOST:PORT), or write {_UNPROTECTED}tcp://{place} in a network you trust",
        where=address,
    )


@dataclass(frozen=True)
class Cluster:
    """A Dask scheduler; `address`: such as ``tls://10.0.0.5:8786``.

    A scheduler runs what anybody in its network sends: one on another computer is joined by TLS only, or
    where the address says ``unprotected+tcp://HOST:PORT``.
    """

    address: str

    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Do a piece of work for each task; one whose worker dies is done again by another.

        raises ProgramMissingError: when dask.distributed is not installed.
        raises DeviceError: when no scheduler answers, or it or all workers are lost.
        raises PhotocalError: what a task raised.
        """
        with self.client() as client:
            threads = sum(client.ncores().values())
            waiting: deque[Any] = deque()
            # So many tasks wait for each thread of a worker: none is idle, and few results are held.
            ahead = 2
            for task in tasks:
                waiting.append(client.submit(function, task, pure=False))
                if len(waiting) > ahead * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def require_shared(self, images: Path, cache: Path) -> None:
        """Make sure that all workers see the images, and results that others keep.

        raises ConfigurationError: naming a worker and the folder that it does not see.
        raises ProgramMissingError, DeviceError: as `run`.
        """
        cache.mkdir(parents=True, exist_ok=True)
        with self.client() as client, tempfile.NamedTemporaryFile(dir=cache) as proof:
            for path, folder in ((Path(proof.name), cache), (images, images)):
                seen: dict[str, bool] = client.run(os.path.exists, str(path.resolve()))
                blind = sorted(name for name, sees in seen.items() if not sees)
                if blind:
                    raise ConfigurationError(
                        f"worker {blind[0]} does not see it",
                        "name a folder (--cache, the images) that all machines of the cluster share",
                        where=folder,
                    )

    @contextmanager
    def client(self) -> Iterator[Any]:
        """Join the cluster; errors as of `run`."""
        try:
            distributed: Any = importlib.import_module("distributed")
        except ImportError as refusal:
            raise ProgramMissingError(
                "dask.distributed is not installed", "install photocal[cluster]"
            ) from refusal
        address = protected(self.address)
        try:
            client = distributed.Client(address, timeout=f"{_TIMEOUT_S}s", set_as_default=False)
        except (OSError, ValueError) as refusal:
            raise DeviceError(
                "no scheduler answers there",
                "start `dask scheduler` and name its address",
                where=self.address,
            ) from refusal
        with client:
            try:
                client.wait_for_workers(1, timeout=_TIMEOUT_S)
            except TimeoutError as refusal:
                raise DeviceError(
                    "the scheduler has no workers",
                    f"start some with `dask worker {self.address}`",
                    where=self.address,
                ) from refusal
            try:
                yield client
            except PhotocalError:
                raise
            except Exception as failure:
                if not type(failure).__module__.startswith("distributed"):
                    raise
                # KilledWorker, FutureCancelledError, CommClosedError: the machines, not the task.
                raise DeviceError(
                    f"the cluster was lost ({type(failure).__name__})",
                    "check the memory of its workers and start again; what was finished is kept",
                    where=self.address,
                ) from failure


# Processes of this machine, 1 for this very process; or a cluster.
Workers = int | Cluster


def affordable(each_bytes: float, own_bytes: float) -> int:
    """Give how many processes to start: one on each core, unless their memory would not hold them.

    each_bytes, own_bytes: predicted peaks of a worker, and of this process beside them.
    """
    cores, free = os.cpu_count() or 1, available_memory()
    return cores if free is None else max(1, min(cores, int((free - own_bytes) / each_bytes)))

"""Pieces of work on other machines, through a Dask scheduler whose workers see the same files."""

from __future__ import annotations

import importlib
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from drivers.errors import ConfigurationError, DeviceError, PhotocalError, ProgramMissingError

Task = TypeVar("Task")
Result = TypeVar("Result")

_TIMEOUT_S = 10
# So many tasks wait for each thread of a worker: none is idle, and few results are held.
_AHEAD = 2


@dataclass(frozen=True)
class Cluster:
    """A Dask scheduler; `address`: such as ``tcp://10.0.0.5:8786``."""

    address: str

    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Do a piece of work for each task; one whose worker dies is done again by another.

        raises ProgramMissingError: when dask.distributed is not installed.
        raises DeviceError: when no scheduler answers, or it or all workers are lost.
        raises PhotocalError: what a task raised.
        """
        with self._client() as client:
            threads = sum(client.ncores().values())
            waiting: deque[Any] = deque()
            for task in tasks:
                waiting.append(client.submit(function, task, pure=False))
                if len(waiting) > _AHEAD * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def require_shared(self, images: Path, cache: Path) -> None:
        """Make sure that all workers see the images, and results that others keep.

        raises ConfigurationError: naming a worker and the folder that it does not see.
        raises ProgramMissingError, DeviceError: as `run`.
        """
        cache.mkdir(parents=True, exist_ok=True)
        with self._client() as client, tempfile.NamedTemporaryFile(dir=cache) as proof:
            for path, folder in ((Path(proof.name), cache), (images, images)):
                seen: dict[str, bool] = client.run(_sees, str(path.resolve()))
                blind = sorted(name for name, sees in seen.items() if not sees)
                if blind:
                    raise ConfigurationError(
                        f"worker {blind[0]} does not see it",
                        where=folder,
                        remedy="name a folder (--cache, the images) that all machines of the cluster share",
                    )

    @contextmanager
    def _client(self) -> Iterator[Any]:
        try:
            distributed: Any = importlib.import_module("distributed")
        except ImportError as refusal:
            raise ProgramMissingError(
                "dask.distributed is not installed", remedy="install photocal[cluster]"
            ) from refusal
        try:
            client = distributed.Client(self.address, timeout=f"{_TIMEOUT_S}s", set_as_default=False)
        except (OSError, ValueError) as refusal:
            raise DeviceError(
                "no scheduler answers there",
                where=self.address,
                remedy="start `dask scheduler` and name its address",
            ) from refusal
        with client:
            try:
                client.wait_for_workers(1, timeout=_TIMEOUT_S)
            except TimeoutError as refusal:
                raise DeviceError(
                    "the scheduler has no workers",
                    where=self.address,
                    remedy=f"start some with `dask worker {self.address}`",
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
                    where=self.address,
                    remedy="look at its workers' memory and start again; what was finished is kept",
                ) from failure


def _sees(path: str) -> bool:
    return Path(path).exists()

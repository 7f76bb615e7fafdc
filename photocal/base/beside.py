"""Work that a copy of this process does beside it, while this one goes on with what does not wait for it."""

import gc
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import Context, ContextVar
from multiprocessing.connection import Connection, Pipe
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")
Told = Callable[[float], None]
_STARTED: ContextVar[list[int] | None] = ContextVar("started", default=None)


class Beside(Generic[Result]):
    """A piece of work, begun in a copy of this process where there is one.

    The copy has all that this process has in memory, and costs nothing to start. What happens to it does not
    matter: work that does not come to its end there is done here when its result is asked for, and fails
    here, too. So it is on systems that cannot copy a process, or not safely.

    work: gets a function that takes the share done since its last call; it writes nothing to standard output,
        and sees no context (`contextvars`) of who begins it.
    """

    def __init__(self, work: Callable[[Told], Result]) -> None:
        self._work = work
        self._from_copy: Connection[Any, Any] | None = None
        self._copy = 0
        started = _STARTED.get()
        if started is None or not _can_copy():
            return
        self._from_copy, to_parent = Pipe(duplex=False)
        with suppress(OSError):
            self._copy = os.fork()
            if self._copy == 0:
                _answer(work, to_parent)
            started.append(self._copy)
        to_parent.close()

    def result(self, told: Told) -> Result:
        """Wait for the result; `told` gets the shares that were done."""
        while self._from_copy is not None:
            try:
                done, share = self._from_copy.recv()
            except (EOFError, OSError):
                self._from_copy.close()
                self._from_copy = None
                break
            if done:
                result: Result = share
                return result
            told(share)
        return Context().run(self._work, told)


def _can_copy() -> bool:
    """Whether this process can be copied, and there is a core for the copy."""
    # Libraries of macOS do not stand it, Windows has it not. What other threads hold, in a server that runs
    # this as one of its threads, nobody would give back in the copy.
    alone = threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and alone and (os.cpu_count() or 1) > 1


def _answer(work: Callable[[Told], Any], to_parent: "Connection[Any, Any]") -> None:
    """Do a piece of work as the copy of a process, and end; without an answer where it fails."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        # This process writes there, perhaps just now.
        sys.stdout = sys.stderr = io.StringIO()
        # Looking at all objects would copy their pages.
        gc.disable()
        to_parent.send((True, Context().run(work, lambda share: to_parent.send((False, share)))))
    finally:
        os._exit(0)


@contextmanager
def beside() -> Iterator[None]:
    """Let work within be begun in copies of this process; none of them lives longer than this."""
    started: list[int] = []
    before = _STARTED.set(started)
    try:
        yield
    finally:
        _STARTED.reset(before)
        for copy in started:
            with suppress(OSError):
                os.kill(copy, signal.SIGKILL)
            with suppress(OSError):
                os.waitpid(copy, 0)

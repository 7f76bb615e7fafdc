"""Work that a copy of this process does beside it, while this one goes on with what does not wait for it."""

import gc
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import Context, ContextVar
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")
Told = Callable[[float], None]
# A copy that has used no processor between two looks so far apart will not end.
_PATIENCE_S = 5.0
_STARTED: ContextVar[list[int] | None] = ContextVar("started", default=None)


class Beside(Generic[Result]):
    """A piece of work, begun in a copy of this process where there is one.

    The copy has all that this process has in memory, and costs nothing to start. What happens to it does not
    matter: work that does not come to its end there, or hangs, is done here when its result is asked for, and
    fails here, too. So it is on systems that cannot copy a process, or not safely.

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
        # From 3.12 on Python warns of threads, whose locks nobody would release in the copy: it would wait
        # for ever, which is noticed when the result is asked for.
        with suppress(OSError), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            self._copy = os.fork()
            if self._copy == 0:
                _answer(work, to_parent)
            started.append(self._copy)
        to_parent.close()

    def result(self, told: Told) -> Result:
        """Wait for the result; `told` gets the shares that were done."""
        while self._from_copy is not None:
            try:
                done, share = _received(self._from_copy, self._copy)
            except (EOFError, OSError):
                # It does not write where this process writes from now on.
                os.kill(self._copy, signal.SIGKILL)
                self._from_copy.close()
                self._from_copy = None
                break
            if done:
                result: Result = share
                return result
            told(share)
        return Context().run(self._work, told)


def _received(from_copy: "Connection[Any, Any]", copy: int) -> tuple[bool, Any]:
    """Wait for what a copy sends; raises EOFError where it has ended or does nothing any more."""
    used = -1.0
    while not from_copy.poll(_PATIENCE_S):
        before, used = used, _processor_s(copy)
        if used <= before:
            raise EOFError
    received: tuple[bool, Any] = from_copy.recv()
    return received


def _processor_s(process: int) -> float:
    """Processor time of a process: what waits for a lock that no thread of a copy holds uses none."""
    # Its name, in brackets, may have blanks.
    fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    user, system = 11, 12
    return float(int(fields[user]) + int(fields[system])) / os.sysconf("SC_CLK_TCK")


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

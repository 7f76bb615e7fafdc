"""What goes out beside the log: a short queue and a thread, whose slowness and failure nobody else feels."""

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from photocal.base.console import printable

Item = TypeVar("Item")


class Outlet(Generic[Item]):
    """Takes items without ever waiting and hands them on, one after the other, in a thread of its own.

    The log is written by a thread that must wait for nothing but the disk: a terminal, a device or a caster
    that takes nothing, or fails, costs items of its own outlet alone. They are counted: `dropped` those that
    made room for later ones or became too old, `failed` those over which `act` has failed; `failure` is its
    last failure in words.

    name: of the thread, which begins with the first item.
    act: what is done with an item.
    most: number of items that may wait; then the oldest goes.
    longest_s: after this time an item is of no use any more, seconds.
    """

    def __init__(
        self, name: str, act: Callable[[Item], None], most: int = 200, longest_s: float = math.inf
    ) -> None:
        self.dropped = self.failed = 0
        self.failure = ""
        self._act, self._most, self._longest_s = act, most, longest_s
        self._waiting: deque[tuple[float, Item]] = deque()
        self._changed = threading.Condition()
        # Since when the thread has been at an item; None while it is at none.
        self._at_it_s: float | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def put(self, item: Item) -> None:
        """Take an item; never waits."""
        with self._changed:
            if len(self._waiting) >= self._most:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append((time.monotonic(), item))
            self._changed.notify_all()
            if self._thread.ident is None:
                # A computer that has no more threads to give takes the outlet away, not the log.
                with contextlib.suppress(RuntimeError):
                    self._thread.start()

    def close(self, patience_s: float) -> bool:
        """Take leave when all has gone out, or one item takes longer than so; tell whether all went out."""
        began_s = time.monotonic()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            # How long the thread itself may take to come to what waits, however busy the computer is.
            awake_s = 5.0
            while self._waiting or self._at_it_s is not None:
                now = time.monotonic()
                if now > (began_s + awake_s if self._at_it_s is None else self._at_it_s + patience_s):
                    return False
                self._changed.wait(0.01)
        return not (self.dropped or self.failed)

    def _run(self) -> None:
        while (item := self._next()) is not None:
            try:
                self._act(item[1])
            except BaseException as failure:
                self.failed += 1
                self.failure = printable(str(failure) or type(failure).__name__)

    def _next(self) -> tuple[float, Item] | None:
        with self._changed:
            self._at_it_s = None
            self._changed.notify_all()
            while True:
                while self._waiting:
                    put_s, item = self._waiting.popleft()
                    now = time.monotonic()
                    if now - put_s <= self._longest_s:
                        self._at_it_s = now
                        return put_s, item
                    self.dropped += 1
                if self._closed:
                    return None
                self._changed.wait()

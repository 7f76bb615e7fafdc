"""How far longer work is: a title and an amount give a context in which the work done is told."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

Progress = Callable[[str, float | None], AbstractContextManager[Callable[[float], None]]]


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Callable[[float], None]]:
    """Show no progress."""
    yield lambda _: None

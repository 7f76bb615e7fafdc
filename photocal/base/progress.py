"""Progress of longer work: `progress(title, total)` is a context that gives `advance(amount)`."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

Progress = Callable[[str, float | None], AbstractContextManager[Callable[[float], None]]]


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Callable[[float], None]]:
    """Show no progress."""
    yield lambda _: None


@dataclass(frozen=True)
class Standing:
    """How far a run of several stages is.

    title, piece_share, piece_left_s, piece_s: of the piece of work within the stage; share and time left are
        None where its amount is not known.
    share, left_s, elapsed_s: of the whole run.
    """

    stage: str
    title: str
    piece_share: float | None
    piece_left_s: float | None
    piece_s: float
    share: float
    left_s: float
    elapsed_s: float


# Takes the progress of a run about once a second.
Bar = Callable[[], AbstractContextManager[Callable[[Standing], None]]]


@contextmanager
def unseen() -> Iterator[Callable[[Standing], None]]:
    """Show nothing of a run."""
    yield lambda _: None

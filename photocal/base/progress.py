"""Progress of longer work: `progress(title, total)` is a context that gives `advance(amount)`."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from threading import Event, Thread

from photocal.base.errors import OutputError

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
    share, left_s, elapsed_s: of the whole run; time left is NaN before the run knows what it has to do.
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


@contextmanager
def followed(standing: Callable[[], Standing], *listeners: Callable[[Standing], None]) -> Iterator[None]:
    """Tell listeners about once a second how far a run is, whatever it works on meanwhile."""
    ended = Event()

    def tell() -> None:
        """Tell until the run has ended."""
        told_every_s = 1.0
        while True:
            for listener in listeners:
                # No work ends because its progress cannot be reported.
                with suppress(OutputError, OSError):
                    listener(standing())
            if ended.wait(told_every_s):
                return

    beside = Thread(target=tell, daemon=True)
    beside.start()
    try:
        yield
    finally:
        ended.set()
        beside.join()

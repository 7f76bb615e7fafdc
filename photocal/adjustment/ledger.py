"""Which adjustments were made, and why: whoever wants to know opens a ledger."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

_REASON: ContextVar[str] = ContextVar("reason", default="")
_LEDGERS: ContextVar[tuple[list["NamedAdjustment"], ...]] = ContextVar("ledgers", default=())


@dataclass(frozen=True)
class NamedAdjustment:
    """One adjustment: its reason, its size and the iterations that it took."""

    reason: str
    images: int
    rays: int
    iterations: int


@contextmanager
def because(reason: str) -> Iterator[None]:
    """Give the adjustments within a reason; the innermost one counts."""
    before = _REASON.set(reason)
    try:
        yield
    finally:
        _REASON.reset(before)


@contextmanager
def ledger() -> Iterator[list[NamedAdjustment]]:
    """Give a list that receives every adjustment made within, in their order."""
    entries: list[NamedAdjustment] = []
    before = _LEDGERS.set((*_LEDGERS.get(), entries))
    try:
        yield entries
    finally:
        _LEDGERS.reset(before)


def enter(images: int, rays: int, iterations: int) -> None:
    """Enter an adjustment into all open ledgers."""
    for entries in _LEDGERS.get():
        entries.append(NamedAdjustment(_REASON.get(), images, rays, iterations))

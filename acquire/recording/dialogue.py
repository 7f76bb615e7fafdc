"""What is said to the devices on a link while it is recorded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivers.frames import Batch


@dataclass(frozen=True)
class Said:
    """Bytes for the device and words for the person (an error when it is an alarm)."""

    frames: tuple[bytes, ...] = ()
    notes: tuple[str, ...] = ()
    alarms: tuple[str, ...] = ()


class Dialogue(Protocol):
    """One side of a conversation; it opens no port and reads no clock."""

    @property
    def finished(self) -> bool:
        """Whether everything that was asked for was answered or given up."""
        ...

    def step(self, batch: Batch | None, steady_s: float, clock_ns: int) -> Said:
        """Take what was received (None: nothing) and return what is to be said now."""
        ...

"""Time of receipt of recordings that do not carry it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np

from acquire.channels.log_decoder import BootTime
from drivers.arrays import Integers
from drivers.errors import InputMalformedError
from drivers.frames import Batch
from drivers.logged import Definitions


class Clock(Protocol):
    """Reads the time of a device from its own frames."""

    @property
    def sources(self) -> set[str]:
        """What told the time so far."""
        ...

    def feed(self, batch: Batch) -> Integers:
        """Return UTC for each frame, nanoseconds since 1970; -1 before it was told."""
        ...

    def restart(self, near_ns: int) -> None:
        """Begin anew with a stream whose time is known within half a day."""
        ...


def stamped(batches: Iterable[Batch]) -> Iterator[tuple[Batch, Integers]]:
    """Yield batches with the host stamps of their recording."""
    for batch in batches:
        assert batch.host_ns is not None  # noqa: S101
        yield batch, batch.host_ns


def derived(batches: Iterable[Batch], clock: Clock, where: object) -> Iterator[tuple[Batch, Integers]]:
    """Yield batches with the receiver's own UTC, since there is no time of receipt.

    Each frame has the last time that was told before it; what comes before the first time has that one.
    Times never go back.
    """
    waiting: list[Batch] = []
    last = -1
    for batch in batches:
        if last >= 0:
            times = _steady(clock.feed(batch), last)
            last = int(times[-1]) if len(times) else last
            yield batch, times
            continue
        waiting.append(batch)
        device = clock.feed(batch)
        if not (device >= 0).any():
            continue
        # The date is known now: what came before it can be read again, with the date at hand.
        clock.restart(int(device[device >= 0][0]))
        devices = [clock.feed(earlier) for earlier in waiting]
        told = np.concatenate(devices)
        last = int(told[told >= 0][0])
        for earlier, device in zip(waiting, devices, strict=True):
            times = _steady(device, last)
            last = int(times[-1]) if len(times) else last
            yield earlier, times
        waiting.clear()
    if waiting:
        raise InputMalformedError(
            "no message tells the date (RXM-RAWX, NAV-PVT, NAV-TIMEGPS, NAV-TIMEUTC, RMC, ZDA or 1013)",
            where=where,
            remedy="give --date YYYY-MM-DD, or record one of these messages too",
        )


def since_boot(
    batches: Iterable[Batch], definitions: Definitions, boot: BootTime
) -> Iterator[tuple[Batch, Integers]]:
    """Yield batches of an autopilot's own log with the UTC of its records, since there is no receipt.

    Records without a time have the last one; what comes before the first has the time of the start. Times
    never go back.
    """
    last = boot.utc_ns
    for batch in batches:
        definitions.learn(batch)
        times = _steady(boot.of(definitions.boot_ns(batch)), last)
        last = int(times[-1]) if len(times) else last
        yield batch, times


def _steady(device: Integers, last: int) -> Integers:
    return np.asarray(np.maximum.accumulate(np.concatenate([[last], device]))[1:], np.int64)

"""What a recording of each format needs to be imported: where its times come from, and what decodes it."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from acquire.channels.decoded import Decoder
from acquire.channels.log_decoder import (
    BootTime,
    DataflashDecoder,
    EventListClock,
    EventListDecoder,
    UlogDecoder,
    boot_time,
)
from acquire.channels.receiver import ReceiverDecoder
from acquire.channels.receiver_time import ReceiverClock
from acquire.channels.vehicle import VehicleDecoder
from acquire.importing.recording import (
    DATAFLASH_LOG,
    EVENT_LIST,
    PX4_LOG,
    TELEMETRY_LOG,
    RecordedBytes,
    RecordingFormat,
)
from drivers.dataflash import DataflashFormats
from drivers.frames import Batch
from drivers.mavlink.dialect import Dialect
from drivers.ulog import UlogFormats
from photocal.base.arrays import Integers
from photocal.base.errors import InputMalformedError
from photocal.base.time_scales import expiry_warning

Clock = ReceiverClock | EventListClock
Definitions = UlogFormats | DataflashFormats
# What decodes an autopilot's own log, what it defines, and what is to be known of its times.
_LOGS: dict[RecordingFormat, tuple[Any, type[Definitions], Callable[[int], str]]] = {
    DATAFLASH_LOG: (DataflashDecoder, DataflashFormats, expiry_warning),
    PX4_LOG: (UlogDecoder, UlogFormats, lambda _: ""),
}
HOST_TIME = "host stamps of the recording"

Timed = Iterator[tuple[Batch, Integers]]


def stamped(batches: Iterable[Batch]) -> Timed:
    """Yield batches with the host stamps of their recording."""
    for batch in batches:
        assert batch.host_ns is not None  # noqa: S101
        yield batch, batch.host_ns


def derived(batches: Iterable[Batch], clock: Clock, where: object) -> Timed:
    """Yield batches with the receiver's own UTC, since there is no time of receipt."""

    def timed() -> Timed:
        """Give each batch with the UTC of its frames, once the first time of the device is known."""
        left, waiting = iter(batches), list[Batch]()
        for batch in left:
            waiting.append(batch)
            device = clock.feed(batch)
            if (device >= 0).any():
                # The date is known now: what came before it can be read again, with the date at hand.
                clock.restart(int(device[device >= 0][0]))
                devices = [clock.feed(earlier) for earlier in waiting]
                first = next(time for device in devices for time in device.tolist() if time >= 0)
                yield from zip(waiting, (np.maximum(device, first) for device in devices), strict=True)
                break
        else:
            if waiting:
                raise InputMalformedError(
                    "no message contains the date (RXM-RAWX, NAV-PVT, NAV-TIMEGPS, NAV-TIMEUTC, RMC, ZDA "
                    "or 1013)",
                    where=where,
                    remedy="give --date YYYY-MM-DD, or record one of these messages too",
                )
        for batch in left:
            yield batch, clock.feed(batch)

    return _steadily(timed(), -1)


def since_boot(batches: Iterable[Batch], definitions: Definitions, boot: BootTime) -> Timed:
    """Yield batches of an autopilot's own log with the UTC of its records, since there is no receipt."""

    def timed() -> Timed:
        """Give each batch with the times since boot as the records' own definitions state them."""
        for batch in batches:
            definitions.learn(batch)
            yield batch, boot.of(definitions.boot_ns(batch))

    return _steadily(timed(), boot.utc_ns)


def _steadily(timed: Timed, last: int) -> Timed:
    """Yield batches with times that never go back: a frame without a time has the last one before it."""
    for batch, device in timed:
        times = np.maximum.accumulate(np.append(last, device))
        last = int(times[-1])
        yield batch, times[1:]


@dataclass(frozen=True)
class Way:
    """The way of a recording into the log.

    time_source: says, after the import, where the times came from.
    warned: says what to know about the times, given the last one; empty when they are sure.
    """

    decoder: Decoder
    timed: Callable[[Iterable[Batch]], Timed]
    time_source: Callable[[], str]
    warned: Callable[[int], str] = expiry_warning


def way_of(source: RecordedBytes, form: RecordingFormat, link: str, dialect: Dialect, near_ns: int) -> Way:
    """Return the way of a recording."""
    if form is TELEMETRY_LOG:
        # Host stamps are UTC already; what a receiver tells in GPS time needs the leap seconds.
        return Way(VehicleDecoder(link, dialect), stamped, lambda: HOST_TIME, lambda _: "")
    if form in _LOGS:
        decoder, formats, warned = _LOGS[form]
        boot = boot_time(source.batches(form.framer(dialect)), formats())
        if boot is None:
            raise InputMalformedError(
                "the autopilot's receiver never reported UTC with a 3D fix: its times cannot be placed",
                where=source.path,
                remedy="import a log that was recorded outdoors",
            )
        time_source = f"running time of the autopilot, tied to UTC by {boot.pairs} times of its GNSS receiver"
        timed = partial(since_boot, definitions=formats(), boot=boot)
        return Way(decoder(link, boot), timed, lambda: time_source, warned)
    events = form is EVENT_LIST
    clock: Clock = EventListClock() if events else ReceiverClock(near_ns)
    return Way(
        EventListDecoder(link) if events else ReceiverDecoder(link),
        partial(derived, clock=clock, where=source.path),
        lambda: _derivation(clock, near_ns),
    )


def _derivation(clock: Clock, near_ns: int) -> str:
    # Where the stream tells its date itself, that is what counts.
    dated = clock.sources or near_ns < 0
    text = ", ".join(sorted(clock.sources)) if dated else "time of day or week, the date as it was given"
    return f"derived from the receiver's own time ({text}); no host clock"

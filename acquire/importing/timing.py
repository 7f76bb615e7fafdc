"""What a recording of each format needs to be imported: where its times come from, and what decodes it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from acquire.channels.decoded import Decoder
from acquire.channels.log_decoder import BootTime, boot_time
from acquire.channels.vehicle import VehicleDecoder
from acquire.importing.log_time import Clock, derived, since_boot, stamped
from acquire.importing.recording import (
    DATAFLASH_LOG,
    EVENT_LIST,
    PX4_LOG,
    TELEMETRY_LOG,
    Format,
    Source,
)
from drivers.arrays import Integers
from drivers.errors import InputMalformedError
from drivers.frames import Batch
from drivers.gnsstime import expiry_warning
from drivers.logged import Definitions
from drivers.mavlink.dialect import Dialect

HOST_TIME = "host stamps of the recording"

Timed = Iterator[tuple[Batch, Integers]]


@dataclass(frozen=True)
class Way:
    """The way of a recording into the log.

    decoder: what decodes it.
    timed: gives batches their times of receipt.
    told: says, after the import, where the times came from.
    warned: says what to know about the times, given the last one; empty when they are sure.
    """

    decoder: Decoder
    timed: Callable[[Iterable[Batch]], Timed]
    told: Callable[[], str]
    warned: Callable[[int], str] = expiry_warning


def way_of(source: Source, form: Format, link: str, dialect: Dialect, near_ns: int) -> Way:
    """Return the way of a recording."""
    # Each format brings its own modules: an import of a small log takes little longer than theirs.
    if form is TELEMETRY_LOG:
        # Host stamps are UTC already; what a receiver tells in GPS time needs the leap seconds.
        return Way(VehicleDecoder(link, dialect), stamped, lambda: HOST_TIME, lambda _: "")
    if form is DATAFLASH_LOG:
        from acquire.channels.dataflash import DataflashDecoder
        from drivers.dataflash import DataflashFormats

        boot = _boot(source, form, dialect, DataflashFormats())
        return _logged(DataflashDecoder(link, boot), boot, DataflashFormats(), expiry_warning)
    if form is PX4_LOG:
        from acquire.channels.ulog import UlogDecoder
        from drivers.ulog import UlogFormats

        boot = _boot(source, form, dialect, UlogFormats())
        return _logged(UlogDecoder(link, boot), boot, UlogFormats(), lambda _: "")
    if form is EVENT_LIST:
        from acquire.channels.event_list import EventListClock, EventListDecoder

        return _self_timed(EventListDecoder(link), EventListClock(), source, near_ns)
    from acquire.channels.receiver import ReceiverDecoder
    from acquire.channels.receiver_time import ReceiverClock

    return _self_timed(ReceiverDecoder(link), ReceiverClock(near_ns), source, near_ns)


def _self_timed(decoder: Decoder, clock: Clock, source: Source, near_ns: int) -> Way:
    return Way(
        decoder, lambda batches: derived(batches, clock, source.path), lambda: _derivation(clock, near_ns)
    )


def _logged(decoder: Decoder, boot: BootTime, formats: Definitions, warned: Callable[[int], str]) -> Way:
    told = f"running time of the autopilot, tied to UTC by {boot.pairs} times of its GNSS receiver"
    return Way(decoder, lambda batches: since_boot(batches, formats, boot), lambda: told, warned)


def _boot(source: Source, form: Format, dialect: Dialect, definitions: Definitions) -> BootTime:
    framer = form.framer(dialect)

    def batches() -> Iterator[Batch]:
        for piece in source.pieces():
            yield framer.feed(piece)
        yield framer.close()

    found = boot_time(batches(), definitions)
    if found is None:
        raise InputMalformedError(
            "the autopilot's receiver never told UTC with a 3D fix: its times cannot be placed",
            where=source.path,
            remedy="import a log that was recorded outdoors",
        )
    return found


def _derivation(clock: Clock, near_ns: int) -> str:
    told = sorted(clock.sources)
    # Where the stream tells its date itself, that is what counts.
    sources = ", ".join(told) if told or near_ns < 0 else "time of day or week, the date as it was given"
    return f"derived from the receiver's own time ({sources}); no host clock"

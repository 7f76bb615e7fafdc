"""Import of recordings: bytes to frames to the flight log, link after link.

What a recording of each format needs to be imported: where its times come from, and what decodes it.

A recording of another program: what it is, told by its content, and its bytes.
"""

import datetime as dt
import gzip
import hashlib
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np

from acquire.channels.decoded import Decoder
from acquire.channels.link import LinkLog, Tally
from acquire.channels.log_decoder import (
    boot_time,
    dataflash_decoder,
    event_list_decoder,
    event_utc_ns,
    since_start,
    ulog_decoder,
)
from acquire.channels.receiver import ReceiverClock, ReceiverDecoder
from acquire.channels.vehicle import VehicleDecoder
from acquire.log.chunk import MAGIC
from acquire.log.writer import LogWriter
from drivers.dataflash import DataflashFormats, DataflashFramer
from drivers.frames import Batch, Framer, StreamFramer
from drivers.mavlink.dialect import Dialect, ardupilotmega
from drivers.mrk import MrkFramer
from drivers.protocols import receiver_protocols, receiver_wires
from drivers.tlog import TlogFramer
from drivers.ulog import UlogFormats, UlogFramer
from photocal.base.arrays import Integers, picked
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, reading
from photocal.base.files import output_file
from photocal.base.time_scales import SECOND_NS, expiry_warning
from photocal.base.version import __version__

PIECE_BYTES = 1 << 20
_HEAD_BYTES = 1 << 17
_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class RecordingFormat:
    """A kind of recording.

    link: what a link with it is called when nobody names it; empty: after the file.
    framer: takes the known MAVLink messages and returns what finds the frames.
    """

    name: str
    link: str
    framer: Callable[[Dialect], Framer]


TELEMETRY_LOG = RecordingFormat("MAVLink telemetry log", "vehicle", TlogFramer)
RECEIVER_STREAM = RecordingFormat(
    "GNSS receiver stream", "", lambda dialect: StreamFramer(receiver_wires(), dialect)
)
DATAFLASH_LOG = RecordingFormat("ArduPilot DataFlash log", "vehicle", lambda _: DataflashFramer())
PX4_LOG = RecordingFormat("PX4 log (ULog)", "vehicle", lambda _: UlogFramer())
EVENT_LIST = RecordingFormat("event list (Timestamp.MRK)", "camera", lambda _: MrkFramer())
FORMATS = (TELEMETRY_LOG, RECEIVER_STREAM, DATAFLASH_LOG, PX4_LOG, EVENT_LIST)


class RecordedBytes:
    """The bytes of a recording, unpacked, with the hash and the size of the file that they come from."""

    def __init__(self, path: Path, raw: BufferedReader) -> None:
        self.path = path
        self.packed = raw.read(2) == _GZIP
        raw.seek(0)
        self._raw = raw
        self.cut = False

    def pieces(self) -> Iterator[bytes]:
        """Yield the bytes from the beginning; a compressed file that ends early sets `cut`.

        raises InputMalformedError: when a compressed file is damaged inside.
        """
        self._raw.seek(0)
        if not self.packed:
            while piece := self._raw.read(PIECE_BYTES):
                yield piece
            return
        with gzip.GzipFile(fileobj=self._raw) as unpacked:
            while True:
                try:
                    # read1 gives what could still be unpacked before the cut.
                    piece = unpacked.read1(PIECE_BYTES)
                except EOFError:
                    self.cut = True
                    return
                except (OSError, zlib.error) as damage:
                    raise InputMalformedError(
                        f"the gzip packing is damaged ({damage})", "take another copy", where=self.path
                    ) from damage
                if not piece:
                    return
                yield piece

    def batches(self, framer: Framer, advance: Callable[[float], None] = lambda _: None) -> Iterator[Batch]:
        """Yield the frames; `advance` takes how much more of the file was read, bytes."""
        done = 0
        for piece in self.pieces():
            yield framer.feed(piece)
            advance(self._raw.tell() - done)
            done = self._raw.tell()
        yield framer.close()

    def sha256(self) -> str:
        """Return the SHA-256 of the file as it lies on disk."""
        self._raw.seek(0)
        return hashlib.file_digest(self._raw, "sha256").hexdigest()


@contextmanager
def open_recording(path: Path) -> Iterator[RecordedBytes]:
    """Open a recording."""
    if path.is_dir():
        raise InputNotFoundError("is a folder, a recording was expected", "name the file", where=path)
    with reading(path):
        raw = path.open("rb")
    with raw:
        head = raw.read(len(MAGIC))
        if not head:
            raise InputNotFoundError("is empty", "name a recording that has data", where=path)
        if head == MAGIC:
            raise InputMalformedError("is a flight log already", "acquire info shows it", where=path)
        raw.seek(0)
        yield RecordedBytes(path, raw)


def identify(source: RecordedBytes, dialect: Dialect) -> RecordingFormat:
    """Tell the format of a recording by what its first part holds."""
    head = bytearray()
    for piece in source.pieces():
        head += piece
        if len(head) >= _HEAD_BYTES:
            break
    del head[_HEAD_BYTES:]
    best, most = None, 0
    for form in FORMATS:
        framer = form.framer(dialect)
        batches = [framer.feed(bytes(head))]
        if len(head) < _HEAD_BYTES:
            batches.append(framer.close())
        held = sum(int(batch.length.sum()) for batch in batches)
        if held > most:
            best, most = form, held
        if 2 * held > len(head):
            break
    if best is None:
        *names, last = (protocol.name for protocol in receiver_protocols())
        raise InputMalformedError(
            f"has no complete MAVLink record, no {', '.join(names)} or {last} frame, no DataFlash, ULog or "
            "MRK record",
            "import a .tlog, .ubx, .rtcm3, .nmea, .bin, .ulg or .mrk recording; give RINEX to photocal ppk",
            where=source.path,
        )
    return best


Definitions = UlogFormats | DataflashFormats
# What decodes an autopilot's own log, what it defines, and what is to be known of its times.
_LOGS: dict[
    RecordingFormat, tuple[Callable[[str, int], Decoder], type[Definitions], Callable[[int], str]]
] = {
    DATAFLASH_LOG: (dataflash_decoder, DataflashFormats, expiry_warning),
    PX4_LOG: (ulog_decoder, UlogFormats, lambda _: ""),
}
HOST_TIME = "host stamps of the recording"

Timed = Iterator[tuple[Batch, Integers]]


def stamped(batches: Iterable[Batch]) -> Timed:
    """Yield batches with the host stamps of their recording."""
    for batch in batches:
        assert batch.host_ns is not None  # noqa: S101
        yield batch, batch.host_ns


def derived(
    batches: Iterable[Batch],
    clock: Callable[[Batch], Integers],
    restart: Callable[[int], None],
    where: object,
) -> Timed:
    """Yield batches with the device's own UTC, since there is no time of receipt.

    clock: gives UTC of the frames of a batch, -1 until it is known.
    restart: lets the clock begin anew with a time that is nearly known.
    """

    def timed() -> Timed:
        """Give each batch with the UTC of its frames, once the first time of the device is known."""
        left, waiting = iter(batches), list[Batch]()
        for batch in left:
            waiting.append(batch)
            device = clock(batch)
            if (device >= 0).any():
                # The date is known now: what came before it can be read again, with the date at hand.
                restart(int(device[device >= 0][0]))
                devices = [clock(earlier) for earlier in waiting]
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
            yield batch, clock(batch)

    return _steadily(timed(), -1)


def since_boot(batches: Iterable[Batch], definitions: Definitions, start_ns: int) -> Timed:
    """Yield batches of an autopilot's own log with the UTC of its records, since there is no receipt."""

    def timed() -> Timed:
        """Give each batch with the times since boot as the records' own definitions state them."""
        for batch in batches:
            definitions.learn(batch)
            yield batch, since_start(definitions.boot_ns(batch), start_ns)

    return _steadily(timed(), start_ns)


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
        return Way(VehicleDecoder(link, dialect).feed, stamped, lambda: HOST_TIME, lambda _: "")
    if form in _LOGS:
        decoder, formats, warned = _LOGS[form]
        boot = boot_time(source.batches(form.framer(dialect)), formats())
        if boot is None:
            raise InputMalformedError(
                "the autopilot's receiver never reported UTC with a 3D fix: its times cannot be placed",
                where=source.path,
                remedy="import a log that was recorded outdoors",
            )
        start_ns, pairs = boot
        time_source = f"running time of the autopilot, tied to UTC by {pairs} times of its GNSS receiver"
        timed = partial(since_boot, definitions=formats(), start_ns=start_ns)
        return Way(decoder(link, start_ns), timed, lambda: time_source, warned)
    if form is EVENT_LIST:
        # Each event tells its whole time.
        told = partial(derived, clock=event_utc_ns, restart=lambda _: None, where=source.path)
        return Way(event_list_decoder(link), told, lambda: _derivation({"event list"}, near_ns))
    clock = ReceiverClock(near_ns)
    told = partial(derived, clock=clock.feed, restart=clock.restart, where=source.path)
    return Way(ReceiverDecoder(link).feed, told, lambda: _derivation(clock.sources, near_ns))


def _derivation(sources: set[str], near_ns: int) -> str:
    # Where the stream tells its date itself, that is what counts.
    dated = sources or near_ns < 0
    text = ", ".join(sorted(sources)) if dated else "time of day or week, the date as it was given"
    return f"derived from the receiver's own time ({text}); no host clock"


def _other_date(near_ns: int, first_ns: int) -> str:
    """Return what to say when a recording states another date than a person; empty without one."""
    # What is given is the noon of a day.
    if near_ns < 0 or abs(first_ns - near_ns) <= 43_200 * SECOND_NS:
        return ""
    day = dt.datetime.fromtimestamp(first_ns // SECOND_NS, dt.UTC).date()
    return f"the recording states its own date, {day.isoformat()}: the one of --date is not used"


CHUNK_BYTES = 1 << 20
_COUNTED = ("frames", "frame_bytes", "stamp_bytes", "damage_bytes", "damage_runs")


@dataclass(frozen=True)
class Imported:
    """What was imported over one link.

    sha256, size: of the file as it lies on disk.
    log_time: where the times of receipt come from.
    cut: bytes of a frame that the end of the recording cut off.
    packing_cut: whether the file is packed and its end is missing.
    warning: what to know about the times; empty when they are sure.
    """

    link: str
    path: Path
    sha256: str
    size: int
    form: RecordingFormat
    log_time: str
    tally: Tally
    cut: int
    packing_cut: bool
    warning: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the figures for programs."""
        return {
            "link": self.link,
            "file": str(self.path),
            **picked(self, "sha256", bytes="size", format="form.name", log_time="log_time"),
            **picked(self.tally, *_COUNTED),
            **picked(self, cut_bytes="cut", packing_cut="packing_cut", warning="warning"),
        }

    def metadata(self) -> dict[str, str]:
        """Return the table that the log keeps."""
        runs = self.tally.damage
        listed = " ".join(f"{offset}+{length}" for offset, length in runs)
        figures = {key: str(value) for key, value in self.as_json().items()}
        # The name is enough: the folder says something about a machine, not about the flight.
        figures["file"] = self.path.name
        figures["damage_at"] = listed + (" ..." if self.tally.damage_runs > len(runs) else "")
        return figures


def import_recordings(
    named: Sequence[tuple[str, Path]],
    unnamed: Sequence[Path],
    output: Path,
    advance: Callable[[float], None],
    near_ns: int = -1,
) -> list[Imported]:
    """Import recordings into one flight log.

    near_ns: UTC within half a day of the beginning of streams that do not tell their date, nanoseconds since
        1970.
    raises InputNotFoundError, InputMalformedError, ConfigurationError, OutputError: see the messages.
    """
    dialect = ardupilotmega()
    results: list[Imported] = []
    links: set[str] = set()
    with output_file(output) as aside, aside.open("wb") as stream:
        writer = LogWriter(stream)
        writer.metadata("software", {"name": "photocal acquire", "version": __version__})
        for name, path in [*named, *(("", path) for path in unnamed)]:
            with open_recording(path) as source:
                form = identify(source, dialect)
                plain = re.sub(r"[^A-Za-z0-9_-]+", "-", path.name.split(".")[0]).strip("-")
                link = name or form.link or plain or "receiver"
                if link in links:
                    raise ConfigurationError(
                        f"two recordings would become the link {link!r}",
                        "name each with --link NAME=FILE",
                        where=path,
                    )
                if any(path.samefile(result.path) for result in results):
                    raise ConfigurationError(
                        "is named twice, as two links", "name the recording of each receiver", where=path
                    )
                links.add(link)
                results.append(_import(writer, link, source, form, dialect, advance, near_ns))
        writer.close()
    return results


def _import(
    writer: LogWriter,
    link: str,
    source: RecordedBytes,
    form: RecordingFormat,
    dialect: Dialect,
    advance: Callable[[float], None],
    near_ns: int,
) -> Imported:
    framer = form.framer(dialect)
    way = way_of(source, form, link, dialect, near_ns)
    log = LinkLog(writer.messages, link, [way.decoder])
    first_ns = near_ns

    for batch, log_ns in way.timed(source.batches(framer, advance)):
        if not log.last_ns and len(log_ns):
            first_ns = int(log_ns[0])
        log.write(batch, log_ns)
        if writer.open_bytes > CHUNK_BYTES:
            writer.end_chunk()
    imported = Imported(
        link=link,
        path=source.path,
        sha256=source.sha256(),
        size=source.path.stat().st_size,
        form=form,
        log_time=way.time_source(),
        tally=log.tally,
        cut=framer.cut,
        packing_cut=source.cut,
        warning=_other_date(near_ns, first_ns) or way.warned(log.last_ns),
    )
    writer.metadata(f"import {link}", imported.metadata())
    return imported

"""The recording itself: one thread per link reads, one writes; the file is safe at least once a second."""

from __future__ import annotations

import contextlib
import datetime as dt
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import BinaryIO

import numpy as np

from acquire import __version__
from acquire.channels.decoded import Decoder
from acquire.channels.receiver import ReceiverDecoder
from acquire.channels.vehicle import VehicleDecoder
from acquire.log.link import LinkLog, Tally
from acquire.log.writer import LogWriter
from acquire.recording.configuration import Configuration
from acquire.recording.reader import Arrival, read_link
from acquire.transports.sources import Source, source_of
from drivers.errors import OutputError
from drivers.frames import Batch, Wire
from drivers.framing import GNSS, StreamFramer
from drivers.mavlink.dialect import Dialect, ardupilotmega

CHUNK_BYTES = 1 << 20
GATHER_S = 0.02


@dataclass(frozen=True)
class Recorded:
    """What was recorded: the file, and frames and damage of each link."""

    path: Path
    tallies: dict[str, Tally]


class _LinkWriter:
    def __init__(self, writer: LogWriter, name: str, wires: tuple[Wire, ...], dialect: Dialect) -> None:
        mavlink = Wire.MAVLINK in wires
        decoder: Decoder = VehicleDecoder(name, dialect) if mavlink else ReceiverDecoder(name)
        self.log = LinkLog(writer, name, [decoder])
        self._framer = StreamFramer(wires, dialect)
        self._received = 0
        # Where in the stream each arrival ended, and when it came: as long as a frame may still end in it.
        self._ends: list[int] = []
        self._times_ns: list[int] = []

    def take(self, arrivals: list[Arrival]) -> None:
        """Frame and write bytes that have arrived; each frame has the time of its last byte."""
        for arrival in arrivals:
            self._received += len(arrival.data)
            self._ends.append(self._received)
            self._times_ns.append(arrival.time_ns)
        self._write(self._framer.feed(b"".join(arrival.data for arrival in arrivals)))

    def close(self) -> None:
        """Write what is left of the stream."""
        if self._ends:
            self._write(self._framer.close())

    def _write(self, batch: Batch) -> None:
        if not batch.data:
            return
        last_bytes = batch.base + batch.start + batch.length - 1
        place = np.searchsorted(np.array(self._ends), last_bytes, side="right")
        self.log.write(batch, np.array(self._times_ns, np.int64)[place])
        done = int(np.searchsorted(np.array(self._ends), batch.base + len(batch.data), side="right"))
        keep = min(done, len(self._ends) - 1)
        del self._ends[:keep], self._times_ns[:keep]


def record(
    configuration: Configuration,
    folder: Path,
    stop: threading.Event,
    tell: Callable[[str], None],
    clock_ns: Callable[[], int] = time.time_ns,
) -> Recorded:
    """Record all links until told to stop.

    Parameters
    ----------
    configuration : Configuration
        Links and site.
    folder : Path
        Where the log goes; it is made.
    stop : Event
        Ends the recording; the log is closed properly.
    tell : callable
        Is told in words what happens to links and file.
    clock_ns : callable
        The clock of the host, UTC nanoseconds since 1970.

    Raises
    ------
    OutputError
        When the log cannot be written (any more); what was written before stays.
    ConfigurationError
        When an address cannot be meant.
    """
    sources = {link.name: source_of(link.url, link.baud) for link in configuration.link}
    path = _new_file(folder, clock_ns())
    tell(f"recording to {path}")
    try:
        with path.open("xb") as stream:
            tallies = _record(configuration, sources, stream, stop, tell, clock_ns)
    except OSError as failure:
        stop.set()
        raise OutputError(
            f"the recording cannot go on ({failure.strerror or failure}), what was written is safe",
            where=path,
            remedy="make room or choose another folder, then acquire recover this file",
        ) from failure
    return Recorded(path, tallies)


def _record(
    configuration: Configuration,
    sources: dict[str, Source],
    stream: BinaryIO,
    stop: threading.Event,
    tell: Callable[[str], None],
    clock_ns: Callable[[], int],
) -> dict[str, Tally]:
    dialect = ardupilotmega()
    writer = LogWriter(stream)
    writer.metadata("software", {"name": "photocal acquire", "version": __version__})
    if configuration.site:
        writer.metadata("site", configuration.site)
    links = {
        link.name: _LinkWriter(
            writer, link.name, (Wire.MAVLINK,) if link.protocol == "mavlink" else GNSS, dialect
        )
        for link in configuration.link
    }
    arrivals: SimpleQueue[Arrival] = SimpleQueue()
    readers = [
        threading.Thread(target=read_link, args=(name, source, arrivals, stop, clock_ns), daemon=True)
        for name, source in sources.items()
    ]
    for reader in readers:
        reader.start()
    try:
        _write(links, writer, stream, arrivals, stop, tell, configuration.recording.flush_s)
        for reader in readers:
            reader.join()
        # What arrived between the order to stop and the end of the readers belongs to the flight, too.
        _take(links, _waiting(arrivals), tell)
        for link in links.values():
            link.close()
        writer.close()
        _make_safe(stream)
    finally:
        stop.set()
        for reader in readers:
            reader.join()
    return {name: link.log.tally for name, link in links.items()}


def _write(
    links: dict[str, _LinkWriter],
    writer: LogWriter,
    stream: BinaryIO,
    arrivals: SimpleQueue[Arrival],
    stop: threading.Event,
    tell: Callable[[str], None],
    flush_s: float,
) -> None:
    safe_at = time.monotonic() + flush_s
    while not stop.is_set():
        # Many small arrivals are framed together: that is what makes high rates cheap.
        stop.wait(GATHER_S)
        _take(links, _waiting(arrivals), tell)
        if writer.open_bytes > CHUNK_BYTES:
            writer.end_chunk()
        if time.monotonic() >= safe_at:
            writer.end_chunk()
            _make_safe(stream)
            safe_at = time.monotonic() + flush_s


def _waiting(arrivals: SimpleQueue[Arrival]) -> list[Arrival]:
    found: list[Arrival] = []
    with contextlib.suppress(Empty):
        while True:
            found.append(arrivals.get_nowait())
    return found


def _take(links: dict[str, _LinkWriter], arrivals: list[Arrival], tell: Callable[[str], None]) -> None:
    by_link: dict[str, list[Arrival]] = {}
    for arrival in arrivals:
        if arrival.event:
            tell(f"{arrival.link} {arrival.event}")
        else:
            by_link.setdefault(arrival.link, []).append(arrival)
    for name, group in by_link.items():
        links[name].take(group)


def _make_safe(stream: BinaryIO) -> None:
    stream.flush()
    os.fsync(stream.fileno())


def _new_file(folder: Path, time_ns: int) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as failure:
        raise OutputError(
            f"cannot be made ({failure.strerror or failure})", where=folder, remedy="choose another folder"
        ) from failure
    moment = dt.datetime.fromtimestamp(time_ns / 1e9, dt.UTC).strftime("%Y%m%dT%H%M%SZ")
    path = folder / f"flight-{moment}.mcap"
    number = 1
    while path.exists():
        number += 1
        path = folder / f"flight-{moment}-{number}.mcap"
    return path

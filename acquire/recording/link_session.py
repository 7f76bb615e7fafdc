"""One link while it is recorded: its frames go to the log, its corrections to others, its device is heard."""

import time
from collections.abc import Callable

import numpy as np

from acquire.channels.decoded import Decoded, Decoder
from acquire.channels.link import LinkLog, WriteMessages, arrived_channel
from acquire.channels.receiver import ReceiverDecoder
from acquire.channels.vehicle import VehicleDecoder
from acquire.log.chunk import ARRIVED_HEAD, Channel
from acquire.recording.alarms import Alarm
from acquire.recording.caster_position import CasterPosition
from acquire.recording.configuration import LinkConfiguration, RecordingConfiguration
from acquire.recording.device_line import MOST_FRAMES, DeviceLine
from acquire.recording.reader import Arrival
from acquire.transports.sources import Source
from drivers.frames import Batch, StreamFramer, Wire
from drivers.mavlink.dialect import Dialect
from drivers.protocols import wires_of
from photocal.base.arrays import Integers
from photocal.base.console import printable


def link_sessions(
    configuration: RecordingConfiguration,
    write: WriteMessages,
    sources: dict[str, Source],
    positions: dict[str, CasterPosition],
    dialect: Dialect,
    clock_ns: Callable[[], int] = time.time_ns,
    steady_s: Callable[[], float] = time.monotonic,
) -> "dict[str, LinkSession]":
    """Return the sessions of all links, with the ways of corrections and positions between them."""
    sessions = {
        link.name: LinkSession(
            link,
            write,
            sources[link.name],
            dialect,
            DeviceLine(link, sources[link.name], dialect, clock_ns, steady_s),
        )
        for link in configuration.link
    }
    for link in configuration.link:
        sessions[link.name].listeners = [sessions[name].device for name in link.corrections_to]
        sessions[link.name].device.position = positions.get(link.name)
        if link.position_from is not None:
            sessions[link.position_from].device.asked_for_position.append(positions[link.name])
    return sessions


def decoder_of(link: LinkConfiguration, dialect: Dialect, tell: Callable[[str], None]) -> Decoder:
    """Return what decodes the frames of a link: whatever it stumbles over, the frames themselves are kept.

    tell: takes its failures in words.
    """
    vehicle = link.protocol == "mavlink"
    decode = VehicleDecoder(link.name, dialect).feed if vehicle else ReceiverDecoder(link.name).feed

    def shielded(batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Decode a batch, or nothing of it."""
        try:
            return decode(batch, log_ns)
        except Exception as failure:
            tell(printable(f"{type(failure).__name__}: {failure}"))
            return log_ns, []

    return shielded


class LinkSession:
    """A link.

    device: the way to its device.
    """

    def __init__(
        self,
        link: LinkConfiguration,
        write: WriteMessages,
        source: Source,
        dialect: Dialect,
        device: DeviceLine,
    ) -> None:
        self.name = link.name
        self.device = device
        # The failures of the decoder; the first one is reported.
        self._failures: list[str] = []
        self._failed = False
        self.log = LinkLog(write, link.name, [decoder_of(link, dialect, self._failures.append)])
        self.listeners: list[DeviceLine] = []
        self._write_messages = write
        self._source = source
        self._encoding = link.protocol
        self._framer = StreamFramer(wires_of(link.protocol), dialect)
        self._sent = 0
        self._received = self._kept = 0
        # Where in the stream each arrival ended, when it came and from whom: while a frame may end in it.
        self._ends: list[int] = []
        self._heads: list[tuple[int, str]] = []

    def take(self, arrivals: list[Arrival]) -> Batch:
        """Frame and write bytes that have arrived; each frame has the time of its last byte."""
        for arrival in arrivals:
            self._received += len(arrival.data)
            self._ends.append(self._received)
            self._heads.append((arrival.time_ns, arrival.peer))
        return self._write(self._framer.feed(b"".join(arrival.data for arrival in arrivals)))

    def keep(self, arrivals: list[Arrival]) -> None:
        """Write bytes that wait for being framed as they are: a busy computer must not lose them."""
        if not arrivals:
            return
        framed = self.log.tally.octets
        offset = max(self._kept, framed)
        begun = self._framer.pending[offset - framed :] if offset < self._received else b""
        pieces = [(self._heads[0][0], begun)] if begun else []
        payloads = []
        pieces += [(arrival.time_ns, arrival.data) for arrival in arrivals]
        for _, data in pieces:
            payloads.append(ARRIVED_HEAD.pack(offset, framed) + data)
            offset += len(data)
        times = np.array([time_ns for time_ns, _ in pieces], np.int64)
        channel = arrived_channel(self.name, self._encoding)
        self._write_messages(channel, payloads, times, times, np.arange(len(payloads)))
        self._kept = offset

    def close(self) -> None:
        """Write what is left of the stream."""
        if self._ends:
            self._write(self._framer.close())

    def converse(self, batch: Batch | None, steady_s: float, clock_ns: int) -> list[Alarm]:
        """Let the device and those who listen hear of a batch; write what was sent by now."""
        self.device.hear(batch, steady_s)
        if batch is not None and self.listeners:
            self._forward(batch)
        self.log_sent()
        alarms = self.device.alarms(steady_s)
        if self._failures and not self._failed:
            self._failed = True
            text = f"cannot be decoded, only raw frames are kept: {self._failures[0]}"
            alarms.append(Alarm("device", self.name, text, clock_ns))
        self._failures.clear()
        return alarms

    def log_sent(self) -> None:
        """Write what was sent to the device since the last call."""
        for sent_ns, encoding, frame in self.device.sent():
            time_ns = np.array([sent_ns], np.int64)
            channel = Channel(f"/{self.name}/sent", encoding)
            self._write_messages(channel, [frame], time_ns, time_ns, np.array([self._sent]))
            self._sent += 1

    def _forward(self, batch: Batch) -> None:
        """Pass the corrections of a batch on to those who listen, no more than they can hold."""
        rows = np.flatnonzero(batch.wire == Wire.RTCM3)
        for listener in self.listeners:
            listener.skipped += max(0, len(rows) - MOST_FRAMES)
        for row in rows[-MOST_FRAMES:].tolist():
            frame = batch.frame(row)
            for listener in self.listeners:
                listener.correct(frame.kind, frame.data)

    def _write(self, batch: Batch) -> Batch:
        if batch.data:
            last_bytes = batch.base + batch.start + batch.length - 1
            place = np.searchsorted(np.array(self._ends), last_bytes, side="right")
            self.log.write(batch, np.array([time_ns for time_ns, _ in self._heads], np.int64)[place])
            if len(place):
                # Anybody may send a byte; who sends whole frames is the device.
                self._source.heed(self._heads[int(place[-1])][1])
            done = int(np.searchsorted(np.array(self._ends), batch.base + len(batch.data), side="right"))
            keep = min(done, len(self._ends) - 1)
            del self._ends[:keep], self._heads[:keep]
        return batch

"""One link while it is recorded: its frames to the log, its corrections to others, its device spoken to."""

import contextlib

import numpy as np

from acquire.channels.decoded import Decoded, Decoder
from acquire.channels.link import LinkLog, MessageWriter, arrived_channel
from acquire.channels.mounting import NAMES
from acquire.channels.receiver import ReceiverDecoder
from acquire.channels.vehicle import VehicleDecoder
from acquire.log.records import ARRIVED_HEAD, Channel
from acquire.recording.alarms import Alarm
from acquire.recording.caster_position import CasterPosition
from acquire.recording.configuration import Configuration, Link
from acquire.recording.reader import Arrival
from acquire.recording.receiver_dialogue import ReceiverDialogue
from acquire.recording.vehicle_dialogue import VehicleDialogue
from acquire.transports.sources import LinkLostError, Source
from drivers.frames import Batch, StreamFramer, Wire
from drivers.mavlink.dialect import Dialect
from drivers.protocols import wires_of
from photocal.base.arrays import Integers
from photocal.base.console import printable
from photocal.base.errors import ConfigurationError


def link_sessions(
    configuration: Configuration,
    writer: MessageWriter,
    sources: dict[str, Source],
    positions: dict[str, CasterPosition],
    dialect: Dialect,
) -> "dict[str, LinkSession]":
    """Return the sessions of all links, with the ways of corrections and positions between them."""
    sessions = {
        link.name: LinkSession(link, writer, sources[link.name], dialect) for link in configuration.link
    }
    for link in configuration.link:
        sessions[link.name].listeners = [sessions[name] for name in link.corrections_to]
        sessions[link.name].position = positions.get(link.name)
        if link.position_from is not None:
            sessions[link.position_from].asked_for_position.append(positions[link.name])
    return sessions


class ShieldedDecoder:
    """Decodes as long as the decoder does: whatever it stumbles over, the frames themselves are kept.

    `failure` tells its first failure in words, until it is taken away.
    """

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self._failed = False
        self.failure = ""

    def feed(self, batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Decode a batch, see `Decoder`."""
        try:
            return self._decoder.feed(batch, log_ns)
        except Exception as failure:
            if not self._failed:
                self.failure = printable(f"{type(failure).__name__}: {failure}")
            self._failed = True
            return log_ns, []


def decoder_of(link: Link, dialect: Dialect) -> ShieldedDecoder:
    """Return what decodes the frames of a link."""
    if link.protocol == "mavlink":
        return ShieldedDecoder(VehicleDecoder(link.name, dialect))
    return ShieldedDecoder(ReceiverDecoder(link.name))


class LinkSession:
    """A link."""

    def __init__(self, link: Link, writer: MessageWriter, source: Source, dialect: Dialect) -> None:
        self.name = link.name
        self._decoder = decoder_of(link, dialect)
        self.log = LinkLog(writer, link.name, [self._decoder])
        self.listeners: list[LinkSession] = []
        # Where this link's device is told to be, and who wants to know where this link's device is.
        self.position: CasterPosition | None = None
        self.asked_for_position: list[CasterPosition] = []
        self._writer = writer
        self._source = source
        self._encoding = link.protocol
        self._framer = StreamFramer(wires_of(link.protocol), dialect)
        self._dialogue: VehicleDialogue | ReceiverDialogue | None = None
        self._vehicle: VehicleDialogue | None = None
        self._sent = 0
        self._received = self._kept = 0
        # Where in the stream each arrival ended, and when it came: as long as a frame may still end in it.
        self._ends: list[int] = []
        self._times_ns: list[int] = []
        if link.protocol == "mavlink":
            self._speak_to_vehicle(link, dialect)
        elif link.ublox is not None:
            wanted = link.ublox
            self._dialogue = ReceiverDialogue(wanted.port, wanted.messages, wanted.rate_ms)

    def _speak_to_vehicle(self, link: Link, dialect: Dialect) -> None:
        rates = link.vehicle.rates_hz if link.vehicle else {}
        for name in rates:
            try:
                dialect.number(name)
            except KeyError as unknown:
                raise ConfigurationError(
                    f"{name} is no MAVLink message",
                    where=f"link {link.name}, vehicle.rates_hz",
                    remedy="check it",
                ) from unknown
        asked = NAMES if link.vehicle and link.vehicle.parameters else ()
        timesync_s = link.vehicle.timesync_s if link.vehicle else 0.0
        self._vehicle = VehicleDialogue(dialect, rates, timesync_s, asked)
        self._dialogue = self._vehicle if link.vehicle else None

    def take(self, arrivals: list[Arrival]) -> Batch:
        """Frame and write bytes that have arrived; each frame has the time of its last byte."""
        for arrival in arrivals:
            self._received += len(arrival.data)
            self._ends.append(self._received)
            self._times_ns.append(arrival.time_ns)
        return self._write(self._framer.feed(b"".join(arrival.data for arrival in arrivals)))

    def keep(self, arrivals: list[Arrival]) -> None:
        """Write bytes that wait for being framed as they are: a busy computer must not lose them."""
        if not arrivals:
            return
        framed = self.log.tally.octets
        offset = max(self._kept, framed)
        begun = self._framer.pending[offset - framed :] if offset < self._received else b""
        pieces = [(self._times_ns[0], begun)] if begun else []
        payloads = []
        pieces += [(arrival.time_ns, arrival.data) for arrival in arrivals]
        for _, data in pieces:
            payloads.append(ARRIVED_HEAD.pack(offset, framed) + data)
            offset += len(data)
        times = np.array([time_ns for time_ns, _ in pieces], np.int64)
        channel = arrived_channel(self.name, self._encoding)
        self._writer.messages(channel, payloads, times, times, np.arange(len(payloads)))
        self._kept = offset

    def close(self) -> None:
        """Write what is left of the stream."""
        if self._ends:
            self._write(self._framer.close())

    def converse(self, batch: Batch | None, steady_s: float, clock_ns: int) -> list[Alarm]:
        """Go on with the conversation with the device."""
        if batch is not None:
            for position in self.asked_for_position:
                position.hear(batch)
        if self.position is not None:
            self.send(self.position.due(steady_s, clock_ns), clock_ns, "nmea")
        alarms = []
        if failure := self._decoder.failure:
            self._decoder.failure = ""
            alarms.append(
                Alarm("device", self.name, f"cannot be decoded, it is kept raw: {failure}", clock_ns)
            )
        if self._dialogue is None:
            return alarms
        turn = self._dialogue.step(batch, steady_s, clock_ns)
        self.send(turn.frames, clock_ns)
        alarms += [Alarm("note", self.name, text, clock_ns) for text in turn.notes]
        return alarms + [Alarm("device", self.name, text, clock_ns) for text in turn.alarms]

    def forward(self, batch: Batch, clock_ns: int) -> list[Alarm]:
        """Pass the corrections of a batch on to those who listen."""
        alarms = []
        if self.listeners:
            for row in np.flatnonzero(batch.wire == Wire.RTCM3).tolist():
                kind, frame = batch.frame(row).kind, batch.frame(row).data
                for listener in self.listeners:
                    alarms += listener.receive_correction(kind, frame, clock_ns)
        return alarms

    def receive_correction(self, kind: int, frame: bytes, clock_ns: int) -> list[Alarm]:
        """Send a correction to the device of this link."""
        if self._vehicle is None:
            self.send((frame,), clock_ns, "rtcm3")
            return []
        frames, words = self._vehicle.carry(kind, frame)
        self.send(tuple(frames), clock_ns)
        return [Alarm("device", self.name, words, clock_ns)] if words else []

    def send(self, frames: tuple[bytes, ...], clock_ns: int, encoding: str = "") -> None:
        """Send frames to the device and write them to the log as sent."""
        if not frames:
            return
        # A port that is gone is told by who reads it.
        with contextlib.suppress(LinkLostError):
            for frame in frames:
                self._source.write(frame)
            times = np.full(len(frames), clock_ns, np.int64)
            numbers = self._sent + np.arange(len(frames))
            channel = Channel(f"/{self.name}/sent", encoding or self._encoding)
            self._writer.messages(channel, frames, times, times, numbers)
            self._sent += len(frames)

    def _write(self, batch: Batch) -> Batch:
        if batch.data:
            last_bytes = batch.base + batch.start + batch.length - 1
            place = np.searchsorted(np.array(self._ends), last_bytes, side="right")
            self.log.write(batch, np.array(self._times_ns, np.int64)[place])
            done = int(np.searchsorted(np.array(self._ends), batch.base + len(batch.data), side="right"))
            keep = min(done, len(self._ends) - 1)
            del self._ends[:keep], self._times_ns[:keep]
        return batch

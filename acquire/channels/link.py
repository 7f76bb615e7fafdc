"""The way of one link into the flight log: frames raw first, then what is decoded from them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from acquire.channels.decoded import Decoder
from acquire.log.chunk import ARRIVED_ENCODING, DAMAGE_ENCODING, Channel, Payloads, Pieces
from drivers.frames import Batch, Wire
from photocal.base.arrays import Integers

LISTED_RUNS = 200


def arrived_channel(link: str, protocol: str) -> Channel:
    """Return the channel of what has come over a link and could not be framed in time, see `arrived_head`."""
    return Channel(f"/{link}/arrived", ARRIVED_ENCODING, None, {"protocol": protocol})


@dataclass
class Tally:
    """What has come over a link so far.

    frames, frame_bytes, stamp_bytes, damage_bytes: number and size; stamps are those of the recording format.
    damage: offset in the stream and length of the first `LISTED_RUNS` runs of damage, adjacent ones merged.
    """

    frames: int = 0
    frame_bytes: int = 0
    stamp_bytes: int = 0
    damage_bytes: int = 0
    damage: list[list[int]] = field(default_factory=list)
    damage_runs: int = 0
    _damage_end: int = -1

    @property
    def octets(self) -> int:
        """Number of bytes of the stream that have been framed."""
        return self.frame_bytes + self.stamp_bytes + self.damage_bytes

    def add(self, batch: Batch) -> None:
        """Count the frames and the damage of a batch."""
        self.frames += len(batch)
        self.frame_bytes += int(batch.length.sum())
        for offset, length in batch.damage.tolist():
            self.damage_bytes += length
            continued = self._damage_end == offset
            self._damage_end = offset + length
            if not continued:
                self.damage_runs += 1
            # A stream of nothing but damage must not fill the memory.
            if self.damage_runs > LISTED_RUNS:
                continue
            if continued:
                self.damage[-1][1] += length
            else:
                self.damage.append([offset, length])
        self.stamp_bytes += len(batch.data) - int(batch.length.sum()) - int(batch.damage[:, 1].sum())


# Adds messages of one channel to a log, see `acquire.log.chunk.OpenChunk.messages`.
WriteMessages = Callable[[Channel, Payloads, Integers, Integers, Integers], None]


class LinkLog:
    """Writes the frames of one link, the damage between them and what is decoded to a log.

    The sequence numbers of raw frames and damage count through both in the order of the stream, so the
    stream can be put together again; a decoded message has the number of the frame that it was made from.

    `last_ns` is the time of receipt of the last frame.
    """

    def __init__(self, write: WriteMessages, link: str, decoders: Sequence[Decoder], first: int = 0) -> None:
        self._write = write
        self._link = link
        self._decoders = tuple(decoders)
        self._next = first
        self.last_ns = 0
        self.tally = Tally()

    def write(self, batch: Batch, log_ns: Integers) -> None:
        """Write a batch; `log_ns` (n,): time of receipt of each, UTC, nanoseconds since 1970."""
        self.tally.add(batch)
        numbers, damage = self._numbers(batch)
        publish = log_ns
        decoded = []
        for decoder in self._decoders:
            device_ns, messages = decoder(batch, log_ns)
            publish = np.where(device_ns != log_ns, device_ns, publish)
            decoded.extend(messages)
        for wire in np.flatnonzero(np.bincount(batch.wire)).tolist():
            rows = np.flatnonzero(batch.wire == wire)
            payloads = Pieces(batch.data, batch.start[rows], batch.length[rows])
            channel = Channel(f"/{self._link}/raw", Wire(wire).encoding)
            self._write(channel, payloads, log_ns[rows], publish[rows], numbers[rows])
        if len(damage) and len(log_ns):
            # Damage has the time of the frame before it, at the beginning of a batch of the one after it.
            place = np.searchsorted(batch.start + batch.base, batch.damage[:, 0]) - 1
            self._damage(batch, log_ns[np.maximum(place, 0)], damage)
        elif len(damage):
            self._damage(batch, np.full(len(damage), self.last_ns), damage)
        for part in decoded:
            self._write(part.channel, part.payloads, log_ns[part.index], part.publish_ns, numbers[part.index])
        if len(log_ns):
            self.last_ns = int(log_ns[-1])

    def _damage(self, batch: Batch, times: Integers, numbers: Integers) -> None:
        payloads = [data for _, data in batch.damaged()]
        channel = Channel(f"/{self._link}/damage", DAMAGE_ENCODING)
        self._write(channel, payloads, times, times, numbers)

    def _numbers(self, batch: Batch) -> tuple[Integers, Integers]:
        place = np.concatenate([batch.start + batch.base, batch.damage[:, 0]])
        number = np.empty(len(place), np.int64)
        number[np.argsort(place, kind="stable")] = self._next + np.arange(len(place))
        self._next += len(place)
        return number[: len(batch)], number[len(batch) :]

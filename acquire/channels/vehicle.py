"""Channels decoded from MAVLink: position, attitude, GNSS, exposures, clock and health."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.decoded import Decoded, in_order
from acquire.channels.vehicle_messages import COMMON_TOPICS, MAKERS, SentMessages
from drivers.frames import Batch, Wire
from drivers.mavlink.decode import MavlinkMessages, decode
from drivers.mavlink.dialect import Dialect
from photocal.base.arrays import Integers

# From 2000 on a time of an autopilot is taken for UTC, below for time since boot.
EARLIEST_UTC_NS = 946_684_800 * 1_000_000_000

# Members that tell the time of a message, and their unit in nanoseconds.
_TIMES = {"time_boot_ms": 1_000_000, "time_usec": 1000}


class VehicleDecoder:
    """Decodes the MAVLink frames of one link; a `Decoder`.

    Several systems can speak on one link. The plain topic of a message belongs to the source that sent it
    first; further sources get topics with their numbers.
    """

    def __init__(self, link: str, dialect: Dialect) -> None:
        self._link = link
        self._dialect = dialect
        self._owners: dict[str, tuple[int, int]] = {}
        self._clock_system: int | None = None
        self._boot_utc_ns: int | None = None
        self._made = {dialect.number(name) for name in MAKERS}
        self._system_time = dialect.number("SYSTEM_TIME")

    def feed(self, batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Return the device's time of each frame and the decoded messages."""
        publish = log_ns.copy()
        kinds = sorted(set(batch.kind[(batch.wire == Wire.MAVLINK) & batch.known].tolist()))
        boot = self._boot_offsets(batch)
        decoded: list[Decoded] = []
        for kind in kinds:
            members = self._dialect.layout(kind).names or ()
            timed = next((name for name in _TIMES if name in members), None)
            if timed is None and kind not in self._made:
                continue
            messages = decode(batch, kind, self._dialect)
            if timed is not None:
                device = self._device_ns(messages, timed, boot)
                known = device >= 0
                publish[messages.index[known]] = device[known]
            if kind in self._made:
                decoded.extend(self._decode(kind, messages, log_ns, publish))
        return publish, in_order(decoded)

    def _boot_offsets(self, batch: Batch) -> tuple[Integers, Integers]:
        """Return from which frame on which UTC of boot holds (-1: unknown)."""
        messages = decode(batch, self._system_time, self._dialect)
        utc = _ns(messages.fields["time_unix_usec"], 1000)
        boot = utc - _ns(messages.fields["time_boot_ms"], 1_000_000)
        good = utc > EARLIEST_UTC_NS
        if self._clock_system is None and good.any():
            self._clock_system = int(messages.system[np.argmax(good)])
        good &= messages.system == (-1 if self._clock_system is None else self._clock_system)
        start = -1 if self._boot_utc_ns is None else self._boot_utc_ns
        offsets = np.concatenate([[start], boot[good]]).astype(np.int64)
        self._boot_utc_ns = int(offsets[-1]) if len(offsets) > 1 else self._boot_utc_ns
        return np.concatenate([[-1], messages.index[good]]).astype(np.int64), offsets

    def _device_ns(self, messages: MavlinkMessages, member: str, boot: tuple[Integers, Integers]) -> Integers:
        time = _ns(messages.fields[member], _TIMES[member])
        since, offsets = boot
        offset = offsets[np.searchsorted(since, messages.index, side="right") - 1]
        timed = (messages.system == self._clock_system) & (offset >= 0)
        return np.where(time > EARLIEST_UTC_NS, time, np.where(timed, offset + time, -1))

    def _decode(
        self, kind: int, messages: MavlinkMessages, log_ns: Integers, publish: Integers
    ) -> Iterable[Decoded]:
        senders = messages.system.astype(np.int64) * 256 + messages.component
        for sender in dict.fromkeys(senders.tolist()):
            of_sender = senders == sender
            index = messages.index[of_sender]
            source = divmod(sender, 256)
            name, fields = self._dialect.name(kind), messages.fields[of_sender]
            sent = SentMessages(self._link, name, index, publish[index], source, fields, log_ns[index])
            for make in MAKERS[name]:
                made = make(sent)
                topic = self._topic(made.channel.topic, source)
                yield replace(made, channel=replace(made.channel, topic=topic))

    def _topic(self, topic: str, source: tuple[int, int]) -> str:
        owner = source if topic in COMMON_TOPICS else self._owners.setdefault(topic, source)
        return topic if owner == source else f"{topic}/system-{source[0]}-{source[1]}"


def _ns(values: NDArray[Any], unit_ns: int) -> Integers:
    """Return times in nanoseconds; what no date of ours can be becomes 0."""
    largest = np.uint64(4_102_444_800_000_000_000 // unit_ns)
    wide = values.astype(np.uint64)
    return np.where(wide < largest, wide, 0).astype(np.int64) * unit_ns

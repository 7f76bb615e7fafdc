"""MAVLink payloads to arrays: all messages of one kind at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Bytes, Integers
from drivers.frames import Batch, Wire, gather
from drivers.mavlink.dialect import V2, Dialect


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one kind.

    index (n,): position of each message in the batch.
    system, component: who sent it.
    fields (n,): the fields by the names and in the units of the MAVLink definition; extension fields that
        were not sent are zero, as the standard has it.
    """

    index: Integers
    system: Bytes
    component: Bytes
    fields: NDArray[Any]

    def __len__(self) -> int:
        return len(self.index)


def decode(batch: Batch, message: int, dialect: Dialect) -> Messages:
    """Decode all intact frames of one known message."""
    index = batch.where(Wire.MAVLINK, message)
    start = batch.start[index]
    octets = np.frombuffer(batch.data, np.uint8)
    second = octets[start] == V2
    payload = start + np.where(second, 10, 6)
    fields = gather(batch.data, payload, octets[start + 1].astype(np.int64), dialect.layout(message))
    system, component = sources(batch, index)
    return Messages(index, system, component, fields)


def sources(batch: Batch, index: Integers) -> tuple[Bytes, Bytes]:
    """Return system and component of MAVLink frames."""
    start = batch.start[index]
    octets = np.frombuffer(batch.data, np.uint8)
    second = octets[start] == V2
    return octets[start + np.where(second, 5, 3)], octets[start + np.where(second, 6, 4)]


def sequences(batch: Batch, index: Integers) -> Bytes:
    """Return the sequence numbers of MAVLink frames: each source counts its frames modulo 256."""
    start = batch.start[index]
    octets = np.frombuffer(batch.data, np.uint8)
    return np.asarray(octets[start + np.where(octets[start] == V2, 4, 2)])

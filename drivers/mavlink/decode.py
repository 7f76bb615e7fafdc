"""MAVLink payloads to arrays, all messages of one kind at once, and single messages to frames."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from drivers.checksums import x25
from drivers.frames import Batch, Messages, Wire, gather
from drivers.mavlink.dialect import V2, Dialect
from photocal.base.arrays import Bytes, Integers

FRAGMENT_BYTES, FRAGMENTS = 180, 4
# Of MAV_TYPE and MAV_AUTOPILOT.
GROUND_STATION, NO_AUTOPILOT = 6, 8


def decode(batch: Batch, message: int, dialect: Dialect) -> Messages:
    """Decode all intact frames of one known message; extension fields that were not sent are zero."""
    index = batch.where(Wire.MAVLINK, message)
    start = batch.start[index]
    octets = np.frombuffer(batch.data, np.uint8)
    second = octets[start] == V2
    payload = start + np.where(second, 10, 6)
    fields = gather(batch.data, payload, octets[start + 1].astype(np.int64), dialect.layout(message))
    return Messages(index, fields)


def sources(batch: Batch, index: Integers) -> tuple[Bytes, Bytes]:
    """Return system and component of MAVLink frames."""
    return _octet(batch, index, 3, 5), _octet(batch, index, 4, 6)


def autopilots(batch: Batch, dialect: Dialect) -> list[tuple[int, int]]:
    """Return system and component of those that say by their heartbeats that they are autopilots."""
    beats = decode(batch, dialect.number("HEARTBEAT"), dialect)
    flying = (beats.fields["type"] != GROUND_STATION) & (beats.fields["autopilot"] != NO_AUTOPILOT)
    system, component = sources(batch, beats.index[flying])
    return list(zip(system.tolist(), component.tolist(), strict=True))


def sequences(batch: Batch, index: Integers) -> Bytes:
    """Return the sequence numbers of MAVLink frames: each source counts its frames modulo 256."""
    return _octet(batch, index, 2, 4)


def _octet(batch: Batch, index: Integers, first: int, second: int) -> Bytes:
    """Return a byte of the head of MAVLink frames: its place in the first and in the second version."""
    start, octets = batch.start[index], np.frombuffer(batch.data, np.uint8)
    return np.asarray(octets[start + np.where(octets[start] == V2, second, first)])


def encode(
    dialect: Dialect, message: int, values: Mapping[str, Any], *, sequence: int, system: int, component: int
) -> bytes:
    """Return the MAVLink 2 frame of a message, unsigned and with its trailing zeros left out.

    values: values by field name, in the units of the definition; fields that are missing are zero.
    sequence: number of the frame; taken modulo 256.
    raises KeyError: when a field is not one of the message.
    """
    row = np.zeros(1, dialect.layout(message))
    names = row.dtype.names or ()
    for name, value in values.items():
        if name not in names:
            raise KeyError(name)
        row[name] = value
    # At least one byte of payload is always sent.
    payload = row.tobytes().rstrip(b"\0") or b"\0"
    header = bytes((len(payload), 0, 0, sequence & 0xFF, system, component)) + message.to_bytes(3, "little")
    check = x25(header + payload, dialect.seeds[message])
    return bytes((V2,)) + header + payload + check.to_bytes(2, "little")


def fragments(message: bytes, sequence: int) -> list[dict[str, Any]]:
    """Return the fields of the GPS_RTCM_DATA messages that carry an RTCM message.

    message: A whole RTCM 3 frame.
    """
    if len(message) > FRAGMENT_BYTES * FRAGMENTS:
        return []
    if len(message) <= FRAGMENT_BYTES:
        return [_fields((sequence & 31) << 3, message)]
    pieces = [message[at : at + FRAGMENT_BYTES] for at in range(0, len(message), FRAGMENT_BYTES)]
    if len(pieces[-1]) == FRAGMENT_BYTES and len(pieces) < FRAGMENTS:
        # Only a shorter fragment ends the message before the fourth.
        pieces.append(b"")
    return [_fields((sequence & 31) << 3 | number << 1 | 1, piece) for number, piece in enumerate(pieces)]


def _fields(flags: int, piece: bytes) -> dict[str, Any]:
    data = np.frombuffer(piece.ljust(FRAGMENT_BYTES, b"\0"), np.uint8)
    return {"flags": flags, "len": len(piece), "data": data}

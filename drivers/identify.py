"""Frames that were already cut out of their stream: what they carry."""

import numpy as np

from drivers import mrk, ulog
from drivers.checksums import x25
from drivers.frames import Batch, Wire, batch_of, numbers_at
from drivers.mavlink.dialect import SIGNATURE_BYTES, SIGNED, V2, Dialect
from drivers.protocols import protocol_of

_LONGEST_HEAD, _LEAST_MAVLINK = 16, 8


def batch_of_payloads(wire: Wire, payloads: list[bytes], dialect: Dialect) -> Batch:
    """Return intact frames of one protocol as a batch."""
    length = np.fromiter(map(len, payloads), np.int64, len(payloads))
    # What another program calls a frame may be shorter than the head of one.
    data = b"".join(payloads) + bytes(_LONGEST_HEAD)
    start = np.cumsum(length) - length
    octets = np.frombuffer(data, np.uint8)
    known = np.ones(len(payloads), bool)
    if wire == Wire.MAVLINK:
        second = octets[start] == V2
        long = numbers_at(data, np.where(second, start + 7, start), "<u4") & 0xFFFFFF
        kind = np.where(second, long, octets[start + 5]).astype(np.int64)
        agrees = [_agrees(payload, k, dialect) for payload, k in zip(payloads, kind.tolist(), strict=True)]
        known = np.array(agrees, bool)
    elif wire == Wire.DATAFLASH:
        kind = octets[start + 2].astype(np.int64)
    elif wire == Wire.ULOG:
        kind = np.array(list(map(ulog.kind_of, payloads)), np.int64)
    elif wire == Wire.MRK:
        kind = np.full(len(payloads), mrk.EVENT_KIND)
    else:
        kind = protocol_of(wire).kinds(data, start, length)
    return batch_of(wire, data, 0, (start, length, kind), np.empty((0, 2), np.int64), known)


def _agrees(frame: bytes, kind: int, dialect: Dialect) -> bool:
    seed = dialect.seeds.get(kind)
    if seed is None or len(frame) < _LEAST_MAVLINK:
        return False
    end = len(frame) - 2 - (SIGNATURE_BYTES if frame[0] == V2 and frame[2] & SIGNED else 0)
    return end > 1 and x25(frame[1:end], seed) == frame[end] | frame[end + 1] << 8


def kind_name(wire: Wire, kind: int, known: bool, dialect: Dialect) -> str:
    """Return what the makers of the protocol call a message.

    known: whether the frame agreed with the tables; otherwise its number is given.
    """
    if wire == Wire.MAVLINK:
        return dialect.name(kind) if known else f"unknown {kind}"
    if wire == Wire.DATAFLASH:
        return str(kind)
    if wire == Wire.ULOG:
        return f"{chr(kind >> 16)} {kind & 0xFFFF}" if kind else "head"
    if wire == Wire.MRK:
        return "event"
    return protocol_of(wire).kind_name(kind)

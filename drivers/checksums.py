"""The four checksums of the field protocols, each in the form that is fast on whole buffers."""

from binascii import crc_hqx
from functools import cache

import numpy as np
from numpy.typing import NDArray

# The X.25 checksum of MAVLink is the reflected form of the CRC that `crc_hqx` computes in C: over bytes with
# their bits reversed the latter gives the former with its bits reversed (Ross Williams 1993, "A painless
# guide to CRC error detection algorithms", section 11).
REVERSED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def x25(data: bytes, seed: int | None = None) -> int:
    """Return the X.25 checksum (CRC-16/MCRF4XX) of `data`, continued over the one byte `seed` if given.

    Source: MAVLink developer guide, "Packet serialization", checksum with CRC_EXTRA.
    """
    if seed is not None:
        data = data + bytes((seed,))
    turned = crc_hqx(data.translate(REVERSED), 0xFFFF)
    return REVERSED[turned >> 8] | REVERSED[turned & 0xFF] << 8


def fletcher8(data: bytes) -> bytes:
    """Return the two checksum bytes of UBX (Fletcher's algorithm of RFC 1145 over 8 bits)."""
    values = np.frombuffer(data, np.uint8).astype(np.uint64)
    weights = np.arange(len(values), 0, -1, dtype=np.uint64)
    return bytes((int(values.sum()) & 0xFF, int(values @ weights) & 0xFF))


def crc24q(data: bytes) -> int:
    """Return the CRC-24Q (polynomial 0x1864CFB) of at most 1026 bytes.

    Source: RTCM standard 10403, transport layer; the CRC of Qualcomm. A CRC is linear, so it is the sum
    (modulo 2) of what each byte contributes at its distance from the end.
    """
    values = np.frombuffer(data, np.uint8)
    table = crc24q_contributions()
    return int(np.bitwise_xor.reduce(table[np.arange(len(values) - 1, -1, -1), values], initial=0))


@cache
def crc24q_contributions() -> NDArray[np.uint32]:
    """Return what each value of a byte (column) adds to the CRC-24Q at each distance from the end (row)."""
    base = np.arange(256, dtype=np.uint32) << 16
    for _ in range(8):
        base = np.where(base & 0x800000, (base << 1) ^ 0x1864CFB, base << 1).astype(np.uint32)
    table = np.empty((1026, 256), np.uint32)
    table[0] = base
    for distance in range(1, len(table)):
        before = table[distance - 1]
        table[distance] = ((before << 8) & 0xFFFFFF) ^ base[before >> 16]
    return table

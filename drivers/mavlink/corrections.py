"""RTCM 3 messages in fragments for the vehicle (GPS_RTCM_DATA).

Source: MAVLink common message set, GPS_RTCM_DATA: bit 0 of the flags tells a fragment, bits 1 and 2 its
number, bits 3 to 7 a sequence number; at most four fragments of 180 bytes, a shorter one is the last.
"""

from __future__ import annotations

from typing import Any

import numpy as np

FRAGMENT_BYTES, FRAGMENTS = 180, 4


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

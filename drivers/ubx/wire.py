"""UBX frames on the wire: the test whether an intact one stands at a place."""

from __future__ import annotations

from re import compile as pattern

from drivers.checksums import fletcher8
from drivers.window import NOTHING, Examination, Window, need

STARTS = pattern(rb"\xb5(?:\x62|\Z)")

# The longest message of the interface descriptions is RXM-RAWX with 255 signals, 8176 bytes. Without a bound
# a damaged length would hold back up to 64 kB of good frames.
LONGEST_PAYLOAD = 8192


def examine(window: Window, at: int) -> Examination:
    """Examine one place for a UBX frame, see `drivers.window.Examination`."""
    data = window.data
    if len(data) - at < 6:
        return need(window, 6)
    payload = data[at + 4] | data[at + 5] << 8
    if payload > LONGEST_PAYLOAD:
        return NOTHING
    length = payload + 8
    end = at + length
    if end > len(data):
        return need(window, length)
    if window.fletcher8(at + 2, end - 2) != (data[end - 2], data[end - 1]):
        return NOTHING
    return (length, data[at + 2] << 8 | data[at + 3], True)


def encode(kind: int, payload: bytes) -> bytes:
    """Return the frame of a message.

    Parameters
    ----------
    kind : int
        Class * 256 + id.
    payload : bytes
        The payload.
    """
    body = bytes((kind >> 8, kind & 0xFF)) + len(payload).to_bytes(2, "little") + payload
    return b"\xb5\x62" + body + fletcher8(body)

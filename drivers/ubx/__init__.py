"""u-blox UBX: framing, decoding by numpy views and encoding."""

from drivers.checksums import fletcher8


def encode(kind: int, payload: bytes) -> bytes:
    """Return the frame of a message."""
    body = bytes((kind >> 8, kind & 0xFF)) + len(payload).to_bytes(2, "little") + payload
    return b"\xb5\x62" + body + fletcher8(body)

"""Bit strings, most significant bit first, as navigation messages and RTCM are written."""

from __future__ import annotations

from collections.abc import Iterable


def field(value: int, width: int) -> str:
    """Return the bits of a number, two's complement where it is negative.

    raises OverflowError: when it does not fit.
    """
    if not -(1 << width - 1 if width else 0) <= value < 1 << width:
        raise OverflowError(f"{value} does not fit {width} bits")
    return format(value & (1 << width) - 1, f"0{width}b") if width else ""


def joined(fields: Iterable[tuple[int, int]]) -> str:
    """Return the bits of (value, width) pairs one after another."""
    return "".join(field(value, width) for value, width in fields)


def octets(bits: str) -> bytes:
    """Return whole bytes, the last one filled up with zeros."""
    length = (len(bits) + 7) // 8
    return int(bits.ljust(8 * length, "0"), 2).to_bytes(length, "big") if bits else b""

"""Names of the kinds of frames, for people."""

from __future__ import annotations

from drivers import nmea
from drivers.frames import Wire
from drivers.mavlink.dialect import Dialect
from drivers.ubx.decode import kind_name as ubx_name


def kind_name(wire: Wire, kind: int, known: bool, dialect: Dialect) -> str:
    """Return what the makers of the protocol call a message.

    known: whether the frame agreed with the tables; otherwise its number is given.
    """
    if wire == Wire.MAVLINK:
        return dialect.name(kind) if known else f"unknown {kind}"
    if wire == Wire.UBX:
        return ubx_name(kind)
    if wire == Wire.ULOG:
        return f"{chr(kind >> 16)} {kind & 0xFFFF}" if kind else "head"
    if wire == Wire.MRK:
        return "event"
    return nmea.kind_name(kind) if wire == Wire.NMEA else str(kind)

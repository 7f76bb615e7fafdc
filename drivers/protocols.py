"""The table of the receivers' protocols: ours, and those that installed packages bring.

A protocol is one file with a `ReceiverProtocol` and one entry: here, or in the entry points of a package:

    [project.entry-points."photocal.protocols"]
    toy = "toy_receiver:PROTOCOL"
"""

from functools import cache
from importlib import import_module

from drivers.frames import Wire
from drivers.receiver import ReceiverProtocol
from photocal.base.extensions import PROTOCOLS, brought

# The order is that of trust where several tell a position.
_OURS = ("drivers.ubx.protocol", "drivers.rtcm3", "drivers.nmea")


@cache
def receiver_protocols() -> tuple[ReceiverProtocol, ...]:
    """Return the protocols of receivers.

    raises ConfigurationError: when the protocol of an installed package cannot be loaded.
    """
    ours: list[ReceiverProtocol] = [import_module(name).PROTOCOL for name in _OURS]
    return (*ours, *brought(PROTOCOLS, ReceiverProtocol).values())


def receiver_wires() -> tuple[Wire, ...]:
    """Return the protocols that may share the line of a receiver."""
    return tuple(protocol.wire for protocol in receiver_protocols())


def wires_of(protocol: str) -> tuple[Wire, ...]:
    """Return the protocols that are looked for on a link of one: those of receivers may share a line."""
    return (Wire.MAVLINK,) if protocol == Wire.MAVLINK.encoding else receiver_wires()


def link_protocols() -> tuple[str, ...]:
    """Return the names that a link of a recording may have for its protocol."""
    return (Wire.MAVLINK.encoding, *(wire.encoding for wire in receiver_wires()))


@cache
def protocol_of(wire: Wire) -> ReceiverProtocol:
    """Return the protocol of a receiver by its frames."""
    return next(protocol for protocol in receiver_protocols() if protocol.wire == wire)


def known_wire(encoding: str) -> Wire | None:
    """Return the protocol of an encoding of the flight log; None of one that nobody here knows."""
    known = Wire.known(encoding)
    if known is not None:
        return known
    return next((wire for wire in receiver_wires() if wire.encoding == encoding), None)

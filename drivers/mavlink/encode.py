"""MAVLink frames from the values of their fields."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.checksums import x25
from drivers.mavlink.dialect import V2, Dialect


def encode(
    dialect: Dialect,
    message: int,
    values: dict[str, Any],
    *,
    sequence: int,
    system: int,
    component: int,
) -> bytes:
    """Return the MAVLink 2 frame of a message, unsigned and with its trailing zeros left out.

    values: values by field name, in the units of the definition; fields that are missing are zero.
    sequence: number of the frame; taken modulo 256.

    Raises
    ------
    KeyError
        When a field is not one of the message.
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

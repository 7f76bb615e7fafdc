"""The tables of MAVLink messages: names, checksum seeds and layouts, from pymavlink's dialect."""

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

# Start bytes of both versions; of the second, the flag of a signature and its length.
V1, V2, SIGNED, SIGNATURE_BYTES = 0xFE, 0xFD, 0x01, 13
_TYPES = {
    "char": "S1",
    "uint8_t": "u1",
    "int8_t": "i1",
    "uint16_t": "<u2",
    "int16_t": "<i2",
    "uint32_t": "<u4",
    "int32_t": "<i4",
    "uint64_t": "<u8",
    "int64_t": "<i8",
    "float": "<f4",
    "double": "<f8",
}


@dataclass(frozen=True, eq=False)
class Dialect:
    """The messages that are known by their definition.

    seeds: checksum seed (CRC_EXTRA) by message id.
    """

    seeds: dict[int, int]
    _classes: dict[int, Any]
    _layouts: dict[int, np.dtype[Any]] = field(default_factory=dict)

    def name(self, message: int) -> str:
        """Return the name of a message id, or the number where it is not known."""
        known = self._classes.get(message)
        return str(known.msgname) if known else str(message)

    def number(self, name: str) -> int:
        """Return the message id of a name; raises KeyError when the dialect has no such message."""
        for message, known in self._classes.items():
            if known.msgname == name:
                return message
        raise KeyError(name)

    def layout(self, message: int) -> np.dtype[Any]:
        """Return the layout of a payload on the wire, with all extension fields."""
        if message not in self._layouts:
            known = self._classes[message]
            self._layouts[message] = np.dtype([_member(known, name) for name in known.ordered_fieldnames])
        return self._layouts[message]


def _member(known: Any, name: str) -> tuple[Any, ...]:
    kind = known.fieldtypes[known.fieldnames.index(name)]
    count = known.array_lengths[known.ordered_fieldnames.index(name)]
    if kind == "char":
        return (name, f"S{max(count, 1)}")
    return (name, _TYPES[kind], (count,)) if count else (name, _TYPES[kind])


@cache
def ardupilotmega() -> Dialect:
    """Return the dialect of ArduPilot, which contains the common messages that PX4 sends."""
    from pymavlink.dialects.v20 import ardupilotmega as tables

    classes = dict(tables.mavlink_map)
    return Dialect({message: int(known.crc_extra) for message, known in classes.items()}, classes)

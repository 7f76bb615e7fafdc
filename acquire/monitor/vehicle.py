"""What a pilot looks at first: the mode of the flight and the height above the take-off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from acquire.log.reader import Messages

_HEARTBEAT, _POSITION = 0, 33
_GROUND_STATION, _NO_AUTOPILOT, _ARMED = 6, 8, 0x80
_V2 = 0xFD


@dataclass(frozen=True)
class Vehicle:
    """The last that an autopilot told.

    mode: its mode of flight, as ground stations call it; empty before it was told.
    armed: whether its motors may turn.
    height_m: above the take-off.
    time_ns: when it told its mode last, UTC.
    """

    mode: str = ""
    armed: bool = False
    height_m: float | None = None
    time_ns: int = 0


def vehicle_after(vehicle: Vehicle | None, part: Messages) -> Vehicle | None:
    """Return the vehicle after frames of its link: of each message the last one counts."""
    wanted = {_HEARTBEAT, _POSITION}
    for payload, time_ns in zip(reversed(part.payloads), part.log_ns[::-1].tolist(), strict=True):
        kind = int.from_bytes(payload[7:10], "little") if payload[0] == _V2 else payload[5]
        message = _decoded(payload) if kind in wanted else None
        if message is None or (kind == _HEARTBEAT and not _of_autopilot(message)):
            continue
        wanted.discard(kind)
        vehicle = vehicle or Vehicle()
        if kind == _POSITION:
            vehicle = replace(vehicle, height_m=message.relative_alt * 1e-3)
        else:
            from pymavlink import mavutil

            mode, armed = str(mavutil.mode_string_v10(message)), bool(message.base_mode & _ARMED)
            if mode.startswith("Mode("):
                # A number that ground stations have no name for.
                mode = f"mode {message.custom_mode}"
            vehicle = replace(vehicle, mode=mode, armed=armed, time_ns=time_ns)
        if not wanted:
            break
    return vehicle


def _of_autopilot(message: Any) -> bool:
    return bool(message.type != _GROUND_STATION and message.autopilot != _NO_AUTOPILOT)


def _decoded(payload: bytes) -> Any:
    tables = _tables()
    try:
        return tables.MAVLink(None).decode(bytearray(payload))
    except (tables.MAVError, TypeError, ValueError):
        return None


@cache
def _tables() -> Any:
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega

"""A simulated autopilot: heartbeat, message rates, time synchronisation, parameters, camera feedback.

It reads and writes with pymavlink, so that what we send is judged by another program than our own.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

SET_MESSAGE_INTERVAL, DIGICAM_CONTROL = 511, 203
ACCEPTED, FAILED, UNSUPPORTED = 0, 4, 3
PARAMETERS = {"SYSID_THISMAV": 1.0, "CAM1_TYPE": 1.0, "GPS_TYPE": 1.0}
_HEARTBEAT_S = 1.0
_QUADROTOR, _ARDUPILOT, _STANDBY = 2, 3, 3
_FRAGMENT_BYTES = 180


class Autopilot:
    """The state of the vehicle's side of a link."""

    def __init__(
        self,
        start_utc_us: int,
        *,
        stubborn: bool = False,
        system: int = 1,
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        from pymavlink.dialects.v20 import ardupilotmega as tables

        self._tables: Any = tables
        self._mav = tables.MAVLink(None, srcSystem=system, srcComponent=1)
        self._mav.robust_parsing = True
        self._start_us = start_utc_us
        self._stubborn = stubborn
        self._heartbeat_due_s = 0.0
        self._due_s: dict[int, float] = {}
        self._shots = 0
        self._parameters = {**PARAMETERS, **(parameters or {})}
        self._fragments: dict[int, bytes] = {}
        self.interval_s: dict[int, float] = {}
        self.corrections: list[bytes] = []
        self.heard: list[tuple[str, int, int]] = []

    def due(self, time_s: float) -> bytes:
        """Return what is sent of its own accord up to a moment, seconds after the start."""
        out = b""
        if time_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = time_s + _HEARTBEAT_S
            out += self._pack(
                self._tables.MAVLink_heartbeat_message(_QUADROTOR, _ARDUPILOT, 0, 0, _STANDBY, 3)
            )
        for message, interval in self.interval_s.items():
            if time_s >= self._due_s[message]:
                self._due_s[message] = time_s + interval
                out += self._pack(self._makers()[message](time_s))
        return out

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes of the ground station; return the answers."""
        out = b""
        for message in self._mav.parse_buffer(data) or []:
            self.heard.append((message.get_type(), message.get_srcSystem(), message.get_srcComponent()))
            answer = getattr(self, "_" + message.get_type().lower(), None)
            if answer is not None:
                out += b"".join(self._pack(reply) for reply in answer(message, time_s))
        return out

    def trigger(self, time_s: float) -> bytes:
        """Take a picture; return its feedback."""
        return self._pack(self._picture(time_s))

    def _picture(self, time_s: float) -> Any:
        self._shots += 1
        return self._tables.MAVLink_camera_feedback_message(
            self._start_us + round(time_s * 1e6), 1, 0, self._shots,
            475000000, 85000000, 510.0, 80.0, 0.0, 0.0, 0.0, 0.0, 0, self._shots,
        )  # fmt: skip

    def _command_long(self, message: Any, time_s: float) -> list[Any]:
        acknowledge = self._tables.MAVLink_command_ack_message
        if message.command == SET_MESSAGE_INTERVAL:
            wanted = int(message.param1)
            if self._stubborn or wanted not in self._offered():
                return [acknowledge(message.command, FAILED)]
            self.interval_s[wanted] = message.param2 / 1e6
            self._due_s[wanted] = time_s
            return [acknowledge(message.command, ACCEPTED)]
        if message.command == DIGICAM_CONTROL:
            return [acknowledge(message.command, ACCEPTED), self._picture(time_s)]
        return [acknowledge(message.command, UNSUPPORTED)]

    def _timesync(self, message: Any, time_s: float) -> list[Any]:
        if message.tc1 != 0:
            return []
        return [self._tables.MAVLink_timesync_message(self._boot_ns(time_s), message.ts1)]

    def _boot_ns(self, time_s: float) -> int:
        """Give its own clock; never 0, which would be a question."""
        return round(time_s * 1e9) + 1

    def _param_request_list(self, _message: Any, _time_s: float) -> list[Any]:
        return [self._parameter(name) for name in self._parameters]

    def _param_request_read(self, message: Any, _time_s: float) -> list[Any]:
        names = list(self._parameters)
        name = message.param_id if message.param_index < 0 else names[message.param_index]
        return [self._parameter(name)] if name in self._parameters else []

    def _parameter(self, name: str) -> Any:
        place = list(self._parameters).index(name)
        return self._tables.MAVLink_param_value_message(
            name.encode(), self._parameters[name], 9, len(self._parameters), place
        )

    def _gps_rtcm_data(self, message: Any, _time_s: float) -> list[Any]:
        """Put fragments together as the definition of GPS_RTCM_DATA says."""
        data = bytes(message.data[: message.len])
        if not message.flags & 1:
            self.corrections.append(data)
            return []
        number = message.flags >> 1 & 3
        if number == 0:
            self._fragments.clear()
        self._fragments[number] = data
        if len(data) < _FRAGMENT_BYTES or number == 3:
            if sorted(self._fragments) == list(range(number + 1)):
                self.corrections.append(b"".join(self._fragments[n] for n in range(number + 1)))
            self._fragments.clear()
        return []

    def _offered(self) -> Collection[int]:
        """Give the messages that it can send."""
        return self._makers().keys()

    def _makers(self) -> dict[int, Callable[[float], Any]]:
        tables = self._tables
        return {
            tables.MAVLINK_MSG_ID_SYSTEM_TIME: lambda t: tables.MAVLink_system_time_message(
                self._start_us + round(t * 1e6), round(t * 1e3)
            ),
            tables.MAVLINK_MSG_ID_ATTITUDE: lambda t: tables.MAVLink_attitude_message(
                round(t * 1e3), 0.01, 0.02, 0.5, 0.0, 0.0, 0.0
            ),
            tables.MAVLINK_MSG_ID_GPS_RAW_INT: lambda t: tables.MAVLink_gps_raw_int_message(
                round(t * 1e6), 6, 475000000, 85000000, 510000, 80, 120, 0, 0, 17
            ),
            tables.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: lambda t: tables.MAVLink_global_position_int_message(
                round(t * 1e3), 475000000, 85000000, 510000, 80000, 0, 0, 0, 0
            ),
        }

    def _pack(self, message: Any) -> bytes:
        packed = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

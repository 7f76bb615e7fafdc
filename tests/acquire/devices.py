"""Devices that fly by themselves and have the faults that a recorder must bear."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from acquire.simulate import playback
from acquire.simulate.playback import ACCEPTED, FlightClock, acknowledged, ubx_message
from acquire.simulate.world.streams import RecordedWire

DIGICAM_CONTROL = 203
VERSIONS = {
    7: ("1.00 (59842)", "00070000", ("PROTVER 14.00",)),
    8: ("EXT CORE 3.01 (111141)", "00080000", ("FWVER=HPG 1.43", "PROTVER=20.30", "MOD=NEO-M8P-2")),
    9: playback.FlownReceiver.version,
}
_PVT_EVERY_S = 0.2
# They send nothing that was recorded: their flight never begins.
NOTHING, NEVER = RecordedWire(np.empty(0), ()), FlightClock(["nobody"], 1.0)
_FRAGMENT_BYTES = 180


class Autopilot(playback.FlownAutopilot):
    """An autopilot that sends its own messages, takes pictures and corrections, and may refuse rates."""

    def __init__(
        self, start_utc_us: int, *, stubborn: bool = False, parameters: Mapping[str, float] | None = None
    ) -> None:
        super().__init__("vehicle", NOTHING, NEVER, parameters=parameters)
        self._start_us = start_utc_us
        self._stubborn = stubborn
        self._due_s: dict[int, float] = {}
        self._shots = 0
        self._fragments: dict[int, bytes] = {}
        self.corrections: list[bytes] = []
        self.heard: list[tuple[str, int, int]] = []

    def due(self, time_s: float) -> bytes:
        out = super().due(time_s)
        for message, interval in self.interval_s.items():
            if time_s >= self._due_s.get(message, 0.0):
                self._due_s[message] = time_s + interval
                out += self._pack(self._makers()[message](time_s))
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

    def _answer(self, message: Any, time_s: float) -> list[Any]:
        self.heard.append((message.get_type(), message.get_srcSystem(), message.get_srcComponent()))
        if message.get_type() == "GPS_RTCM_DATA":
            self._carry(bytes(message.data[: message.len]), message.flags)
        if message.get_type() == "COMMAND_LONG" and message.command == DIGICAM_CONTROL:
            done = self._tables.MAVLink_command_ack_message(message.command, ACCEPTED)
            return [done, self._picture(time_s)]
        return super()._answer(message, time_s)

    def _carry(self, data: bytes, flags: int) -> None:
        """Put fragments together as the definition of GPS_RTCM_DATA says."""
        if not flags & 1:
            self.corrections.append(data)
            return
        number = flags >> 1 & 3
        if number == 0:
            self._fragments.clear()
        self._fragments[number] = data
        if len(data) < _FRAGMENT_BYTES or number == 3:
            if sorted(self._fragments) == list(range(number + 1)):
                self.corrections.append(b"".join(self._fragments[n] for n in range(number + 1)))
            self._fragments.clear()

    def _boot_ns(self, time_s: float) -> int:
        return round(time_s * 1e9) + 1

    def _offered(self) -> Collection[int]:
        return () if self._stubborn else self._makers().keys()

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


class Receiver(playback.FlownReceiver):
    """A receiver of generation 7, 8 or 9 that measures, and may refuse or forget what it is told."""

    def __init__(self, generation: int, *, refuses: bool = False, forgets: bool = False) -> None:
        super().__init__("rover", NOTHING, NEVER)
        self.version = VERSIONS[generation]
        self._generation = generation
        self._refuses, self._forgets = refuses, forgets
        self._pvt_due_s = 0.0
        self.rates: dict[tuple[int, int], int] = {}
        self.measurement_ms = 1000

    def due(self, time_s: float) -> bytes:
        """Return what is sent of its own accord up to a moment, seconds after the start."""
        from pyubx2 import GET, UBXMessage

        if time_s < self._pvt_due_s:
            return b""
        self._pvt_due_s = time_s + _PVT_EVERY_S
        pvt = UBXMessage(
            "NAV", "NAV-PVT", GET, year=2026, month=5, day=1, hour=9, second=round(time_s) % 60, validDate=1,
            validTime=1, fullyResolved=1, fixType=3, gnssFixOk=1, carrSoln=2, numSV=19, lat=47.5, lon=8.5,
            height=510000, hMSL=462000, hAcc=14, vAcc=20,
        )  # fmt: skip
        return bytes(pvt.serialize())

    def _answer(self, message: Any, frame: bytes) -> bytes:
        payload, identity = frame[6:-2], message.identity
        old = identity in ("CFG-MSG", "CFG-RATE")
        modern = identity in ("CFG-VALSET", "CFG-VALGET")
        if (old and self._generation != 8) or (modern and self._generation < 9):
            return acknowledged(frame, good=False)
        asked = {"CFG-MSG": len(payload) == 2, "CFG-RATE": not payload, "CFG-VALSET": False}
        if not asked.get(identity, True) and (self._refuses or self._forgets):
            return acknowledged(frame, good=not self._refuses)
        if not old:
            return super()._answer(message, frame)
        if identity == "CFG-MSG":
            key = payload[0], payload[1]
            if asked[identity]:
                rates = bytes((*key, 0, self.rates.get(key, 0), 0, 0, 0, 0))
                return ubx_message(b"\x06\x01", rates) + acknowledged(frame)
            self.rates[key] = payload[2]
        elif asked[identity]:
            rate = self.measurement_ms.to_bytes(2, "little") + b"\1\0\1\0"
            return ubx_message(b"\x06\x08", rate) + acknowledged(frame)
        else:
            self.measurement_ms = int.from_bytes(payload[:2], "little")
        return acknowledged(frame)

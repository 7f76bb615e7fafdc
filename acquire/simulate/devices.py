"""How simulated devices answer: an autopilot, and a u-blox receiver of generation 9.

They read and write with pymavlink and pyubx2, so that what we send is judged by other programs than our own.
"""

from collections.abc import Collection, Mapping
from typing import Any

ACCEPTED, UNSUPPORTED, FAILED = 0, 3, 4
PARAMETERS = {"SYSID_THISMAV": 1.0, "CAM1_TYPE": 1.0, "GPS_TYPE": 1.0}
_QUADROTOR, _ARDUPILOT, _STANDBY = 2, 3, 3


class Autopilot:
    """The vehicle's side of a link: heartbeat, message rates, time synchronisation, parameters."""

    def __init__(self, parameters: Mapping[str, float] | None = None) -> None:
        from pymavlink.dialects.v20 import ardupilotmega as tables

        self._tables: Any = tables
        self._mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
        self._mav.robust_parsing = True
        self._heartbeat_due_s = 0.0
        self._parameters = {**PARAMETERS, **(parameters or {})}
        self.interval_s: dict[int, float] = {}

    def due(self, time_s: float) -> bytes:
        """Return what is sent of its own accord up to a moment, seconds after the start."""
        if time_s < self._heartbeat_due_s:
            return b""
        heartbeat_s = 1.0
        self._heartbeat_due_s = time_s + heartbeat_s
        return self._pack(self._tables.MAVLink_heartbeat_message(_QUADROTOR, _ARDUPILOT, 0, 0, _STANDBY, 3))

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes of the ground station; return the answers."""
        messages = self._mav.parse_buffer(data) or []
        return b"".join(self._pack(reply) for each in messages for reply in self._answer(each, time_s))

    def _answer(self, message: Any, time_s: float) -> list[Any]:
        tables = self._tables
        match message.get_type():
            case "COMMAND_LONG":
                return [tables.MAVLink_command_ack_message(message.command, self._outcome(message))]
            case "TIMESYNC" if message.tc1 == 0:
                return [tables.MAVLink_timesync_message(self._boot_ns(time_s), message.ts1)]
            case "PARAM_REQUEST_LIST":
                return [self._parameter(name) for name in self._parameters]
            case "PARAM_REQUEST_READ":
                names = list(self._parameters)
                name = message.param_id if message.param_index < 0 else names[message.param_index]
                return [self._parameter(name)] if name in self._parameters else []
        return []

    def _outcome(self, command: Any) -> int:
        # MAV_CMD_SET_MESSAGE_INTERVAL.
        set_message_interval = 511
        if command.command != set_message_interval:
            return UNSUPPORTED
        if int(command.param1) not in self._offered():
            return FAILED
        self.interval_s[int(command.param1)] = command.param2 / 1e6
        return ACCEPTED

    def _offered(self) -> Collection[int]:
        """Give the messages that it can send."""
        return ()

    def _boot_ns(self, time_s: float) -> int:
        """Give its own clock; never 0, which would be a question."""
        return round(time_s * 1e9) + 1

    def _parameter(self, name: str) -> Any:
        place = list(self._parameters).index(name)
        return self._tables.MAVLink_param_value_message(
            name.encode(), self._parameters[name], 9, len(self._parameters), place
        )

    def _pack(self, message: Any) -> bytes:
        packed = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed


class SimulatedReceiver:
    """The receiver's side of a line: version, configuration, acknowledgements."""

    version: tuple[str, str, tuple[str, ...]] = (
        "EXT CORE 1.00 (0fa0b0)", "00190000", ("FWVER=HPG 1.32", "PROTVER=27.31", "MOD=ZED-F9P"),
    )  # fmt: skip

    def __init__(self) -> None:
        self._pending = b""
        self.settings: dict[str, int] = {}
        self.corrections = b""

    def receive(self, data: bytes, _time_s: float) -> bytes:
        """Take bytes of the host; return the answers."""
        from pyubx2 import SET, UBXMessage, UBXReader

        self._pending += data
        out = b""
        while len(self._pending) >= 8:
            if self._pending[:2] != b"\xb5\x62":
                # Corrections come over the same line.
                place = self._pending.find(b"\xb5\x62", 1)
                cut = place if place >= 0 else len(self._pending)
                self.corrections += self._pending[:cut]
                self._pending = self._pending[cut:]
                continue
            end = 8 + int.from_bytes(self._pending[4:6], "little")
            if len(self._pending) < end:
                break
            frame, self._pending = self._pending[:end], self._pending[end:]
            poll = frame[2:4] == b"\x06\x8b" or len(frame) in (8, 10)
            message: Any = UBXReader.parse(frame, msgmode=2 if poll else SET)
            assert isinstance(message, UBXMessage)  # noqa: S101
            out += self._answer(message, frame)
        if self._pending and not b"\xb5".startswith(self._pending[:1]):
            self.corrections, self._pending = self.corrections + self._pending, b""
        return out

    def _answer(self, message: Any, frame: bytes) -> bytes:
        if message.identity == "MON-VER":
            software, hardware, extensions = self.version
            texts = [software.encode().ljust(30, b"\0"), hardware.encode().ljust(10, b"\0")]
            texts += [text.encode().ljust(30, b"\0") for text in extensions]
            return ubx_message(b"\x0a\x04", b"".join(texts))
        if message.identity == "CFG-VALSET":
            values = {k: v for k, v in vars(message).items() if k.startswith("CFG_") and isinstance(v, int)}
            self.settings.update(values)
            return acknowledged(frame)
        if message.identity == "CFG-VALGET":
            keys = [int.from_bytes(frame[at : at + 4], "little") for at in range(10, len(frame) - 2, 4)]
            answer = b"\x01\0\0\0" + b"".join(self._value(key) for key in keys)
            return ubx_message(b"\x06\x8b", answer) + acknowledged(frame)
        return acknowledged(frame, good=False)

    def _value(self, key: int) -> bytes:
        from pyubx2 import cfgkey2name

        name, kind = cfgkey2name(key)
        return key.to_bytes(4, "little") + self.settings.get(name, 0).to_bytes(int(kind[1:]), "little")


def acknowledged(frame: bytes, *, good: bool = True) -> bytes:
    """Answer to a setting: taken or refused."""
    return ubx_message(b"\x05\x01" if good else b"\x05\x00", frame[2:4])


def ubx_message(kind: bytes, payload: bytes) -> bytes:
    """Give the frame of a message with the two bytes of its kind."""
    from pyubx2 import GET, UBXMessage

    return bytes(UBXMessage(kind[:1], kind[1:], GET, payload=payload).serialize())

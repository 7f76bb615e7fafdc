"""A simulated flight played to real ports by devices that listen and answer as hardware does.

How simulated devices answer: an autopilot, and a u-blox receiver of generation 9.

They read and write with pymavlink and pyubx2, so that what we send is judged by other programs than our own.
"""

import csv
import datetime as dt
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.world.configuration import read_configuration
from acquire.simulate.world.exposures import CAMERA_FROM_IMU_M
from acquire.simulate.world.streams import RecordedWire, make_streams
from acquire.simulate.world.world import make_world
from drivers.checksums import x25
from drivers.mavlink.dialect import V2, ardupilotmega
from photocal.base.errors import InputMalformedError, InputNotFoundError

ACCEPTED, UNSUPPORTED, FAILED = 0, 3, 4
PARAMETERS = {"SYSID_THISMAV": 1.0, "CAM1_TYPE": 1.0, "GPS_TYPE": 1.0}
_QUADROTOR, _ARDUPILOT, _STANDBY = 2, 3, 3
_AUTOPILOT = bytes((1, 1))


@dataclass(frozen=True)
class PlayedFlight:
    """A flight to be played.

    lines: by the names of the links: vehicle, rover, base.
    interval_s: between the measurements of rover and base.
    rates_hz: at which the autopilot sends the messages that matter most.
    parameters: of the autopilot: where the antenna was measured to be from the inertial unit.
    """

    lines: dict[str, RecordedWire]
    base_protocol: str
    interval_s: dict[str, float]
    rates_hz: dict[str, float]
    parameters: dict[str, float] = field(default_factory=dict)

    @property
    def end_s(self) -> float:
        """When the last frame of all is complete."""
        return max(line.end_s for line in self.lines.values())


def read_flight(source: Path, start_utc: dt.datetime | None = None) -> PlayedFlight:
    """Read a simulated flight, or fly it.

    raises InputNotFoundError: when there is neither, or the folder holds no streams.
    raises InputMalformedError: when streams and their times do not fit.
    """
    folder = source.is_dir()
    plan = source / "truth" / "flight.toml" if folder else source
    if folder and not plan.is_file():
        remedy = "name a folder that `acquire simulate flight` made"
        raise InputNotFoundError("holds no simulated flight", remedy, where=source)
    given = read_configuration(plan)
    gnss = given.gnss
    interval = {"rover": gnss.rover_interval_s, "base": gnss.base_interval_s}
    rates = {
        "ATTITUDE": given.telemetry.attitude_hz,
        "GLOBAL_POSITION_INT": given.telemetry.position_hz,
        "SYSTEM_TIME": 1.0,
    }
    antenna = CAMERA_FROM_IMU_M + given.rig.camera_to_antenna_m
    parameters = {f"GPS1_POS_{axis}": round(float(v), 3) for axis, v in zip("XYZ", antenna, strict=True)}
    if start_utc is not None:
        given = given.model_copy(update={"place": given.place.model_copy(update={"start_utc": start_utc})})
    elif folder:
        return PlayedFlight(_read_lines(source), gnss.base_protocol, interval, rates, parameters)
    return PlayedFlight(make_streams(make_world(given)), gnss.base_protocol, interval, rates, parameters)


def _read_lines(folder: Path) -> dict[str, RecordedWire]:
    lines = {}
    for name in ("vehicle", "rover", "base"):
        times = folder / "truth" / "wires" / f"{name}.csv"
        streams = sorted((folder / "site").glob(f"{name}.*"))
        if not times.is_file() or not streams:
            raise InputNotFoundError(
                f"has no stream of the link {name}",
                "name a folder that `acquire simulate flight` made with streams",
                where=folder,
            )
        lines[name] = _read_line(streams[0], times)
    return lines


def _read_line(stream: Path, times: Path) -> RecordedWire:
    data = stream.read_bytes()
    stamp_bytes = 8
    stamp = stamp_bytes if stream.suffix == ".tlog" else 0
    with times.open(encoding="utf-8", newline="") as rows:
        table = [(float(row["arrival_s"]), int(row["bytes"])) for row in csv.DictReader(rows)]
    ends = np.cumsum([size + stamp for _, size in table])
    if not table or ends[-1] != len(data):
        raise InputMalformedError(
            "does not fit the table of its frames", "simulate the flight again", where=stream
        )
    frames = tuple(data[end - size : end] for end, (_, size) in zip(ends.tolist(), table, strict=True))
    return RecordedWire(np.array([moment for moment, _ in table]), frames)


class FlightClock:
    """The time of the flight: begins when every device was spoken to, and runs `speed` times as fast."""

    def __init__(
        self,
        awaited: Iterable[str],
        speed: float,
        clock: Callable[[], float] = time.monotonic,
        begins_s: float | None = None,
    ) -> None:
        self._awaited = set(awaited)
        self._speed = speed
        self._clock = clock
        self._lock = threading.Lock()
        self._began = clock() if begins_s is None and not self._awaited else begins_s

    def heard(self, name: str) -> None:
        """Take note that a device was spoken to."""
        with self._lock:
            self._awaited.discard(name)
            if not self._awaited and self._began is None:
                self._began = self._clock()

    def flight_s(self) -> float:
        """Give seconds since the start of the flight; negative before."""
        return -1.0 if self._began is None else (self._clock() - self._began) * self._speed


class _Tape:
    """Gives the frames of a line as they become due by the clock of the flight."""

    def __init__(self, name: str, line: RecordedWire, clock: FlightClock) -> None:
        self.name, self.line, self.clock = name, line, clock
        self._next = 0

    def due(self) -> range:
        """Give the numbers of the frames that have become due."""
        after = int(np.searchsorted(self.line.arrival_s, self.clock.flight_s(), side="right"))
        numbers = range(self._next, after)
        self._next = max(self._next, after)
        return numbers


class FlownReceiver:
    """A receiver that sends what it recorded in flight, and answers to settings as a receiver does."""

    version: tuple[str, str, tuple[str, ...]] = (
        "EXT CORE 1.00 (0fa0b0)", "00190000", ("FWVER=HPG 1.32", "PROTVER=27.31", "MOD=ZED-F9P"),
    )  # fmt: skip

    def __init__(self, name: str, line: RecordedWire, clock: FlightClock) -> None:
        self._tape = _Tape(name, line, clock)
        self._pending = b""
        self.settings: dict[str, int] = {}
        self.corrections = b""

    def due(self, _time_s: float) -> bytes:
        """Return what is sent of its own accord."""
        return b"".join(self._tape.line.frames[k] for k in self._tape.due())

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
        self._tape.clock.heard(self._tape.name)
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


class FlownAutopilot:
    """The vehicle's side of a link: what it sent in flight, and answers to rates, clocks and parameters.

    Rates that are asked for thin out what it sends.

    Its own messages and its answers share one row of numbers, so the frames of the flight are numbered anew.
    """

    def __init__(
        self,
        name: str,
        line: RecordedWire,
        clock: FlightClock,
        *,
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        from pymavlink.dialects.v20 import ardupilotmega as tables

        self._tables: Any = tables
        self._mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
        self._mav.robust_parsing = True
        self._heartbeat_due_s = 0.0
        self._parameters = {**PARAMETERS, **(parameters or {})}
        self.interval_s: dict[int, float] = {}
        self._tape = _Tape(name, line, clock)
        self._seeds = ardupilotmega().seeds
        # Damage leaves some frames without a message.
        self._kinds = [
            int.from_bytes(frame[7:10], "little") if len(frame) >= 12 and frame[0] == V2 else -1
            for frame in line.frames
        ]
        self._period_s = _periods(line, self._kinds)
        self._passed: dict[int, int] = {}
        self._shift = 0
        self._number = 0

    def due(self, time_s: float) -> bytes:
        """Return what is sent of its own accord."""
        if self._tape.clock.flight_s() >= 0:
            return b"".join(self._numbered(k) for k in self._tape.due() if self._wanted(k))
        # Standing by: heartbeats alone, whatever was asked for.
        if time_s < self._heartbeat_due_s:
            return b""
        heartbeat_s = 1.0
        self._heartbeat_due_s = time_s + heartbeat_s
        return self._pack(self._tables.MAVLink_heartbeat_message(_QUADROTOR, _ARDUPILOT, 0, 0, _STANDBY, 3))

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes of the ground station; return the answers."""
        messages = self._mav.parse_buffer(data) or []
        answer = b"".join(self._pack(reply) for each in messages for reply in self._answer(each, time_s))
        self._tape.clock.heard(self._tape.name)
        return answer

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
        return self._period_s.keys()

    def _boot_ns(self, time_s: float) -> int:  # noqa: ARG002 - the flight has its own time
        """Give its own clock; never 0, which would be a question."""
        return round(max(self._tape.clock.flight_s(), 0.0) * 1e9) + 1

    def _parameter(self, name: str) -> Any:
        place = list(self._parameters).index(name)
        return self._tables.MAVLink_param_value_message(
            name.encode(), self._parameters[name], 9, len(self._parameters), place
        )

    def _wanted(self, number: int) -> bool:
        """Tell whether a frame is sent: of a message that is asked for less often, every n-th."""
        kind = self._kinds[number]
        interval = self.interval_s.get(kind)
        if interval is None or kind < 0:
            return True
        count = self._passed.get(kind, 0)
        self._passed[kind] = count + 1
        sent = interval > 0 and count % max(round(interval / self._period_s[kind]), 1) == 0
        self._shift -= not sent
        return sent

    def _numbered(self, number: int) -> bytes:
        frame, kind = self._tape.line.frames[number], self._kinds[number]
        seed = self._seeds.get(kind)
        if kind < 0 or frame[5:7] != _AUTOPILOT or seed is None:
            return frame
        if x25(frame[1:-2], seed) != int.from_bytes(frame[-2:], "little"):
            # Damaged on the way: it stays as it arrived.
            return frame
        changed = (frame[4] + self._shift) % 256
        self._number = (changed + 1) % 256
        body = frame[1:4] + bytes((changed,)) + frame[5:-2]
        return frame[:1] + body + x25(body, seed).to_bytes(2, "little")

    def _pack(self, message: Any) -> bytes:
        self._mav.seq = self._number
        packed = bytes(message.pack(self._mav))
        self._number = (self._number + 1) % 256
        self._shift += 1
        return packed


def _periods(line: RecordedWire, kinds: list[int]) -> dict[int, float]:
    """Give how often each message comes."""
    table = np.array(kinds)
    periods = {}
    for kind in np.unique(table[table >= 0]).tolist():
        times = line.arrival_s[table == kind]
        periods[kind] = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    return periods

"""A simulated flight played to real ports by devices that listen and answer as hardware does."""

import csv
import datetime as dt
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.devices import Autopilot, SimulatedReceiver
from acquire.simulate.world.configuration import read_configuration
from acquire.simulate.world.exposures import CAMERA_FROM_IMU_M
from acquire.simulate.world.streams import RecordedWire, make_streams
from acquire.simulate.world.world import make_world
from drivers.checksums import x25
from drivers.mavlink.dialect import V2, ardupilotmega
from photocal.base.errors import InputMalformedError, InputNotFoundError

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
    given = read_configuration(source / "truth" / "flight.toml" if folder else source)
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


class FlownReceiver(SimulatedReceiver):
    """A receiver that sends what it recorded in flight, and answers to settings as a receiver does."""

    def __init__(self, name: str, line: RecordedWire, clock: FlightClock) -> None:
        super().__init__()
        self._tape = _Tape(name, line, clock)

    def due(self, _time_s: float) -> bytes:
        """Return what is sent of its own accord."""
        return b"".join(self._tape.line.frames[k] for k in self._tape.due())

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes of the host; return the answers."""
        answer = super().receive(data, time_s)
        self._tape.clock.heard(self._tape.name)
        return answer


class FlownAutopilot(Autopilot):
    """An autopilot that sends what it sent in flight; rates that are asked for thin that out.

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
        super().__init__(parameters)
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
        if self._tape.clock.flight_s() < 0:
            # Standing by: heartbeats alone, whatever was asked for.
            return super().due(time_s)
        return b"".join(self._numbered(k) for k in self._tape.due() if self._wanted(k))

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes of the ground station; return the answers."""
        answer = super().receive(data, time_s)
        self._tape.clock.heard(self._tape.name)
        return answer

    def _offered(self) -> Collection[int]:
        return self._period_s.keys()

    def _boot_ns(self, time_s: float) -> int:  # noqa: ARG002 - the flight has its own time
        return round(max(self._tape.clock.flight_s(), 0.0) * 1e9) + 1

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
        packed = super()._pack(message)
        self._number = self._mav.seq
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

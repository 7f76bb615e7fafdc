"""A simulated flight as it is played: what goes over each line, and when."""

from __future__ import annotations

import csv
import datetime as dt
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import InputMalformedError, InputNotFoundError

_STAMP_BYTES = 8


@dataclass(frozen=True)
class Line:
    """What goes over one line: frames and when each is complete, s since the start of the flight."""

    time_s: Floats
    frames: tuple[bytes, ...]

    @property
    def end_s(self) -> float:
        """When the last frame is complete."""
        return float(self.time_s[-1]) if len(self.time_s) else 0.0


@dataclass(frozen=True)
class PlayedFlight:
    """A flight to be played.

    lines: by the names of the links: vehicle, rover, base.
    base_protocol: ``ubx`` or ``rtcm3``.
    interval_s: between the measurements of rover and base.
    rates_hz: at which the autopilot sends the messages that matter most.
    parameters: of the autopilot: where the antenna was measured to be from the inertial unit.
    """

    lines: dict[str, Line]
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
    from acquire.simulate.world.configuration import read_configuration
    from acquire.simulate.world.exposures import CAMERA_FROM_IMU_M

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
    from acquire.simulate.world.streams import make_streams
    from acquire.simulate.world.world import make_world

    wires = make_streams(make_world(given)).links()
    lines = {name: Line(wire.arrival_s, wire.frames) for name, wire in wires.items()}
    return PlayedFlight(lines, gnss.base_protocol, interval, rates, parameters)


def _read_lines(folder: Path) -> dict[str, Line]:
    lines = {}
    for name in ("vehicle", "rover", "base"):
        times = folder / "truth" / "wires" / f"{name}.csv"
        streams = sorted((folder / "site").glob(f"{name}.*"))
        if not times.is_file() or not streams:
            raise InputNotFoundError(
                f"has no stream of the link {name}",
                where=folder,
                remedy="name a folder that `acquire simulate flight` made with streams",
            )
        lines[name] = _read_line(streams[0], times)
    return lines


def _read_line(stream: Path, times: Path) -> Line:
    data = stream.read_bytes()
    stamp = _STAMP_BYTES if stream.suffix == ".tlog" else 0
    with times.open(encoding="utf-8", newline="") as rows:
        table = [(float(row["arrival_s"]), int(row["bytes"])) for row in csv.DictReader(rows)]
    ends = np.cumsum([size + stamp for _, size in table])
    if not table or ends[-1] != len(data):
        raise InputMalformedError(
            "does not fit the table of its frames", where=stream, remedy="simulate the flight again"
        )
    frames = tuple(data[end - size : end] for end, (_, size) in zip(ends.tolist(), table, strict=True))
    return Line(np.array([moment for moment, _ in table]), frames)

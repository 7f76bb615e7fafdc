"""A recorder that is killed in flight and started again: both logs give one trajectory."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.simulate.hardware import awaited, on_ports, record_settings
from acquire.simulate.playback import FlightClock, read_flight
from acquire.simulate.world.streams import Wire
from photocal.project import read_project
from tests.acquire.live import Recorder, await_frame, free_port, until
from tests.acquire.simulate.world.conftest import Flight

SPEED = 20.0
KILLED_S, GAP_S = 30.0, 5.0


class Stopwatch:
    """A steady clock that can be stopped and put forward."""

    def __init__(self) -> None:
        self._shift = 0.0
        self._stopped: float | None = None

    def __call__(self) -> float:
        return (time.monotonic() if self._stopped is None else self._stopped) + self._shift

    def stop(self) -> None:
        self._stopped = time.monotonic()

    def forward(self, seconds: float) -> None:
        self._shift += seconds

    def go(self) -> None:
        assert self._stopped is not None
        self._shift -= time.monotonic() - self._stopped
        self._stopped = None


def last_before(line: Wire, time_s: float) -> bytes:
    """Return the last frame that is complete by a moment."""
    return line.frames[int(np.searchsorted(line.arrival_s, time_s, side="right")) - 1]


def positions(path: Path) -> tuple[NDArray[np.int64], NDArray[np.float64], list[str]]:
    """Return GPS times, places (north, east, up in metres) and status."""
    with path.open(encoding="utf-8", newline="") as rows:
        table = list(csv.DictReader(rows))
    place = np.array([[float(row[name]) for name in ("lat_deg", "lon_deg", "height_m")] for row in table])
    metres = place * [111_132.0, 111_320.0 * np.cos(np.deg2rad(place[0, 0])), 1.0]
    times = np.array([int(row["time_gps_ns"]) for row in table])
    return times, metres, [row.get("status", "") for row in table]


@pytest.mark.slow
def test_both_logs_give_one_trajectory(small: Flight, tmp_path: Path) -> None:
    flight = read_flight(small.folder)
    watch = Stopwatch()
    clock = FlightClock(awaited(flight), SPEED, watch)
    with on_ports(flight, clock, udp_port=free_port()) as urls:
        settings = tmp_path / "record.toml"
        settings.write_text(record_settings(flight, urls, Path("log")))
        with Recorder(settings) as first:
            until(lambda: clock.flight_s() > KILLED_S, "the middle of the flight")
            watch.stop()
            killed_s = clock.flight_s()
            for link in ("rover", "base"):
                await_frame(first.path, link, last_before(flight.lines[link], killed_s))
            first.end(signal.SIGKILL)
        # The flight goes on with nobody listening.
        watch.forward(GAP_S / SPEED)
        with Recorder(settings) as second:
            for link in ("rover", "base"):
                second.line(f"{link} is configured, verified")
            watch.go()
            for link in ("rover", "base"):
                await_frame(second.path, link, flight.lines[link].frames[-1])
            second.figures()
    assert any(f"{first.path} has no end" in line for line in second.told)
    base = read_project(small.folder / "site" / "project.toml").flight.base_position
    assert base is not None
    command = [sys.executable, "-c", "from photocal.cli import main; main()", "ppk"]
    logs = [str(first.path), str(second.path)]
    place = ",".join(map(repr, base))
    done = subprocess.run(
        [*command, *logs, "--base-position", place, "--base-antenna-height", "1.652", "-o", tmp_path / "ppk"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    times, found, status = positions(tmp_path / "ppk" / "trajectory.csv")
    true_times, truth, _ = positions(small.folder / "truth" / "trajectory.csv")
    second_of_flight = (times - true_times[0]) / 1e9
    # All of both parts; between them at most what was flown without a recorder is missing.
    assert np.diff(second_of_flight).max() < GAP_S + 1.0
    assert second_of_flight[0] < 1.0
    assert second_of_flight[-1] > true_times[-1] / 1e9 - true_times[0] / 1e9 - 2.0
    nearest = np.abs(true_times - times[:, None]).argmin(axis=1)
    off_m = np.linalg.norm(found - truth[nearest], axis=1)
    before, after = second_of_flight < killed_s, second_of_flight > killed_s + GAP_S
    assert (np.array(status)[before] == "fixed").mean() > 0.9
    # Behind a gap a short flight may stay float in name: what counts is where it is.
    for part in (before, after):
        assert part.sum() > 100
        assert np.quantile(off_m[part], 0.99) < 0.05

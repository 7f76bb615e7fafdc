"""From the wires to the certificate, though the recorder was killed in flight and started again."""

from __future__ import annotations

import csv
import json
import signal
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from acquire.simulate.hardware import awaited, on_ports, record_settings
from acquire.simulate.playback import FlightClock, PlayedFlight, read_flight
from acquire.simulate.world.streams import RecordedWire
from photocal.commands.cli import app
from tests.acquire.live import Recorder, await_frame, frames_in, free_port, until
from tests.conftest import needs_engine
from tests.simulated import PLANS, simulate

pytestmark = pytest.mark.slow

SPEED = 20.0
# The recorder is dead from shortly before an exposure to shortly after the next one.
MARGIN_S = 0.7
PASS = {"course_deg": 90.0, "forward_overlap": 0.7, "side_overlap": 0.5}
PLAN = {
    "area_m": [[-20.0, -18.0], [20.0, -18.0], [20.0, 18.0], [-20.0, 18.0]],
    "take_off_m": [-26.0, -20.0],
    "on_ground_s": 15.0,
    "pass": [{**PASS, "height_m": 30.0, "speed_m_s": 4.0}, {**PASS, "height_m": 40.0, "speed_m_s": 6.0}],
}


class HaltingClock(FlightClock):
    """The flight waits at a moment, until somebody lets it go on at a later one."""

    def __init__(self, devices: tuple[str, ...], halt_s: float) -> None:
        super().__init__(devices, SPEED)
        self._halt_s = halt_s
        self._skipped_s: float | None = None

    def flight_s(self) -> float:
        now = super().flight_s()
        return min(now, self._halt_s) if self._skipped_s is None else now + self._skipped_s

    def go_on(self, later_s: float) -> None:
        self._skipped_s = later_s - super().flight_s()


def without(flight: PlayedFlight, begin_s: float, end_s: float) -> PlayedFlight:
    """Take out what is sent while nobody listens."""
    lines = {}
    for name, line in flight.lines.items():
        heard = (line.arrival_s <= begin_s) | (line.arrival_s > end_s)
        frames = tuple(frame for frame, keep in zip(line.frames, heard, strict=True) if keep)
        lines[name] = RecordedWire(line.arrival_s[heard], frames)
    return replace(flight, lines=lines)


def last_before(line: RecordedWire, time_s: float, count: int) -> tuple[bytes, ...]:
    end = int(np.searchsorted(line.arrival_s, time_s, side="right"))
    return line.frames[end - count : end]


def unnumbered(frame: bytes) -> bytes:
    """A MAVLink frame without its number and what depends on it."""
    return frame[:4] + frame[5:-2]


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as rows:
        return list(csv.DictReader(rows))


@dataclass(frozen=True)
class Outcome:
    folder: Path
    truth: dict[str, Any]
    figures: dict[str, Any]
    lost: set[str]
    told: list[str]
    gap_s: float


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    needs_engine()
    folder = tmp_path_factory.mktemp("killed") / "flight"
    simulate(folder, PLANS / "small.toml", level="observations", plan=PLAN, observing={"ties": 70})
    truth = json.loads((folder / "truth" / "truth.json").read_text())
    exposures = table(folder / "truth" / "exposures.csv")
    event_s = (np.array([int(row["event_gps_ns"]) for row in exposures]) - truth["start_gps_ns"]) / 1e9
    inner = len(event_s) // 4
    first_lost = inner + int(np.diff(event_s[inner:-inner]).argmin())
    begin_s, end_s = event_s[first_lost] - MARGIN_S, event_s[first_lost + 1] + MARGIN_S
    silent = (event_s > begin_s) & (event_s < end_s)
    flight = without(read_flight(folder), begin_s, end_s)
    clock = HaltingClock(awaited(flight), begin_s)
    logs = []
    with on_ports(flight, clock, udp_port=free_port()) as urls:
        settings = folder / "record.toml"
        settings.write_text(record_settings(flight, urls, Path("site/log")), encoding="utf-8")
        with Recorder(settings) as first:
            for link in ("rover", "base"):
                await_frame(first.path, link, last_before(flight.lines[link], begin_s, 1)[0])
            latest = {unnumbered(frame) for frame in last_before(flight.lines["vehicle"], begin_s, 10)}
            until(
                lambda: latest & set(map(unnumbered, frames_in(first.path, "vehicle"))),
                "the vehicle's last words",
            )
            first.end(signal.SIGKILL)
            logs.append(first.path)
        with Recorder(settings) as second:
            for link in ("rover", "base"):
                second.line(f"{link} is configured, verified")
            clock.go_on(end_s)
            for link in ("rover", "base"):
                await_frame(second.path, link, flight.lines[link].frames[-1])
            second.figures()
            logs.append(second.path)
    project = folder / "site" / "project.toml"
    text = project.read_text(encoding="utf-8")
    both = json.dumps([str(path.resolve()) for path in logs])
    assert '["flight.mcap"]' in text
    project.write_text(text.replace('["flight.mcap"]', both), encoding="utf-8")
    done = CliRunner().invoke(app, ["run", str(project), "--json"])
    assert done.exit_code == 0, done.output
    lost = {row["image"] for row, one in zip(exposures, silent, strict=True) if one}
    return Outcome(folder, truth, json.loads(done.stdout), lost, second.told, end_s - begin_s)


def trajectory(path: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """GPS times in ns, and places north, east and up in metres."""
    rows = table(path)
    place = np.array([[float(row[name]) for name in ("lat_deg", "lon_deg", "height_m")] for row in rows])
    times = np.array([int(row["time_gps_ns"]) for row in rows])
    return times, place * [111_132.0, 111_320.0 * np.cos(np.deg2rad(place[0, 0])), 1.0]


def test_the_recorder_says_what_the_first_one_left(outcome: Outcome) -> None:
    assert any("was not closed" in line for line in outcome.told)


def test_the_images_of_the_gap_are_named_and_no_others(outcome: Outcome) -> None:
    assert len(outcome.lost) == 2
    told = {one["code"]: one["text"] for one in outcome.figures["warnings"] if one["kind"] != "note"}
    assert set(told) == {"images-without-event"}
    assert all(name in told["images-without-event"] for name in outcome.lost)
    figures = json.loads((outcome.folder / "site/work/exposures/exposures.json").read_text())
    (camera,) = figures["cameras"]
    assert set(camera["unmatched_images"]) == outcome.lost
    page = (outcome.folder / "site/work/certificate/certificate.html").read_text(encoding="utf-8")
    assert all(name in page for name in outcome.lost)


def test_both_logs_give_one_trajectory(outcome: Outcome) -> None:
    """Whole from the first second to the last, and within centimetres on both sides of the gap."""
    times, found = trajectory(next((outcome.folder / "site" / "work").rglob("trajectory.csv")))
    true_times, truth = trajectory(outcome.folder / "truth" / "trajectory.csv")
    second_of_flight = (times - true_times[0]) / 1e9
    steps = np.diff(second_of_flight)
    assert outcome.gap_s - 1.0 < steps.max() < outcome.gap_s + 1.0
    assert second_of_flight[0] < 1.0
    assert times[-1] > true_times[-1] - 2e9
    off_m = np.linalg.norm(found - truth[np.abs(true_times - times[:, None]).argmin(axis=1)], axis=1)
    for part in np.split(off_m, [steps.argmax() + 1]):
        assert len(part) > 100
        assert np.quantile(part, 0.99) < 0.05


def test_the_truth_is_found_nevertheless(outcome: Outcome) -> None:
    figures, truth = outcome.figures, outcome.truth
    assert figures["ppk"]["fixed_percent"] > 95.0
    assert figures["exposures"]["matched"] == figures["exposures"]["images"] - len(outcome.lost)
    c = figures["calibration"]["cameras"]["SIM-0"]["parameters"]["c"]
    assert abs(c["value"] - truth["camera"]["mm"]["c"]) < 3 * c["sigma"]
    late = figures["calibration"]["mounting"]["time_offset"]
    assert abs(late["value"] - truth["rig"]["time_offset_s"]) < 3 * late["sigma"]
    for method in figures["check_points"].values():
        assert method["n"] == 3
        assert method["errors_over_prediction"] < 2.33

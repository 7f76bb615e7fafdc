"""A simulated flight on real ports, recorded as hardware is recorded."""

from __future__ import annotations

import threading
import time
import tomllib
from collections import Counter
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink.dialects.v20 import ardupilotmega

from acquire.recording.configuration import RecordingConfiguration, read_configuration
from acquire.recording.recorder import Recorded, record
from acquire.simulate.hardware import awaited, on_ports, record_settings
from acquire.simulate.playback import FlightClock, FlownAutopilot, PlayedFlight, read_flight
from acquire.simulate.world.streams import RecordedWire
from photocal.base.errors import InputMalformedError, InputNotFoundError
from tests.acquire.live import frames_in, until
from tests.acquire.simulate.world.conftest import Flight, flown
from tests.simulated import PLANS

SPEED = 20.0


def recorded(
    flight: PlayedFlight, folder: Path, *, base_on_tcp: bool = False, rates: dict[str, float] | None = None
) -> tuple[Recorded, FlightClock]:
    """Play a flight and record it until it is over."""
    clock = FlightClock(awaited(flight, base_on_tcp=base_on_tcp), SPEED)
    stop = threading.Event()
    told: list[str] = []
    with on_ports(flight, clock, base_on_tcp=base_on_tcp) as urls:
        text = record_settings(flight, urls, Path("log"))
        given = tomllib.loads(text)
        given["recording"]["least_free_mb"] = 0
        if rates is not None:
            given["link"][0]["vehicle"]["rates_hz"] = rates

        with ThreadPoolExecutor(1) as pool:
            recording = pool.submit(
                record, RecordingConfiguration.model_validate(given), folder, stop, told.append
            )
            thinned = {ardupilotmega.MAVLINK_MSG_ID_ATTITUDE} if rates else set()
            try:
                until(lambda: recording.done() or arrived(flight, folder / "log", thinned), "the end")
            finally:
                stop.set()
            result = recording.result()
    assert clock.flight_s() >= 0, told
    return result, clock


def arrived(flight: PlayedFlight, logs: Path, thinned: Collection[int] = ()) -> bool:
    """Tell whether the last frame of every link is in a log, apart from messages that are sent less often."""
    for name, line in flight.lines.items():
        last = next(f for f in reversed(line.frames) if name != "vehicle" or message(f) not in thinned)
        frames = frames_in(logs, name)
        found = unnumbered([last]) <= unnumbered(frames) if name == "vehicle" else last in frames
        if not found:
            return False
    return True


def message(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


def raw(result: Recorded, link: str) -> list[bytes]:
    found = []
    for path in result.paths:
        with path.open("rb") as stream:
            found += [m.data for _, _, m in make_reader(stream).iter_messages(topics=[f"/{link}/raw"])]
    return found


def unnumbered(frames: list[bytes] | tuple[bytes, ...]) -> Counter[bytes]:
    """Count MAVLink frames without what numbering changes."""
    return Counter(frame[:4] + frame[5:-2] for frame in frames)


def test_a_recording_over_real_ports_has_every_frame(small: Flight, tmp_path: Path) -> None:
    flight = read_flight(small.folder)
    result, _ = recorded(flight, tmp_path)
    for link in ("rover", "base"):
        sent = Counter(flight.lines[link].frames)
        arrived = Counter(raw(result, link))
        assert not sent - arrived
        # Answers to the settings, nothing else: version, acknowledgements, values.
        assert {frame[2:4] for frame in arrived - sent} <= {b"\x0a\x04", b"\x05\x01", b"\x06\x8b"}
    telemetry = raw(result, "vehicle")
    sent = unnumbered(flight.lines["vehicle"].frames)
    assert not sent - unnumbered(telemetry)
    extra = unnumbered(telemetry) - sent
    # Heartbeats before the flight, acknowledged rates, parameters, comparisons of clocks.
    assert {int.from_bytes(frame[6:9], "little") for frame in extra} <= {0, 22, 77, 111}
    numbers = [frame[4] for frame in telemetry if frame[5:7] == b"\x01\x01"]
    assert set(np.diff(numbers) % 256) == {1}
    assert not [a for a in result.alarms if a.kind not in ("note", "silent")], result.alarms


def test_a_base_by_tcp_and_lower_rates(small: Flight, tmp_path: Path) -> None:
    flight = read_flight(small.folder)
    result, _ = recorded(flight, tmp_path, base_on_tcp=True, rates={"ATTITUDE": 5, "SYSTEM_TIME": 1})
    assert not Counter(flight.lines["base"].frames) - Counter(raw(result, "base"))
    kinds = Counter(map(message, raw(result, "vehicle")))
    sent = Counter(map(message, flight.lines["vehicle"].frames))
    # Asked for in flight: the first part still comes at the full rate.
    assert 0.2 * sent[30] < kinds[30] < 0.8 * sent[30]
    assert kinds[2] == sent[2]
    assert kinds[33] == sent[33]


def test_a_recorder_that_was_stopped_is_started_again_in_flight(small: Flight, tmp_path: Path) -> None:
    flight = read_flight(small.folder)
    clock = FlightClock(awaited(flight), SPEED)
    end = flight.end_s
    parts: list[Recorded] = []
    with on_ports(flight, clock) as urls:
        given = tomllib.loads(record_settings(flight, urls, Path("log")))
        given["recording"]["least_free_mb"] = 0
        with ThreadPoolExecutor(1) as pool:
            for enough in (lambda: clock.flight_s() > end / 3, lambda: arrived(flight, tmp_path / "log")):
                stop = threading.Event()
                settings = RecordingConfiguration.model_validate(given)
                recording = pool.submit(record, settings, tmp_path, stop, lambda _: None)
                try:
                    until(enough, "its part of the flight")
                finally:
                    stop.set()
                parts.append(recording.result())
    first, second = (raw(part, "rover") for part in parts)
    sent = flight.lines["rover"].frames
    # The first has the beginning, the second the end; between them some seconds of flight are missing.
    assert sent[0] in first
    assert sent[-1] in second
    together = Counter(sent) - Counter(first) - Counter(second)
    assert together.total() < 0.5 * len(sent)
    assert {path.name for path in parts[0].paths}.isdisjoint(path.name for path in parts[1].paths)


def test_answers_take_their_place_in_the_row_of_numbers(small: Flight) -> None:
    line = read_flight(small.folder).lines["vehicle"]
    now = [0.0]
    clock = FlightClock(["vehicle"], 1.0, lambda: now[0])
    device = FlownAutopilot("vehicle", line, clock)
    sender = ardupilotmega.MAVLink(None, srcSystem=245)
    ask = sender.timesync_encode(0, 77).pack(sender)
    said = device.due(0.0) + device.receive(ask, 0.1)
    for step in range(1, 11):
        now[0] = float(step)
        said += device.due(float(step)) + (device.receive(ask, step) if step % 3 == 0 else b"")
    reader = ardupilotmega.MAVLink(None)
    messages = reader.parse_buffer(said)
    own = [m for m in messages if m.get_srcSystem() == 1]
    assert "BAD_DATA" not in {m.get_type() for m in messages}
    assert set(np.diff([m.get_seq() for m in own]) % 256) == {1}
    answers = [m for m in own if m.get_type() == "TIMESYNC" and m.ts1 == 77]
    assert len(answers) == 4
    assert all(m.tc1 > 0 for m in answers)


def test_the_flight_begins_when_all_were_heard() -> None:
    now = [5.0]
    clock = FlightClock(["a", "b"], 10.0, lambda: now[0])
    clock.heard("a")
    assert clock.flight_s() < 0
    clock.heard("b")
    now[0] = 7.0
    clock.heard("a")
    assert clock.flight_s() == pytest.approx(20.0)


def test_damaged_frames_stay_as_they_are(small: Flight) -> None:
    line = read_flight(small.folder).lines["vehicle"]
    hurt = bytearray(line.frames[3])
    hurt[12] ^= 4
    broken = replace(line, frames=(*line.frames[:3], bytes(hurt), *line.frames[4:]))
    device = FlownAutopilot("vehicle", broken, FlightClock([], 1e6))
    time.sleep(0.01)
    assert bytes(hurt) in device.due(0.0)


def test_a_configuration_is_played_without_a_folder() -> None:
    flight = read_flight(PLANS / "small.toml")
    assert set(flight.lines) == {"vehicle", "rover", "base"}
    assert all(isinstance(line, RecordedWire) and line.end_s > 50 for line in flight.lines.values())


def test_folders_that_cannot_be_played(small: Flight, tmp_path: Path) -> None:
    block = flown(tmp_path / "block", level="block")
    with pytest.raises(InputNotFoundError, match="no stream"):
        read_flight(block.folder)
    copy = tmp_path / "copy"
    for name in ("site/vehicle.tlog", "truth/flight.toml", "truth/wires/vehicle.csv"):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes((small.folder / name).read_bytes())
    (copy / "site/vehicle.tlog").write_bytes(b"short")
    with pytest.raises(InputMalformedError, match="does not fit"):
        read_flight(copy)


def test_the_written_configuration_is_read_by_the_recorder(tmp_path: Path) -> None:
    urls = {"vehicle": "udp://127.0.0.1:14550", "rover": "serial:/dev/ttyX", "base": "tcp://127.0.0.1:2101"}
    path = tmp_path / "record.toml"
    flight = PlayedFlight({}, "rtcm3", {"rover": 0.2, "base": 1.0}, {"ATTITUDE": 50.0})
    path.write_text(record_settings(flight, urls, Path("recording")))
    read = read_configuration(path)
    assert [link.url for link in read.link] == list(urls.values())
    assert read.link[1].ublox is not None
    assert read.link[2].ublox is None
    assert read.link[0].vehicle is not None
    assert read.link[0].vehicle.rates_hz == {"ATTITUDE": 50.0}

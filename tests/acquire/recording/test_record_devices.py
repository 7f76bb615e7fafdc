"""Devices that are spoken to while they are recorded: message rates, settings, corrections, time."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as tables

from acquire.recording.configuration import LinkConfiguration
from acquire.recording.dialogues import VehicleDialogue
from acquire.recording.recorder import source_of_link
from acquire.simulate.hardware import on_pty, on_udp
from acquire.transports.sources import Source
from drivers import rtcm3, ubx
from drivers.frames import StreamFramer, Wire
from drivers.mavlink.dialect import ardupilotmega
from tests.acquire.devices import Autopilot, Receiver
from tests.acquire.live import free_port
from tests.acquire.scripted import Script, configured, messages, run, said

START_US = 1_777_626_000_000_000


def test_an_autopilot_is_asked_for_rates_and_time(tmp_path: Path) -> None:
    port = free_port()
    autopilot = Autopilot(START_US)
    vehicle = {
        "name": "vehicle", "protocol": "mavlink", "url": f"udp://127.0.0.1:{port}",
        "vehicle": {"rates_hz": {"ATTITUDE": 50, "GPS_RAW_INT": 5, "RAW_RPM": 1}, "timesync_s": 0.1},
    }  # fmt: skip
    with on_udp(autopilot, "127.0.0.1", port):
        done, told = run(configured(vehicle), tmp_path, said("does not send RAW_RPM"))
    assert autopilot.interval_s == {30: 0.02, 24: 0.2}
    assert "vehicle sends ATTITUDE at 50 Hz" in told
    assert "vehicle does not send RAW_RPM at 1 Hz (failed)" in told
    assert [alarm.kind for alarm in done.alarms if alarm.kind != "note"] == ["device"]
    # We never take the part of the pilot's ground station: its loss must still be noticed on board.
    assert {(system, component) for _, system, component in autopilot.heard} == {(245, 191)}
    assert "HEARTBEAT" not in {name for name, _, _ in autopilot.heard}
    clocks = [json.loads(data) for data in messages(done.paths[0], "/clock")]
    trips = [clock["round_trip_ns"] for clock in clocks if clock["source"] == "TIMESYNC"]
    assert trips
    assert all(trip >= 0 for trip in trips)
    assert len(messages(done.paths[0], "/vehicle/sent")) == len(autopilot.heard)
    assert len(messages(done.paths[0], "/alarm")) == len(done.alarms)


def test_an_autopilot_that_does_not_answer_is_told() -> None:
    dialogue = VehicleDialogue(ardupilotmega(), {"ATTITUDE": 10}, 0)
    batch = StreamFramer((Wire.MAVLINK,)).feed(Autopilot(START_US).due(0.0))
    asked = 0
    alarms: list[str] = []
    for second in range(8):
        frames, _, raised = dialogue.step(batch if second == 0 else None, float(second), 0)
        asked += len(frames)
        alarms += raised
    assert asked == 4
    assert alarms == ["does not send ATTITUDE at 10 Hz (no answer)"]


def test_an_autopilot_that_asks_the_time_is_answered() -> None:
    mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
    beat = tables.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(mav)
    asked = tables.MAVLink_timesync_message(0, 123).pack(mav) + tables.MAVLink_timesync_message(7, 9).pack(
        mav
    )
    batch = StreamFramer((Wire.MAVLINK,)).feed(beat + asked)
    clock_ns = START_US * 1000
    dialogue = VehicleDialogue(ardupilotmega(), {}, 60.0)
    sent = [mav.parse_buffer(frame)[0] for frame in dialogue.step(batch, 0.0, clock_ns)[0]]
    assert [(m.tc1, m.ts1) for m in sent] == [(clock_ns, 123), (0, clock_ns)]
    assert not VehicleDialogue(ardupilotmega(), {}, 0.0).step(batch, 0.0, clock_ns)[0]


@pytest.mark.parametrize("generation", [8, 9])
def test_a_receiver_is_configured_and_verified(generation: int, tmp_path: Path) -> None:
    receiver = Receiver(generation)
    with on_pty(receiver) as path:
        rover = {
            "name": "rover", "protocol": "ubx", "url": f"serial:{path}",
            "ublox": {"port": "usb", "rate_ms": 200},
        }  # fmt: skip
        done, told = run(configured(rover), tmp_path, said("is configured", ))  # fmt: skip
    assert "rover is configured, verified" in told
    if generation == 9:
        names = ("NAV_PVT", "RXM_RAWX", "RXM_SFRBX", "TIM_TM2")
        assert receiver.settings == {f"CFG_MSGOUT_UBX_{n}_USB": 1 for n in names} | {"CFG_RATE_MEAS": 200}
    else:
        assert receiver.rates == {(1, 7): 1, (2, 0x15): 1, (2, 0x13): 1, (0x0D, 3): 1}
        assert receiver.measurement_ms == 200
    assert {alarm.kind: alarm.text for alarm in done.alarms}.keys() == {"note"}


@pytest.mark.parametrize(
    ("receiver", "words"),
    [
        (Receiver(7), "cannot be configured: only generations 8, 9 and 10 can"),
        (Receiver(9, refuses=True), "ACK-NAK"),
        (Receiver(8, refuses=True), "ACK-NAK"),
        (Receiver(9, forgets=True), "did not keep it"),
        (Receiver(8, forgets=True), "did not keep it"),
    ],
)
def test_a_receiver_that_is_not_configured_raises_an_alarm(
    receiver: Receiver, words: str, tmp_path: Path
) -> None:
    with on_pty(receiver) as path:
        rover = {
            "name": "rover", "protocol": "ubx", "url": f"serial:{path}",
            "ublox": {"port": "usb", "rate_ms": 200},
        }  # fmt: skip
        done, _ = run(configured(rover), tmp_path, said("is not configured"))
    (alarm,) = [a for a in done.alarms if a.kind == "device"]
    assert words in alarm.text


class _Heard:
    """A port that remembers whether its device was heard."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self.heard = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def read(self, timeout_s: float) -> bytes:
        data = self._source.read(timeout_s)
        self.heard = self.heard or bool(data)
        return data


class _After(Script):
    """Begins only when others were heard."""

    def __init__(self, pieces: list[bytes | str], others: list[_Heard]) -> None:
        super().__init__(pieces)
        self._others = others

    def read(self, timeout_s: float) -> bytes:
        if not all(other.heard for other in self._others):
            time.sleep(timeout_s)
            return b""
        return super().read(timeout_s)


def test_corrections_reach_the_rover_whole_and_the_vehicle_in_fragments(tmp_path: Path) -> None:
    chance = np.random.default_rng(3)
    # 1023 bytes of payload do not fit in four fragments; 180, 360 and 720 are the edges.
    sizes = [20, 174, 175, 354, 500, 714, 1023]
    sent = [rtcm3.encode(b"\x43\x50" + chance.bytes(size - 2)) for size in sizes]
    said_by_base: list[bytes | str] = [ubx.encode(0x0107, bytes(92)), *sent, b"\xd3\x00\x13 no frame"]
    port = free_port()
    autopilot, receiver = Autopilot(START_US), Receiver(9)
    with ExitStack() as stack:
        stack.enter_context(on_udp(autopilot, "127.0.0.1", port))
        rover = f"serial:{stack.enter_context(on_pty(receiver))}"
        links: list[dict[str, Any]] = [
            {"name": "vehicle", "protocol": "mavlink", "url": f"udp://127.0.0.1:{port}"},
            {"name": "rover", "protocol": "ubx", "url": rover},
            {"name": "base", "protocol": "rtcm3", "url": "file:x", "corrections_to": ["rover", "vehicle"]},
        ]
        sources = {x["name"]: _Heard(source_of_link(LinkConfiguration.model_validate(x))) for x in links[:2]}
        # The address of the vehicle is known, and the port of the rover is open.
        base = _After(said_by_base, list(sources.values()))
        done, told = run(
            configured(*links), tmp_path, lambda _: len(autopilot.corrections) >= 6 and
            len(receiver.corrections) >= sum(map(len, sent)), sources={**sources, "base": base},
        )  # fmt: skip
    assert receiver.corrections == b"".join(sent)
    assert autopilot.corrections == sent[:-1]
    assert "vehicle does not get RTCM 1077: 1029 bytes, at most 720 can be sent" in told
    assert messages(done.paths[0], "/rover/sent") == sent

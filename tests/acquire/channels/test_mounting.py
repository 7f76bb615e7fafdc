"""What the parameters of autopilots tell of antennas, mount and board: asked for, logged, shown, offered."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as tables
from typer.testing import CliRunner

from acquire.channels.mounting import NAMES, mounting_of
from acquire.channels.vehicle import VehicleDecoder
from acquire.commands.cli import app
from acquire.recording import dialogues
from acquire.simulate.hardware import on_udp
from drivers.frames import StreamFramer, Wire
from drivers.mavlink.dialect import ardupilotmega
from drivers.ulog import UlogFormats, UlogFramer
from tests.acquire.devices import Autopilot
from tests.acquire.live import free_port
from tests.acquire.scripted import configured, messages, run, said


def test_the_recorder_reads_what_the_vehicle_knows_of_its_mounting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dialogues, "_PARAMETER_EVERY_S", 0.01)
    port = free_port()
    antenna = {"GPS1_POS_X": 0.12, "GPS1_POS_Y": -0.05, "GPS1_POS_Z": -0.31}
    autopilot = Autopilot(1_777_626_000_000_000, parameters=antenna)
    vehicle = {"name": "vehicle", "protocol": "mavlink", "url": f"udp://127.0.0.1:{port}", "vehicle": {}}
    with on_udp(autopilot, "127.0.0.1", port):
        done, told = run(configured(vehicle), tmp_path, said("parameters: acquire info"))
    assert "vehicle reports 4 parameters: acquire info shows those of its mounting" in told
    # Each name goes over the link twice at the most, those that were told once.
    asked = [name for name, *_ in autopilot.heard if name == "PARAM_REQUEST_READ"]
    assert len(asked) == 2 * len(NAMES) - 4
    values = {p["name"]: p["value"] for p in map(json.loads, messages(done.paths[0], "/vehicle/parameter"))}
    assert {name: values[name] for name in antenna} == pytest.approx(antenna, abs=1e-7)
    result = CliRunner().invoke(app, ["info", str(done.paths[0])])
    assert "antenna 1: 0.12" in result.output
    rig = json.loads(CliRunner().invoke(app, ["info", str(done.paths[0]), "--json"]).stdout)["mounting"]
    offered = rig["vehicle/parameter"]["rig"]
    assert offered["camera_to_antenna_m"] == pytest.approx(list(antenna.values()), abs=1e-7)
    assert offered["camera_to_antenna_sigma_m"] == [0.1, 0.1, 0.1]


@pytest.mark.parametrize(("kind", "value"), [(9, 0.25), (6, 4.0), (6, -12.0), (2, 0.0)])
@pytest.mark.parametrize("bytewise", [True, False])
def test_whole_numbers_as_ardupilot_and_as_px4_send_them(kind: int, value: float, bytewise: bool) -> None:
    sent = value
    if bytewise and kind != 9:
        sent = struct.unpack("<f", struct.pack("<i", int(value)))[0]
    mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = tables.MAVLink_param_value_message(b"SENS_BOARD_ROT", sent, kind, 1, 0).pack(mav)
    batch = StreamFramer((Wire.MAVLINK,)).feed(bytes(frame))
    _, decoded = VehicleDecoder("v", ardupilotmega()).feed(batch, np.zeros(1, np.int64))
    told = json.loads(decoded[0].payloads[0])
    assert (told["name"], told["value"]) == ("SENS_BOARD_ROT", value)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("file", "count", "shown"),
    [
        ("mavlink-tlog-cuav-images/flight.tlog", 791, "board, trim: 0.0303279, 0.016498, 0 rad"),
        ("autopilot-logs/log171.bin", 491, "board, trim: 0.0205198, 0.00528158, 0 rad"),
        ("autopilot-logs/sample_log_small.ulg", 980, "antenna 1: 0, 0, 0 m (EKF2_GPS_POS_X"),
    ],
)
def test_logs_of_both_autopilots(file: str, count: int, shown: str, shared: Path, tmp_path: Path) -> None:
    """Counts and values as pymavlink and pyulog read them."""
    out = tmp_path / "out.mcap"
    source = shared / "data" / file
    assert CliRunner().invoke(app, ["import", str(source), "-o", str(out)]).exit_code == 0
    text = CliRunner().invoke(app, ["info", str(out)]).output
    assert f"mounting, from {count} parameters of vehicle" in text
    assert shown in text


def test_a_parameter_of_a_px4_log() -> None:
    def record(kind: bytes, payload: bytes) -> bytes:
        return struct.pack("<HB", len(payload), kind[0]) + payload

    def parameter(key: bytes, value: bytes) -> bytes:
        return record(b"P", bytes([len(key)]) + key + value)

    head = b"ULog\x01\x12\x35\x01" + bytes(8)
    data = parameter(b"float EKF2_GPS_POS_Z", struct.pack("<f", -0.5))
    data += parameter(b"int32_t SENS_BOARD_ROT", struct.pack("<i", -3)) + parameter(b"double X", bytes(8))
    framer = UlogFramer()
    batch = framer.feed(head + data + record(b"S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"))
    told = UlogFormats().parameters(batch)
    assert dict(zip(told["name"].tolist(), told["value"].tolist(), strict=True)) == {
        "EKF2_GPS_POS_Z": -0.5,
        "SENS_BOARD_ROT": -3.0,
    }


def test_what_is_offered() -> None:
    """The newer of two names stands; an antenna at zero was not measured; a mount counts where it is held."""
    newer = {f"SENS_GPS0_OFF{axis}": v for axis, v in zip("XYZ", (-0.1, 0.0, -0.12), strict=True)}
    older = {f"EKF2_GPS_POS_{axis}": 0.5 for axis in "XYZ"}
    assert mounting_of({**older, **newer}).camera_to_antenna_m == (-0.1, 0.0, -0.12)
    assert mounting_of(older).camera_to_antenna_m == (0.5, 0.5, 0.5)
    assert mounting_of(dict.fromkeys(older, 0.0)).camera_to_antenna_m is None
    mount = {"MNT1_NEUTRAL_X": 0.0, "MNT1_NEUTRAL_Y": -90.0, "MNT1_NEUTRAL_Z": 0.0, "MNT1_TYPE": 1.0}
    assert mounting_of({**mount, "MNT1_DEFLT_MODE": 1.0}).mount_deg == (0.0, -90.0, 0.0)
    assert mounting_of({**mount, "MNT1_DEFLT_MODE": 3.0}).mount_deg is None
    assert mounting_of({**mount, "MNT1_DEFLT_MODE": 1.0, "MNT1_TYPE": 0.0}).mount_deg is None

"""DataFlash and PX4 logs and event lists in the flight log: raw byte for byte, and the usual topics."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from mcap.reader import make_reader
from pymavlink import DFReader
from pyulog import ULog  # type: ignore[import-untyped]

from acquire.importing.importer import Imported, import_recordings
from photocal.base.errors import InputMalformedError
from photocal.base.time_scales import GPS_EPOCH_NS

LEAP_NS = 18 * 10**9  # GPS - UTC since 2017


def imported(source: Path, folder: Path) -> tuple[Imported, dict[str, list[Any]]]:
    log = folder / "log.mcap"
    (result,) = import_recordings([], [source], log, lambda _: None)
    found: dict[str, list[Any]] = {}
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(message)
    return result, found


def stamp_ns(message: Any) -> int:
    return int(message.timestamp.seconds) * 10**9 + int(message.timestamp.nanos)


def rows(found: dict[str, list[Any]], topic: str) -> list[dict[str, Any]]:
    return [json.loads(message.data) for message in found[topic]]


def time_ns(row: dict[str, Any], member: str = "time") -> int:
    return int(row[member]["sec"]) * 10**9 + int(row[member]["nsec"])


@pytest.mark.shared
def test_a_dataflash_log_is_imported_whole(shared: Path, tmp_path: Path) -> None:
    source = shared / "data/autopilot-logs/log171.bin"
    result, found = imported(source, tmp_path)
    assert result.link == "vehicle"
    assert b"".join(m.data for m in found["/vehicle/raw"]) == source.read_bytes()
    log = DFReader.DFReader_binary(str(source))
    theirs: dict[str, list[Any]] = {}
    while (message := log.recv_match(type=["ATT", "GPS", "MSG"])) is not None:
        theirs.setdefault(message.get_type(), []).append(message)
    log.close()
    turns = [FrameTransform.FromString(m.data) for m in found["/vehicle/attitude"]]
    assert len(turns) == len(theirs["ATT"]) == 2383
    boot = np.array([stamp_ns(t) for t in turns]) - np.array([m.TimeMS for m in theirs["ATT"]]) * 10**6
    assert np.ptp(boot) == 0
    for turn, angles in list(zip(turns, theirs["ATT"], strict=True))[::200]:
        q = turn.rotation
        # Heading of the body's x axis in north and east: the first column of the rotation matrix.
        north, east = 1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z)
        assert np.rad2deg(np.arctan2(east, north)) % 360 == pytest.approx(angles.Yaw % 360, abs=0.01)
    fixes = [LocationFix.FromString(m.data) for m in found["/gnss/vehicle/fix"]]
    good = [m for m in theirs["GPS"] if m.Status >= 2]
    assert [f.latitude for f in fixes] == pytest.approx([m.Lat for m in good], abs=1e-9)
    assert [f.altitude for f in fixes] == pytest.approx([m.Alt for m in good], abs=1e-6)
    # The start of the autopilot by its receiver: never later than any record allows, 17 leap seconds in 2015.
    told = np.array([m.Week * 604_800_000 + m.TimeMS - m.T for m in good], np.int64) * 10**6
    latest = told[np.abs(told - np.median(told)) < 5e8].max() + GPS_EPOCH_NS - 17 * 10**9
    assert boot[0] == latest
    assert [row["text"] for row in rows(found, "/health")] == [m.Message for m in theirs["MSG"]]


@pytest.mark.shared
def test_a_px4_log_is_imported_whole(shared: Path, tmp_path: Path) -> None:
    source = shared / "data/autopilot-logs/sample_log_small.ulg"
    _, found = imported(source, tmp_path)
    assert b"".join(m.data for m in found["/vehicle/raw"]) == source.read_bytes()
    theirs = ULog(str(source))
    attitude = theirs.get_dataset("vehicle_attitude").data
    turns = [FrameTransform.FromString(m.data) for m in found["/vehicle/attitude"]]
    for name, column in zip("wxyz", ("q[0]", "q[1]", "q[2]", "q[3]"), strict=True):
        np.testing.assert_array_equal([getattr(t.rotation, name) for t in turns], attitude[column])
    gps = theirs.get_dataset("vehicle_gps_position").data
    boot = (gps["time_utc_usec"].astype(np.int64) - gps["timestamp"].astype(np.int64)).max() * 1000
    expected = attitude["timestamp"].astype(np.int64) * 1000 + boot
    np.testing.assert_array_equal([stamp_ns(t) for t in turns], expected)
    fixes = [LocationFix.FromString(m.data) for m in found["/gnss/vehicle/fix"]]
    np.testing.assert_allclose([f.longitude for f in fixes], gps["lon"] * 1e-7, atol=1e-12)
    clocks = rows(found, "/clock")
    assert [time_ns(c, "device") for c in clocks] == (gps["time_utc_usec"].astype(np.int64) * 1000).tolist()


@pytest.mark.shared
def test_an_event_list_is_imported_whole(shared: Path, tmp_path: Path) -> None:
    source = shared / "data/rtk-mrk-gcp-helenenschacht/101FTASK_Timestamp.mrk"
    result, found = imported(source, tmp_path)
    assert result.link == "camera"
    assert b"".join(m.data for m in found["/camera/raw"]) == source.read_bytes()
    events = rows(found, "/camera/exposure")
    assert len(events) == 176
    first = source.read_text().split("\n")[0].split()
    assert events[0]["sequence"] == int(first[0]) == 2
    expected = GPS_EPOCH_NS + 2211 * 604_800 * 10**9 + 296_288_242_869_000 - LEAP_NS
    assert abs(time_ns(events[0]) - expected) < 1000
    fix = LocationFix.FromString(found["/gnss/camera/fix"][0].data)
    assert (fix.latitude, fix.longitude, fix.altitude) == (47.6436873208, 16.4759271684, 512.998)
    assert fix.position_covariance[8] == pytest.approx(0.029694**2)


def definition(kind: int, name: str, form: str, columns: str) -> bytes:
    sizes = {"Q": 8, "I": 4, "H": 2, "B": 1, "L": 4, "f": 4}
    size = 3 + sum(sizes[letter] for letter in form)
    body = struct.pack("<BB4s16s64s", kind, size, name.encode(), form.encode(), columns.encode())
    return b"\xa3\x95\x80" + body


def made_dataflash(fix: int = 3) -> bytes:
    """A log with camera messages as ArduPilot writes them since 2016; TimeUS of the GPS lags by 100 ms."""
    data = definition(10, "GPS", "QBIHBffLLf", "TimeUS,Status,GMS,GWk,NSats,HDop,U,Lat,Lng,Alt")
    data += definition(11, "CAM", "QIHLLfffff", "TimeUS,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,Roll,Pitch,Yaw")
    data += definition(12, "TRIG", "QIHLLfffff", "TimeUS,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,Roll,Pitch,Yaw")
    for second in range(5):
        tow = 100_000_000 + 1000 * second
        gps = struct.pack(
            "<QBIHBffiif", 60_000_000 + 1_000_000 * second + 100_000, fix, tow, 2300, 12, 0.8, 1.0,
            -227_000_000, -432_000_000, 30.0,
        )  # fmt: skip
        data += b"\xa3\x95\x0a" + gps
        for kind, late in ((12, 0), (11, 30_000)):
            cam = struct.pack(
                "<QIHiifffff", 60_400_000 + 1_000_000 * second + late, tow, 2300,
                -227_000_001, -432_000_001, 130.5, 100.0, 1.5, -2.5, 90.0,
            )  # fmt: skip
            data += b"\xa3\x95" + bytes([kind]) + cam
    return data


def test_camera_messages_become_exposures(tmp_path: Path) -> None:
    source = tmp_path / "flight.bin"
    source.write_bytes(made_dataflash())
    _, found = imported(source, tmp_path)
    events = rows(found, "/camera/exposure")
    start = GPS_EPOCH_NS + (2300 * 604_800 + 100_000 - 18) * 10**9
    for edge, late_ns in (("trigger", 0), ("feedback", 30_000_000)):
        own = [e for e in events if e["edge"] == edge]
        # The record of the receiver came 100 ms after its epoch: the events are 300 ms and more after it.
        assert [time_ns(e) - start for e in own] == [n * 10**9 + 300_000_000 + late_ns for n in range(5)]
        assert (own[0]["roll_deg"], own[0]["yaw_deg"], own[0]["altitude_msl_m"]) == (1.5, 90.0, 130.5)
        assert own[0]["latitude_deg"] == pytest.approx(-22.7000001, abs=1e-9)


def test_a_log_without_utc_is_refused_in_words(tmp_path: Path) -> None:
    source = tmp_path / "indoor.bin"
    source.write_bytes(made_dataflash(fix=1))
    with pytest.raises(InputMalformedError, match="never reported UTC"):
        imported(source, tmp_path)
    assert not (tmp_path / "log.mcap").exists()


def test_a_px4_log_with_a_camera(tmp_path: Path) -> None:
    def record(kind: str, payload: bytes) -> bytes:
        return struct.pack("<HB", len(payload), ord(kind)) + payload

    formats = {
        "sensor_gps": "uint64_t timestamp;uint64_t time_utc_usec;double latitude_deg;double longitude_deg;"
        "double altitude_msl_m;uint8_t fix_type;uint8_t[7] _padding0;",
        "camera_capture": "uint64_t timestamp;uint64_t timestamp_utc;uint32_t seq;double lat;double lon;"
        "float alt;float[4] q;int8_t result;",
        "vehicle_global_position": "uint64_t timestamp;double lat;double lon;float alt;",
    }
    data = b"ULog\x01\x12\x35\x01" + bytes(8)
    data += b"".join(record("F", f"{name}:{members}".encode()) for name, members in formats.items())
    data += b"".join(record("A", struct.pack("<BH", 0, n) + name.encode()) for n, name in enumerate(formats))
    start_us = 1_700_000_000_000_000
    for n in range(4):
        boot = 50_000_000 + n * 1_000_000
        gps = struct.pack("<HQQdddB", 0, boot, start_us + boot, -22.7, -43.2, 30.0, 6)
        data += record("D", gps)
        place = struct.pack("<HQddf", 2, boot + 1000, -22.70001, -43.2, 30.5)
        data += record("D", place)
        known = start_us + boot + 500_001 if n else 0
        shot = struct.pack("<HQQIddf4fb", 1, boot + 500_000, known, n, -22.7, -43.2, 130.0, 1, 0, 0, 0, 1)
        data += record("D", shot)
    source = tmp_path / "flight.ulg"
    source.write_bytes(data)
    _, found = imported(source, tmp_path)
    events = rows(found, "/camera/exposure")
    assert [e["sequence"] for e in events] == [0, 1, 2, 3]
    # The camera's own UTC where it has one, the running time of the autopilot otherwise.
    assert [time_ns(e) // 1000 - start_us for e in events[:2]] == [50_500_000, 51_500_001]
    assert rows(found, "/gnss/vehicle-sensor/status")[0]["fix"] == "rtk_fixed"
    fix = LocationFix.FromString(found["/vehicle/position"][0].data)
    assert (fix.latitude, stamp_ns(fix) // 1000 - start_us) == (-22.70001, 50_001_000)


@pytest.mark.parametrize("suffix", ["bin", "ulg", "mrk"])
def test_hostile_logs_are_refused_or_kept(suffix: str, tmp_path: Path) -> None:
    line = b"1\t100000.5\t[2211]\t 3,N\t 0,E\t 75,V\t47.6,Lat\t16.4,Lon\t512.9,Ellh\t0.01, 0.01, 0.02\t50,Q\n"
    good = {"bin": made_dataflash(), "ulg": b"ULog\x01\x12\x35\x01" + bytes(8), "mrk": line * 5}[suffix]
    chance = np.random.default_rng(3)
    for _ in range(60):
        broken = bytearray(good)
        for place in chance.integers(0, len(good), int(chance.integers(1, 30))).tolist():
            broken[place] = int(chance.integers(0, 256))
        source = tmp_path / f"flight.{suffix}"
        source.write_bytes(bytes(broken[: int(chance.integers(1, len(good) + 1))]))
        try:
            result, found = imported(source, tmp_path)
        except InputMalformedError:
            continue
        kept = sorted(
            (m.sequence, m.data) for t, ms in found.items() if t.endswith(("/raw", "/damage")) for m in ms
        )
        assert b"".join(data for _, data in kept) == source.read_bytes()
        assert result.tally.damage_bytes + result.tally.frame_bytes == source.stat().st_size

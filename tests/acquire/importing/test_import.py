"""Import of the recorded data, against their descriptions and the published readers and schemas."""

from __future__ import annotations

import datetime as dt
import gzip
import hashlib
import importlib
import json
import subprocess
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink import mavutil
from scipy.spatial.transform import Rotation

Acquire = Callable[..., subprocess.CompletedProcess[str]]
pytestmark = pytest.mark.shared


@cache
def messages(path: Path) -> list[tuple[str, str, str, Any]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [
            (channel.topic, channel.message_encoding, schema.name if schema else "", message)
            for schema, channel, message in reader.iter_messages()
        ]


def test_the_raw_frames_put_together_are_the_recording(logs: dict[str, Path], shared: Path) -> None:
    data = shared / "data"
    recordings = {
        ("dronekit", "vehicle"): data / "mavlink-tlog-dronekit/flight.tlog",
        ("m8p", "base"): data / "gnss-ubx-m8p-base-rover/base-20181004-1236.ubx.gz",
        ("f9p", "rover"): data / "gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx",
    }
    for (name, link), recording in recordings.items():
        raw = recording.read_bytes()
        raw = gzip.decompress(raw) if recording.suffix == ".gz" else raw
        pieces = {}
        for topic, encoding, _, message in messages(logs[name]):
            if topic in (f"/{link}/raw", f"/{link}/damage"):
                assert message.sequence not in pieces
                stamp = b""
                if encoding == "mavlink":
                    stamp = (message.log_time // 1000).to_bytes(8, "big")
                pieces[message.sequence] = stamp + message.data
        assert b"".join(pieces[n] for n in sorted(pieces)) == raw


def test_every_foxglove_message_decodes_with_the_published_package(logs: dict[str, Path]) -> None:
    counts: Counter[str] = Counter()
    for path in logs.values():
        for _, encoding, schema, message in messages(path):
            if schema.startswith("foxglove."):
                assert encoding == "protobuf"
                counts[schema] += 1
                if counts[schema] % 7:
                    continue
                short = schema.split(".")[1]
                kind = getattr(importlib.import_module(f"foxglove_schemas_protobuf.{short}_pb2"), short)
                decoded = kind.FromString(message.data)
                assert decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos == message.publish_time
    assert counts["foxglove.LocationFix"] > 10_000
    assert counts["foxglove.FrameTransform"] > 3_000


def test_attitudes_and_positions_are_those_that_pymavlink_reads(logs: dict[str, Path], shared: Path) -> None:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    log = mavutil.mavlink_connection(str(shared / "data/mavlink-tlog-dronekit/flight.tlog"))
    angles, places = [], []
    while (m := log.recv_match(type=["ATTITUDE", "GLOBAL_POSITION_INT"])) is not None:
        if m.get_type() == "ATTITUDE":
            angles.append((m.yaw, m.pitch, m.roll))
        elif m.lat or m.lon:
            places.append((m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3))
    log.close()
    found = sorted(messages(logs["dronekit"]), key=lambda item: item[3].sequence)
    transforms = [FrameTransform.FromString(m.data) for t, _, _, m in found if t == "/vehicle/attitude"]
    fixes = [LocationFix.FromString(m.data) for t, _, _, m in found if t == "/vehicle/position"]
    quaternions = [[t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w] for t in transforms]
    ours = Rotation.from_quat(quaternions).as_matrix()
    theirs = Rotation.from_euler("ZYX", angles).as_matrix()
    np.testing.assert_allclose(ours, theirs, atol=1e-12)
    np.testing.assert_allclose([(f.latitude, f.longitude, f.altitude) for f in fixes], places, rtol=1e-15)


def test_importing_twice_gives_the_same_file(
    logs: dict[str, Path], shared: Path, acquire: Acquire, tmp_path: Path
) -> None:
    again = tmp_path / "again.mcap"
    assert acquire("import", shared / "data/mavlink-tlog-dronekit/flight.tlog", "-o", again).returncode == 0
    assert again.read_bytes() == logs["dronekit"].read_bytes()


def test_time_marks_are_the_events_of_the_description(logs: dict[str, Path]) -> None:
    events = [json.loads(m.data) for t, _, _, m in messages(logs["moving"]) if t == "/camera/exposure"]
    edges = Counter(event["edge"] for event in events)
    # 589 rising and 589 falling edges, about every 2 s, accuracy at most 54 ns, in UTC.
    assert edges == {"rising": 589, "falling": 589}
    assert max(event["accuracy_ns"] for event in events) <= 54
    rising = [e["time"]["sec"] + e["time"]["nsec"] * 1e-9 for e in events if e["edge"] == "rising"]
    assert np.median(np.diff(rising)) == pytest.approx(2.0, abs=0.05)
    clock = [json.loads(m.data) for t, _, _, m in messages(logs["moving"]) if t == "/clock"]
    assert clock[0]["device"]["sec"] < rising[0] < rising[-1] < clock[-1]["device"]["sec"] + 2


def test_the_source_is_told_by_hash_and_damage(logs: dict[str, Path], shared: Path) -> None:
    path = shared / "data/mavlink-tlog-dronekit/flight.tlog"
    with logs["dronekit"].open("rb") as stream:
        notes = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    source = notes["import vehicle"]
    assert source["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert source["bytes"] == "2723840"
    assert source["log_time"] == "host stamps of the recording"
    assert int(source["cut_bytes"]) == int(source["damage_bytes"]) > 0
    with logs["m8p"].open("rb") as stream:
        notes = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert "derived" in notes["import base"]["log_time"]


def info(acquire: Acquire, path: Path) -> dict[str, Any]:
    done = acquire("info", path, "--json")
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def test_a_log_says_whether_it_can_be_processed(logs: dict[str, Path], acquire: Acquire) -> None:
    said = info(acquire, logs["moving"])["verdict"]
    assert said["exposures"] == {"mark": 589}
    assert said["exposures_possible"]["possible"]
    both = info(acquire, logs["m8p"])["verdict"]
    assert both["ppk"]["possible"]
    told = acquire("info", logs["dronekit"]).stdout
    assert "none triggered, reported or marked" in told
    assert "PPK no (no raw observations)" in told
    assert "unknown 142" not in told
    assert "unknown 142" in acquire("info", logs["dronekit"], "--types").stdout


def test_info_of_the_dronekit_flight(logs: dict[str, Path], acquire: Acquire) -> None:
    figures = info(acquire, logs["dronekit"])
    (link,) = figures["links"]
    types = {t["type"]: t["frames"] for t in link["types"]}
    assert link["frames"] == 75_477 + 1314
    # The description's own counts.
    expected = {"GPS_RAW_INT": 2858, "GLOBAL_POSITION_INT": 2833, "ATTITUDE": 2829, "RAW_IMU": 2856}
    expected |= {"SCALED_IMU2": 2852, "SYSTEM_TIME": 2812, "HEARTBEAT": 2421, "RADIO_STATUS": 1370}
    expected |= {"unknown 142": 1314}
    assert {name: types[name] for name in expected} == expected
    offset = link["clock"]["host_minus_device_s"]
    assert offset["least"] == pytest.approx(-1.82, abs=0.005)
    assert offset["greatest"] == pytest.approx(0.38, abs=0.005)
    assert "slower" not in link["clock"]["verdict"]
    assert {(s["system"], s["component"]) for s in link["sources"]} == {(1, 1), (51, 68), (255, 0)}
    assert link["duration_s"] == pytest.approx(1377, abs=0.6)


def test_info_of_the_cuav_flight_says_that_the_host_clock_is_slow(
    logs: dict[str, Path], acquire: Acquire
) -> None:
    (link,) = info(acquire, logs["cuav"])["links"]
    assert "4.6 times slower" in link["clock"]["verdict"]
    assert "4.6 times slower" in acquire("info", logs["cuav"]).stdout


def test_info_of_the_receivers(logs: dict[str, Path], acquire: Acquire) -> None:
    m8p = info(acquire, logs["m8p"])
    links = {link["link"]: {t["type"]: t["frames"] for t in link["types"]} for link in m8p["links"]}
    rover = {"RXM-RAWX": 1205, "RXM-SFRBX": 7341, "TIM-TM2": 7, "GGA": 1204}
    base = {"RXM-RAWX": 321, "RXM-SFRBX": 4228, "1005": 648, "1077": 607, "1087": 623, "1230": 685}
    assert {name: links["rover"][name] for name in rover} == rover
    assert {name: links["base"][name] for name in base} == base
    assert m8p["fixes"]["rover"]["rtk_fixed"] == 1121
    f9p = info(acquire, logs["f9p"])
    types = {t["type"]: t["frames"] for t in f9p["links"][0]["types"]}
    counts = {"RXM-RAWX": 132, "RXM-SFRBX": 1937, "NAV-HPPOSLLH": 633, "GGA": 606}
    assert {name: types[name] for name in counts} == counts
    assert f9p["fixes"]["rover"] == {"rtk_fixed": 544, "rtk_float": 62}


def test_corrections_have_the_time_of_their_description(
    shared: Path, acquire: Acquire, tmp_path: Path
) -> None:
    source = shared / "data/gnss-f9p-lossy-ubx-rtcm/20210809-111055-rtcm3-base-corrections.rtcm3"
    log = tmp_path / "base.mcap"
    done = acquire("import", "--link", f"base={source}", "-o", log)
    assert done.returncode == 0, done.stderr
    times = [m.log_time for topic, _, _, m in messages(log) if topic == "/base/raw"]
    # 15:11:34 to 15:26:00 GPS time on 2021-08-09, 18 s ahead of UTC.
    first = dt.datetime(2021, 8, 9, 15, 11, 34, tzinfo=dt.UTC).timestamp() - 18
    last = dt.datetime(2021, 8, 9, 15, 26, 0, tzinfo=dt.UTC).timestamp() - 18
    assert (min(times) / 1e9, max(times) / 1e9) == (first, last)
    assert len(times) == 4 * 867 + 5 * 87


def test_the_base_station_is_where_it_says(logs: dict[str, Path]) -> None:
    stations = [json.loads(m.data) for t, _, _, m in messages(logs["m8p"]) if t == "/gnss/base/station"]
    for source in ("1005/1006", "NAV-SVIN"):
        last = [s for s in stations if s["source"] == source][-1]
        assert (last["x_m"], last["y_m"], last["z_m"]) == pytest.approx(
            (3774089.2120, -601661.6157, 5089321.2474), abs=2e-4
        )

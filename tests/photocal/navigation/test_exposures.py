"""Exposures of recorded and simulated flights: positions, attitudes, images and their covariance."""

from __future__ import annotations

import csv
import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import enu_offsets
from photocal.block.setup import MountingKeys
from photocal.navigation.attitude import from_angles
from photocal.navigation.events import Events
from photocal.navigation.exposures import Exposures, at_camera, at_events
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.rig import CameraOnBody, rig_of_mounting
from photocal.navigation.time import GpsTime, UtcTime
from photocal.navigation.trajectory import InterpolatedPositions
from photocal.navigation.vehicle import decoded_attitude, decoded_positions, read_vehicle
from tests.photocal.conftest import Answer
from tests.photocal.navigation.conftest import ImportLog, Run

Photocal = Callable[..., Answer]
Floats = NDArray[np.float64]
ORIGIN = np.array([53.28, -8.98, 90.0])


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def stamp_images(folder: Path, utc_ns: list[int], late_s: float, model: str = "TestCam") -> None:
    """Images whose EXIF tells hundredths of seconds by a camera clock that is late."""
    folder.mkdir(exist_ok=True)
    for number, ns in enumerate(utc_ns):
        hundredths = round(ns / 1e7 - late_s * 100)
        seconds, part = divmod(hundredths, 100)
        image, exif = Image.new("L", (16, 16)), Image.Exif()
        moment = np.datetime64(seconds, "s").item()
        details = {36867: f"{moment:%Y:%m:%d %H:%M:%S}", 37521: f"{part:02d}"}
        exif._ifds[0x8769] = details
        exif[0x8769] = details
        exif[272] = model
        image.save(folder / f"{'IMG' if model == 'TestCam' else model}_{number:04d}.jpg", exif=exif)


def at_antenna(angles: Floats, covariance: Floats, angle_sigma: Floats) -> Exposures:
    n = len(angles)
    one = np.ones(n)
    placed = InterpolatedPositions(
        np.ones(n, bool), one, ORIGIN[0] * one, ORIGIN[1] * one, ORIGIN[2] * one, np.zeros((n, 3)),
        np.broadcast_to(covariance, (n, 3, 3)), np.full(n, "fixed"),
    )  # fmt: skip
    time = GpsTime.from_week(np.full(n, 2022), np.arange(n, dtype=float))
    events = Events("test", time, np.arange(n), np.zeros(n))
    return at_events(events, placed, from_angles(angles, angle_sigma), np.zeros(n), [()] * n, "ellipsoidal")


def test_lever_arm_by_hand() -> None:
    # Flying east (yaw 90 degrees), level: forward is east, right is south, down is down.
    level = np.radians([[0.0, 0.0, 90.0]])
    rig = CameraOnBody(np.array([0.5, 0.2, 0.1]), np.zeros(3), np.zeros(3))
    p = at_camera(at_antenna(level, np.eye(3) * 1e-4, np.zeros(3)), rig).placed
    moved = enu_offsets(p.lat_deg, p.lon_deg, p.height_m, ORIGIN)
    assert moved[0] == pytest.approx([-0.5, 0.2, 0.1], abs=1e-6)


def test_the_lever_arm_has_the_sign_of_blocks_and_projects() -> None:
    keys = MountingKeys(lever_arm_m=(0.1, -0.2, -0.3), boresight_deg=(1.0, 0.0, 0.0))
    rig = rig_of_mounting(keys, np.radians([1.0, 1.0, 2.0]))
    assert rig.lever_m is not None
    assert rig.lever_m.tolist() == [0.1, -0.2, -0.3]
    assert np.degrees(rig.boresight[0]) == pytest.approx(1.0)


def test_lever_arm_needs_an_attitude() -> None:
    antenna = at_antenna(np.full((3, 3), np.nan), np.eye(3), np.zeros(3))
    with pytest.raises(ConfigurationError, match="no attitude"):
        at_camera(antenna, CameraOnBody(np.ones(3), np.zeros(3), np.zeros(3)))
    with pytest.raises(ConfigurationError, match="standard deviations"):
        CameraOnBody(np.ones(3))


@pytest.mark.slow
@pytest.mark.shared
def test_moving_rover_with_images(photocal: Photocal, moving_run: Run, tmp_path: Path) -> None:
    plain = photocal("exposures", moving_run.log, "-o", tmp_path / "plain", "--json")
    assert plain.code == 0, plain.err
    rows = table(tmp_path / "plain" / "exposures.csv")
    assert len(rows) == 589
    placed = [row for row in rows if row["status"]]
    assert len(placed) >= 530
    assert all(row["note"] for row in rows if not row["status"])
    assert len(json.loads(plain.out)["not_placed"]) == 589 - len(placed)
    # Every position lies between its neighbours on the trajectory.
    stamps = moving_run.column("time_gps_ns").astype(np.int64)
    lat = moving_run.column("lat_deg")
    for row in placed[::25]:
        at = int(np.searchsorted(stamps, int(row["time_gps_ns"])))
        low, high = sorted((lat[at - 1], lat[at]))
        assert low - 3e-6 < float(row["lat_deg"]) < high + 3e-6


@pytest.mark.shared
def test_images_named_by_the_recording_computer(
    photocal: Photocal, shared: Path, import_log: ImportLog, tmp_path: Path
) -> None:
    data = shared / "data/mavlink-tlog-cuav-images"
    log = import_log("cuav", {"vehicle": data / "flight.tlog"})
    folder = tmp_path / "images"
    folder.mkdir()
    for path in data.glob("raw*.png"):
        shutil.copy(path, folder)
    answer = photocal("exposures", log, "--images", folder, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    first = table(tmp_path / "out" / "exposures.csv")[0]
    # README of the data: the position of the message 0.11 s (playback) before the image; the vehicle moved
    # on by less than a metre.
    near = np.array([-35.362304, 149.165188, float(first["height_m"])])
    lat, lon, height = (np.array([float(first[c])]) for c in ("lat_deg", "lon_deg", "height_m"))
    offset = enu_offsets(lat, lon, height, near)[0]
    assert 0.1 < np.hypot(offset[0], offset[1]) < 1.5
    # The autopilot's date, not that of the playback two months later.
    assert GpsTime(np.array([int(first["time_gps_ns"])])).iso()[0].startswith("2016-09-07")
    figures = json.loads(answer.out)
    assert "mean sea level" in figures["height"]
    # README of the data: played back at about 4.6 times the speed, unevenly.
    assert any("mostly at 4." in remark for remark in figures["remarks"])
    assert all(abs(s["rate"] - 1) < 1e-3 for s in figures["clocks"][0]["stretches"])
    assert all(row["yaw_deg"] for row in table(tmp_path / "out" / "exposures.csv"))


@pytest.mark.shared
def test_autopilot_time_orders_the_data(shared: Path, import_log: ImportLog) -> None:
    log = import_log("dronekit", {"vehicle": shared / "data/mavlink-tlog-dronekit/flight.tlog"})
    track = read_vehicle(FlightLog((log,)))
    # Of 2833 messages 150 came before the autopilot knew the date.
    assert len(track.path.time) == 2682
    assert (np.diff(track.path.time.ns) > 0).all()
    # Host less autopilot runs over two seconds: arrival would place the vehicle metres away.
    late = (track.position_host.ns - track.path.time.to_utc().ns) / 1e9
    # README of the data: from -1.82 s to +0.38 s.
    assert (late.min(), late.max()) == pytest.approx((-1.82, 0.38), abs=0.02)
    assert track.path.time[[0]].to_utc().iso()[0].startswith("2015-07-05 00:27")


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "attitudes", "day", "place"),
    [
        # ATT as pymavlink counts them; the README of the data counts 1298 attitudes of the ULog.
        ("log171.bin", 2383, "2015-11-21", (-35.36, 149.17)),
        ("sample_log_small.ulg", 1298, "2021-04-21", (63.42, 10.41)),
    ],
)
def test_logs_from_an_autopilots_card(
    shared: Path,
    import_log: ImportLog,
    name: str,
    attitudes: int,
    day: str,
    place: tuple[float, float],
) -> None:
    track = read_vehicle(FlightLog((import_log("card", {"vehicle": shared / "data/autopilot-logs" / name}),)))
    assert track.attitude is not None
    assert len(track.attitude) == attitudes
    assert track.attitude.time.to_utc().iso()[0].startswith(day)
    assert (np.median(track.path.lat_deg), np.median(track.path.lon_deg)) == pytest.approx(place, abs=0.01)
    # On the ground or in level flight: the body's down axis is down.
    assert np.median(track.attitude.rotation[:, 2, 2]) < -0.95
    assert track.clock_sigma_s > 0


@pytest.mark.shared
def test_event_list_alone(photocal: Photocal, shared: Path, tmp_path: Path) -> None:
    listed = shared / "data/rtk-mrk-gcp-helenenschacht/101FTASK_Timestamp.mrk"
    answer = photocal("exposures", "--mrk", listed, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    rows = table(tmp_path / "out" / "exposures.csv")
    assert len(rows) == 176
    assert rows[0]["lat_deg"] == "47.6436873208"
    assert (rows[0]["sn"], rows[0]["se"], rows[0]["su"]) == ("0.01439", "0.01370", "0.02969")


@pytest.mark.shared
def test_names_with_blanks_stay_names(photocal: Photocal, shared: Path, tmp_path: Path) -> None:
    """Two cameras, both with images at each event, whose names hold blanks, commas and quotation marks."""
    listed = shared / "data/rtk-mrk-gcp-helenenschacht/101FTASK_Timestamp.mrk"
    lines = [line.split("\t") for line in listed.read_text().splitlines() if line.strip()]
    gps = GpsTime.from_week([int(x[2][1:-1]) for x in lines], [float(x[1]) for x in lines])
    # As irregular as needed for a single offset.
    utc = [ns for i, ns in enumerate(gps.to_utc().ns.tolist()) if i % 7 not in (2, 3)]
    folder, out = tmp_path / "images", tmp_path / "out"
    stamp_images(folder, utc, late_s=7.4)
    stamp_images(folder, utc, late_s=3.1, model="Phone")
    for path in sorted(folder.iterdir()):
        path.rename(folder / path.name.replace("IMG_", "IMG a, b ").replace("Phone_", "- Phone "))
    wanted = {path.name for path in folder.iterdir()}
    answer = photocal(
        "exposures", "--mrk", listed, "--images", folder, "-o", out, "--crs", "EPSG:32633", "--json"
    )
    assert answer.code == 0, answer.err
    figures = json.loads(answer.out)
    assert sum(camera["matched"] for camera in figures["cameras"]) == len(wanted)
    assert "names in it end at a blank" in figures["geo_txt"]
    assert not (out / "geo.txt").exists()
    assert {row["image"] for row in table(out / "images.csv")} == wanted
    cells = [row["image"] for row in table(out / "exposures.csv") if row["image"]]
    assert all(len(json.loads(cell)) == 2 for cell in cells)
    assert {name for cell in cells for name in json.loads(cell)} == wanted
    with closing(sqlite3.connect(out / "exposures.gpkg")) as database:
        assert {name for (name,) in database.execute("SELECT name FROM exposures")} == wanted


@pytest.mark.shared
def test_images_are_matched_to_an_event_list(photocal: Photocal, shared: Path, tmp_path: Path) -> None:
    listed = shared / "data/rtk-mrk-gcp-helenenschacht/101FTASK_Timestamp.mrk"
    lines = [line.split("\t") for line in listed.read_text().splitlines() if line.strip()]
    gps = GpsTime.from_week([int(x[2][1:-1]) for x in lines], [float(x[1]) for x in lines])
    utc: UtcTime = gps.to_utc()
    # The 11th shot made no image.
    folder = tmp_path / "images"
    stamp_images(folder, [ns for i, ns in enumerate(utc.ns.tolist()) if i != 10], late_s=7.4)
    # Of the crew, by a telephone.
    stamp_images(folder, [utc.ns[5] + 600_000_000], late_s=0.0, model="Phone")
    out = tmp_path / "out"
    answer = photocal(
        "exposures", "--mrk", listed, "--images", folder, "-o", out, "--crs", "EPSG:32633", "--json"
    )
    assert answer.code == 0, answer.err
    figures = json.loads(answer.out)
    camera, telephone = figures["cameras"]
    assert telephone["unmatched_images"] == ["Phone_0000.jpg"]
    assert [f["code"] for f in figures["findings"] if "Phone" in f["text"]] == ["images-without-event"]
    assert camera["matched"] >= 170
    assert camera["clock_offset_s"] == pytest.approx(7.4, abs=0.02)
    names = [row["image"] for row in table(out / "exposures.csv")]
    expected = [f"IMG_{i:04d}.jpg" for i in range(10)] + [""] + [f"IMG_{i:04d}.jpg" for i in range(10, 175)]
    assert all(found in ("", wanted) for found, wanted in zip(names, expected, strict=True))
    images = table(out / "images.csv")
    assert len(images) == camera["matched"]
    # UTM 33: central meridian 15 degrees; height as listed.
    assert 500_000 < float(images[0]["X"]) < 700_000
    assert float(images[0]["Z"]) == pytest.approx(512.998)
    places = (out / "geo.txt").read_text().splitlines()
    assert places[0] == "EPSG:4326"
    assert len(places) == 1 + len(images)
    with closing(sqlite3.connect(out / "exposures.gpkg")) as database:
        stored = database.execute("SELECT name, sX_m FROM exposures").fetchall()
        system = database.execute("SELECT srs_id FROM gpkg_geometry_columns WHERE table_name = 'exposures'")
        assert system.fetchone() == (4326,)
    assert [name for name, _ in stored] == [row["image"] for row in images]
    # East of the topocentric frame there, of UTM here: turned by the convergence of 4 degrees.
    assert stored[0][1] == pytest.approx(float(images[0]["sX"]), abs=1e-3)


def test_nothing_to_work_with(photocal: Photocal, tmp_path: Path) -> None:
    answer = photocal("exposures", "-o", tmp_path / "out")
    assert answer.code == 5
    assert "no camera events" in answer.err
    assert not (tmp_path / "out").exists()


@pytest.mark.shared
def test_decoded_topics_say_the_same_as_raw_frames(shared: Path, import_log: ImportLog) -> None:
    log = import_log("decoded", {"vehicle": shared / "data/mavlink-tlog-cuav-images/flight.tlog"})
    raw = read_vehicle(FlightLog((log,)))
    assert raw.attitude is not None
    decoded = decoded_attitude(FlightLog((log,)), "vehicle")
    assert decoded is not None
    assert abs(len(decoded) - len(raw.attitude)) <= 2
    # By the clock model here, by the last SYSTEM_TIME there: milliseconds apart, 0.5 s between messages.
    place = np.searchsorted(decoded.time.ns, raw.attitude.time.ns[100:900] - 200_000_000)
    assert np.abs(decoded.time.ns[place] - raw.attitude.time.ns[100:900]).max() < 150_000_000
    assert np.abs(decoded.rotation[place] - raw.attitude.rotation[100:900]).max() < 1e-6
    utc, _, position = decoded_positions(FlightLog((log,)), "vehicle")
    assert len(utc) >= len(raw.path) - 2
    assert np.median(position[:, 0]) == pytest.approx(np.median(raw.path.lat_deg), abs=1e-5)

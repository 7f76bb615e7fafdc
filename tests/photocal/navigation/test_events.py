"""Time marks and event lists: time base, edges, counters, offsets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.log.chunk import Channel, Schema
from acquire.log.reader import LoggedMessages
from drivers.receiver import TimeMarks
from drivers.ubx.decode import TIM_TM2, layout
from drivers.ubx.decode import time_marks as edges_of
from photocal.base.errors import InputMalformedError
from photocal.navigation.events import (
    FALLING,
    RISING,
    listed_in,
    logged_exposures,
    read_mrk,
    time_marks,
)
from photocal.navigation.exposure_sources import events_of
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.receiver_recording import read_receivers
from photocal.navigation.time import WEEK_NS, GpsTime, HostTime
from photocal.navigation.vehicle import VehicleTrack, path_of
from tests.photocal.navigation.conftest import ImportLog, Run

NEW_RISING_UTC, NEW_FALLING_UTC = 241, 117


def marks(*rows: tuple[int, int, int, int]) -> TimeMarks:
    table: NDArray[Any] = np.zeros(len(rows), layout(TIM_TM2))
    for row, (flags, count, week, ms) in zip(table, rows, strict=True):
        row["flags"], row["count"] = flags, count
        row["wnR"] = row["wnF"] = week
        row["towMsR"] = row["towMsF"] = ms
    return edges_of(table)


def test_the_time_base_is_read() -> None:
    utc = time_marks(marks((NEW_RISING_UTC, 1, 2022, 1000)), RISING, "rover")
    gnss = time_marks(marks((NEW_RISING_UTC - 8, 1, 2022, 1000)), RISING, "rover")
    assert gnss.time == GpsTime.from_week([2022], [1.0])
    # In 2018 GPS time was 18 s ahead of UTC (IERS Bulletin C 52).
    assert (utc.time.ns - gnss.time.ns)[0] == 18_000_000_000


def test_the_receivers_own_time_is_refused() -> None:
    with pytest.raises(InputMalformedError, match="own time base"):
        time_marks(marks((NEW_RISING_UTC - 16, 1, 2022, 1000)), RISING, "rover")


def test_edges_and_counter_jumps() -> None:
    table = marks(
        (NEW_FALLING_UTC, 0, 2022, 500),
        (NEW_RISING_UTC, 1, 2022, 1000),
        (NEW_RISING_UTC | 4, 2, 2022, 3000),
        (NEW_RISING_UTC, 5, 2022, 9000),
    )
    rising = time_marks(table, RISING, "rover")
    assert rising.number.tolist() == [1, 2, 5]
    assert any("from 2 to 5, 2 missing" in r for r in rising.remarks)
    assert len(time_marks(table, FALLING, "rover")) == 2


def test_counter_runs_over() -> None:
    table = marks((NEW_RISING_UTC, 65535, 2022, 1000), (NEW_RISING_UTC, 0, 2022, 3000))
    assert not any("missing" in r for r in time_marks(table, RISING, "rover").remarks)


@pytest.mark.slow
@pytest.mark.shared
def test_moving_rover(moving_run: Run) -> None:
    recording = read_receivers(FlightLog((moving_run.log,)))["rover"]
    rising = time_marks(recording.marks(), RISING, "rover")
    assert len(rising) == 589
    assert len(time_marks(recording.marks(), FALLING, "rover")) == 589
    assert np.median(np.diff(rising.time.ns)) / 1e9 == pytest.approx(2.0, abs=0.1)
    assert any("UTC" in r for r in rising.remarks)


@pytest.mark.shared
def test_static_rover(m8p: Path, import_log: ImportLog) -> None:
    log = import_log("rover-only", {"rover": m8p / "rover-20181004-1237.ubx.gz"})
    recording = read_receivers(FlightLog((log,)))["rover"]
    # Of the seven messages three bring a rising and four a falling edge (flags, by pyubx2).
    marked = recording.marks().rising
    assert (int(marked.sum()), int((~marked).sum())) == (3, 4)
    assert (time_marks(recording.marks(), RISING, "rover").time.ns > 0).all()


@pytest.mark.shared
def test_event_list(shared: Path) -> None:
    found = read_mrk(shared / "data/rtk-mrk-gcp-helenenschacht/101FTASK_Timestamp.mrk")
    assert len(found.events) == 176
    assert (found.placed.status == "fixed").all()
    assert (found.events.time.ns // WEEK_NS == 2211).all()
    # First line by hand: 3,N 0,E 75,V mm (north, east, down) and sigmas 0.014391, 0.013698, 0.029694.
    assert found.offset_enu_m[0].tolist() == [0.0, 0.003, -0.075]
    sigma = np.sqrt(np.diag(found.placed.covariance_m2[0]))
    assert sigma == pytest.approx([0.013698, 0.014391, 0.029694])


def test_offsets_from_antenna_to_camera(tmp_path: Path) -> None:
    # By hand at the equator, 10 degrees east: 1 m north is 1/110574.276 deg of latitude (M = a (1 - e2)),
    # 2 m east 2/111319.491 deg of longitude, 3 m down lowers the height.
    path = tmp_path / "case.MRK"
    row = (
        "1\t100.5\t[2211]\t 1000,N\t 2000,E\t 3000,V\t0.0,Lat\t10.0,Lon\t100.0,Ellh\t0.01, 0.02, 0.03\t50,Q\n"
    )
    path.write_text(row)
    found = read_mrk(path)
    lat, lon, height = found.placed.moved(found.offset_enu_m).place.T
    assert lat[0] == pytest.approx(1 / 110574.276, rel=1e-4)
    assert lon[0] - 10.0 == pytest.approx(2 / 111319.491, rel=1e-4)
    assert height[0] == pytest.approx(97.0, abs=1e-5)


@pytest.mark.parametrize("line", ["1,2,3", "1\tx\t[2211]\t 3,N", "\0\0"])
def test_damaged_event_list(tmp_path: Path, line: str) -> None:
    path = tmp_path / "bad.MRK"
    path.write_text(line)
    with pytest.raises(InputMalformedError, match="line 1"):
        read_mrk(path)


class Row:
    """A message of the exposure topic."""

    def __init__(self, source: str, utc_s: float, sequence: int, **more: float) -> None:
        ns = round(utc_s * 1e9)
        self.ns = ns
        self.payload = json.dumps(
            {"source": source, "time": {"sec": ns // 10**9, "nsec": ns % 10**9}, "sequence": sequence, **more}
        ).encode()


def exposure_messages(rows: list[Row], late_ns: int) -> list[LoggedMessages]:
    channel = Channel("/camera/exposure", "json", Schema("photocal.Exposure", "jsonschema", b"{}"), {})
    stamps = np.array([row.ns for row in rows], np.int64)
    payloads = [row.payload for row in rows]
    return [LoggedMessages(channel, payloads, stamps + late_ns, stamps, np.arange(len(rows)))]


def test_events_of_autopilot_logs(monkeypatch: pytest.MonkeyPatch) -> None:
    # Logs from a memory card have no time of receipt: it repeats the device's.
    rows = [Row("CAM", 1.6e9 + k, k, latitude_deg=-22.0, altitude_msl_m=50.0 + k) for k in (3, 1, 2)]
    rows += [Row("TRIG", 1.6e9 + k - 0.1, k) for k in range(4)]
    monkeypatch.setattr(FlightLog, "_messages", exposure_messages(rows, 0))
    none, empty = np.empty(0, np.int64), np.empty(0)
    vehicle = VehicleTrack(path_of(GpsTime(none), (empty,) * 3), HostTime(none), None, 0.007)
    best = events_of(Sources(), "rising", {}, vehicle)
    assert best is not None
    assert (best.source, len(best)) == ("CAM", 3)
    assert best.number.tolist() == [1, 2, 3]
    assert best.accuracy_s == pytest.approx([0.007] * 3)
    assert best.claimed is not None
    assert best.claimed[:, 2].tolist() == [51.0, 52.0, 53.0]
    assert np.isnan(best.claimed[:, 1]).all()


def test_exposures_without_a_device_time_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [Row("CAMERA_FEEDBACK", 1.6e9 + k, k) for k in range(3)]
    twice = exposure_messages(rows, 50_000_000) * 2
    monkeypatch.setattr(FlightLog, "_messages", twice)
    best = events_of(Sources(), "rising", {}, None)
    assert best is not None
    # The same exposures came over two links.
    assert len(best) == 3
    monkeypatch.setattr(FlightLog, "_messages", exposure_messages(rows, 0))
    found = logged_exposures(FlightLog())[0][0]
    assert len(found) == 0
    assert found.remarks == ["CAMERA_FEEDBACK: 3 exposures without a device time left out"]


@pytest.mark.shared
def test_an_imported_event_list_is_the_same(shared: Path, import_log: ImportLog) -> None:
    path = shared / "data/rtk-mrk-gcp-helenenschacht/101FTASK_Timestamp.mrk"
    log = import_log("listed", {"drone": path})
    listed, read = listed_in(FlightLog((log,))), read_mrk(path)
    assert listed is not None
    assert len(listed.events) == 176
    assert np.array_equal(listed.events.time.ns, read.events.time.ns)
    assert np.array_equal(listed.offset_enu_m, read.offset_enu_m)

"""UBX, RTCM3 and NMEA messages against pyubx2, pyrtcm and pynmeagps, and GNSS time against known dates."""

from __future__ import annotations

import datetime as dt
import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pynmeagps import NMEAReader
from pyrtcm import RTCMReader
from pyubx2 import UBXMessage, UBXReader

from drivers import nmea, rtcm3
from drivers.frames import GNSS, Batch, StreamFramer, Wire
from drivers.ubx import decode as ubx
from photocal.base.time_scales import (
    EXPIRES,
    GPS_EPOCH_NS,
    expiry_warning,
    gps_to_utc_ns,
    utc_date_ns,
    week_to_ns,
)


def framed(data: bytes) -> Batch:
    framer = StreamFramer(GNSS)
    batch = framer.feed(data)
    framer.close()
    return batch


@pytest.fixture(scope="session")
def rover(shared: Path) -> Batch:
    path = shared / "data/gnss-ubx-m8p-base-rover/rover-20181009-1221.ubx.gz"
    return framed(gzip.decompress(path.read_bytes())[:300_000])


@pytest.mark.shared
def test_raw_observations_are_those_of_pyubx2(rover: Batch) -> None:
    ours = ubx.decode_rawx(rover)
    names = [("prMes", "prMes"), ("cpMes", "cpMes"), ("doMes", "doMes"), ("svId", "svId"), ("cno", "cno")]
    names += [("gnssId", "gnssId"), ("locktime", "locktime"), ("freqId", "freqId")]
    assert len(ours) > 50
    for row in range(0, len(ours), 10):
        frame = rover.frame(int(ours.index[row]))
        theirs = UBXReader.parse(frame.data)
        assert ours.fields["rcvTow"][row] == theirs.rcvTow
        assert ours.fields["week"][row] == theirs.week
        # Behind head and epoch, before the check sum.
        signals = np.frombuffer(frame.data[22:-2], ubx.signal_layout())
        assert len(signals) == theirs.numMeas
        for number, signal in enumerate(signals, start=1):
            for mine, other in names:
                assert signal[mine] == getattr(theirs, f"{other}_{number:02d}")


def test_the_age_of_corrections_is_the_class_that_the_receiver_tells() -> None:
    """u-blox, F9 HPG 1.32 interface description, NAV-PVT: class 3 is 2 s to 5 s, 12 is 120 s on."""
    told = {0: np.nan, 1: 1.0, 3: 5.0, 7: 30.0, 11: 120.0, 12: np.inf, 15: np.inf}
    sent = [UBXMessage("NAV", "NAV-PVT", 0, lastCorrectionAge=k, invalidLlh=1, validDate=1) for k in told]
    found = ubx.decode(framed(b"".join(message.serialize() for message in sent)), ubx.NAV_PVT)
    np.testing.assert_array_equal(ubx.correction_age_s(found.fields), list(told.values()))


@pytest.mark.parametrize(
    ("lat", "lon"), [(-22.7123456, -43.2000001), (0.0, 179.99999999), (89.5, -0.0000002)]
)
def test_a_made_gga_is_what_pynmeagps_reads(lat: float, lon: float) -> None:
    told = NMEAReader.parse(nmea.gga(1_777_626_059_990_000_000, lat, lon, -12.5, 5, 7, 1.24))
    assert (told.lat, told.lon) == pytest.approx((lat, lon), abs=2e-9)
    assert (told.alt, told.quality, told.numSV, told.HDOP) == (-12.5, 5, 7, 1.2)
    moment = dt.datetime.fromtimestamp(1_777_626_059.99, dt.UTC).time()
    assert abs(told.time.microsecond - moment.microsecond) <= 1
    assert told.time.replace(microsecond=0) == moment.replace(microsecond=0)


@pytest.mark.shared
def test_time_marks_are_those_of_pyubx2(rover: Batch) -> None:
    ours = ubx.decode(rover, ubx.TIM_TM2)
    assert len(ours) > 20
    for row, index in enumerate(ours.index.tolist()):
        theirs = UBXReader.parse(rover.frame(index).data)
        for name in ("count", "wnR", "towMsR", "towSubMsR", "wnF", "towMsF", "accEst"):
            assert ours.fields[name][row] == getattr(theirs, name)


@pytest.mark.parametrize(
    ("kind", "identity", "values"),
    [
        (ubx.NAV_PVT, "NAV-PVT", {"iTOW": 1000, "year": 2024, "lat": 47.5, "lon": 8.25, "height": -12345}),
        (ubx.NAV_SVIN, "NAV-SVIN", {"iTOW": 5, "meanX": -377408921, "meanAcc": 13375, "valid": 1, "obs": 60}),
        (ubx.NAV_TIMEGPS, "NAV-TIMEGPS", {"iTOW": 7, "fTOW": -12, "week": 2170, "leapS": 18}),
        (ubx.NAV_TIMEUTC, "NAV-TIMEUTC", {"iTOW": 7, "year": 2021, "month": 8, "day": 9, "nano": -5}),
        (ubx.NAV_POSLLH, "NAV-POSLLH", {"iTOW": 7, "height": 5000, "hMSL": 4000, "vAcc": 3}),
    ],
)  # fmt: skip
def test_messages_that_pyubx2_makes_are_read(kind: int, identity: str, values: dict[str, int]) -> None:
    message = UBXMessage("NAV", identity, 0, **values)
    found = ubx.decode(framed(message.serialize()), kind)
    assert len(found) == 1
    scale = {"lat": 1e-7, "lon": 1e-7}
    for name, value in values.items():
        assert found.fields[name][0] * scale.get(name, 1) == pytest.approx(value), name


@pytest.mark.shared
def test_high_precision_positions_are_those_of_pyubx2(shared: Path) -> None:
    path = shared / "data/gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx"
    batch = framed(path.read_bytes()[:300_000])
    ours = ubx.decode(batch, ubx.NAV_HPPOSLLH)
    assert len(ours) > 20
    for row, index in enumerate(ours.index.tolist()):
        theirs = UBXReader.parse(batch.frame(index).data)
        latitude = ours.fields["lat"][row] * 1e-7 + ours.fields["_HPlat"][row] * 1e-9
        assert latitude == pytest.approx(theirs.lat, abs=2e-9)
        assert ours.fields["iTOW"][row] == theirs.iTOW


@pytest.mark.shared
def test_reference_stations_are_those_of_pyrtcm_and_of_the_description(shared: Path) -> None:
    folder = shared / "data/gnss-f9p-lossy-ubx-rtcm"
    batch = framed((folder / "20210809-111055-rtcm3-base-corrections.rtcm3").read_bytes())
    ours = rtcm3.decode_stations(batch)
    assert len(ours.index) == 87
    # The description has the last digit of Z one higher than pyrtcm reads it.
    assert ours["ecef_m"][0] == pytest.approx([2078678.9505, -5683737.4210, 2006886.9707], abs=1.1e-4)
    assert ours["antenna_height_m"][0] == pytest.approx(0.1299, abs=5e-5)
    theirs = RTCMReader.parse(batch.frame(int(ours.index[0])).data)
    assert ours["ecef_m"][0] == pytest.approx([theirs.DF025, theirs.DF026, theirs.DF027], abs=1e-6)
    assert ours["station"][0] == theirs.DF003


@pytest.mark.shared
def test_positions_of_sentences_are_those_of_pynmeagps(rover: Batch) -> None:
    ours, (_, of_day_ns) = nmea.decode_gga(rover), nmea.decode_gga_times(rover)
    # NMEA 0183, GGA, field 6.
    fixes = {0: "none", 1: "3d", 2: "differential", 4: "rtk_fixed", 5: "rtk_float"}
    assert len(ours.index) > 50
    for row, index in enumerate(ours.index.tolist()):
        theirs = NMEAReader.parse(rover.frame(index).data)
        assert ours.latitude_deg[row] == pytest.approx(theirs.lat, abs=1e-9)
        assert ours.longitude_deg[row] == pytest.approx(theirs.lon, abs=1e-9)
        assert ours.height_m[row] == pytest.approx(theirs.alt + theirs.sep)
        assert ours.fix[row] == fixes[theirs.quality]
        since = dt.datetime.combine(dt.date.min, theirs.time) - dt.datetime.min
        assert of_day_ns[row] == since / dt.timedelta(microseconds=1) * 1000


def test_empty_sentences_have_no_position() -> None:
    batch = framed(nmea.encode("GNGGA,,,,,,0,00,99.99,,,,,,") + nmea.encode("GNRMC,,V,,,,,,,,,,N"))
    fixes = nmea.decode_gga(batch)
    assert (fixes.fix.tolist(), fixes.valid.tolist()) == (["none"], [False])
    assert np.isnan([fixes.latitude_deg[0], fixes.height_m[0]]).all()
    assert len(nmea.decode_times(batch)[0]) == 0


@given(st.dates(dt.date(1980, 1, 6), dt.date(2199, 12, 31)))
def test_dates_are_those_of_the_calendar(day: dt.date) -> None:
    expected = int(dt.datetime(day.year, day.month, day.day, tzinfo=dt.UTC).timestamp()) * 10**9
    assert int(utc_date_ns(day.year, day.month, day.day)) == expected


@pytest.mark.parametrize(
    ("week", "seconds", "utc"),
    [
        # The roll-over of the GPS week, 1999-08-21 23:59:47 UTC (GPS minus UTC was 13 s).
        (1024, 0.0, "1999-08-21T23:59:47"),
        # Second roll-over, 2019-04-06 23:59:42 UTC (18 s).
        (2048, 0.0, "2019-04-06T23:59:42"),
        # The first second after the leap second at the end of 2016.
        (1930, 18.0, "2017-01-01T00:00:00"),
        (1930, 15.0, "2016-12-31T23:59:58"),
    ],
)
def test_gps_weeks_are_the_known_dates(week: int, seconds: float, utc: str) -> None:
    expected = int(dt.datetime.fromisoformat(utc + "+00:00").timestamp()) * 10**9
    assert gps_to_utc_ns(week_to_ns([week], [seconds])).tolist() == [expected]


def test_the_leap_seconds_that_the_receiver_tells_come_first() -> None:
    gps = week_to_ns([2300, 2300], [0.0, 0.0])
    told = gps_to_utc_ns(gps, np.array([19, -1]))
    assert (told - gps - GPS_EPOCH_NS).tolist() == [-19 * 10**9, -18 * 10**9]


def test_kinds_have_the_names_of_their_protocol() -> None:
    assert nmea.kind_name(nmea.kind_of(b"GNGGA,12")) == "GGA"
    assert nmea.kind_name(nmea.kind_of(b"PUBX,00,")) == "PUBX"
    assert ubx.kind_name(0x0215) == "RXM-RAWX"
    assert ubx.kind_name(0x7F01) == "7F-01"
    assert Wire.RTCM3.encoding == "rtcm3"


def test_the_table_of_leap_seconds_knows_its_end() -> None:
    end_ns = int(dt.datetime.combine(EXPIRES, dt.time(), dt.UTC).timestamp()) * 1_000_000_000
    assert not expiry_warning(end_ns - 1)
    assert EXPIRES.isoformat() in expiry_warning(end_ns)

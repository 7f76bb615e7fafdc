"""Every frame is read by our own reader, pyubx2, pyrtcm and RTKLIB, and says what was measured."""

from __future__ import annotations

from collections import Counter
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyrtcm
import pytest
import pyubx2

from acquire.simulate.gnss import navigation_messages
from acquire.simulate.gnss.msm import lock_indicator
from acquire.simulate.gnss.observations import SatelliteObservations
from acquire.simulate.gnss.settings import SkySettings
from drivers.frames import GNSS, StreamFramer, Wire
from drivers.ubx.decode import RXM_SFRBX
from tests.acquire.simulate.gnss.flights import BASE_M, DURATION_S, SECOND, START, Flight, Times
from tests.acquire.simulate.gnss.rtklib import Rinex, to_rinex

LIGHT_MS = 299_792.458
EPOCHS = 5 * DURATION_S + 1
Frames = dict[str, list[Any]]


@pytest.fixture(scope="module")
def rover(flight: Flight) -> Frames:
    return ubx(flight.rover.data)


def ubx(data: bytes) -> Frames:
    found: Frames = {}
    reader = pyubx2.UBXReader(BytesIO(data), protfilter=2, validate=pyubx2.VALCKSUM, quitonerror=2)
    for _, message in reader:
        found.setdefault(message.identity, []).append(message)
    return found


@pytest.fixture(scope="module")
def rtcm(flight: Flight) -> Frames:
    found: Frames = {}
    for _, message in pyrtcm.RTCMReader(BytesIO(flight.base_rtcm.data), validate=1, quitonerror=2):
        found.setdefault(message.identity, []).append(message)
    return found


def test_our_reader_finds_no_damage(flight: Flight) -> None:
    for stream in (flight.rover, flight.base_ubx, flight.base_rtcm):
        framer = StreamFramer(GNSS)
        for batch in (framer.feed(stream.data), framer.close()):
            assert len(batch.damage) == 0
            assert batch.known.all()
            if len(batch):
                assert len(batch) == len(stream.frames) == len(stream.time_gps_ns)
        assert np.all(np.diff(stream.time_gps_ns) >= 0)


def test_all_messages_are_there(rover: Frames, flight: Flight, rtcm: Frames) -> None:
    assert set(rover) == {"RXM-RAWX", "RXM-SFRBX", "NAV-PVT", "TIM-TM2"}
    assert len(rover["RXM-RAWX"]) == len(rover["NAV-PVT"]) == EPOCHS
    assert sum(map(len, rover.values())) == len(flight.rover.frames)
    base = ubx(flight.base_ubx.data)
    assert set(base) == {"RXM-RAWX", "RXM-SFRBX", "NAV-SVIN"}
    assert len(base["RXM-RAWX"]) == len(base["NAV-SVIN"]) == DURATION_S + 1
    assert set(rtcm) == {"1006", "1013", "1019", "1046", "1077", "1097"}
    assert len(rtcm["1077"]) == len(rtcm["1097"]) == DURATION_S + 1
    assert sum(map(len, rtcm.values())) == len(flight.base_rtcm.frames)


def test_rawx_says_what_was_measured(rover: Frames, flight: Flight) -> None:
    observations = flight.session.rover
    rows = observations.rows
    for epoch in (0, 301, EPOCHS - 1):
        message = rover["RXM-RAWX"][epoch]
        here = rows[rows["epoch"] == epoch]
        assert message.numMeas == len(here)
        assert (
            message.week * 604_800 * SECOND + round(message.rcvTow * 1e9)
            == observations.clock.tag_gps_ns[epoch]
        )
        for k, row in enumerate(here, 1):
            truth = observations.satellites[row["satellite"]].truth
            got = {name: getattr(message, f"{name}_{k:02d}") for name in ("gnssId", "svId", "prMes", "cpMes")}
            assert (got["gnssId"], got["svId"]) == ({"G": 0, "E": 2}[truth.system], truth.number)
            assert (got["prMes"], got["cpMes"]) == (row["code_m"], row["phase_cycles"])
            assert getattr(message, f"doMes_{k:02d}") == pytest.approx(row["doppler_hz"], abs=1e-3)
            assert getattr(message, f"locktime_{k:02d}") == min(int(row["lock_s"] * 1e3), 64_500)


def test_own_position_is_near_the_truth(rover: Frames, flight: Flight) -> None:
    place = flight.session.rover.place
    for epoch in (0, 200, EPOCHS - 1):
        pvt = rover["NAV-PVT"][epoch]
        assert abs(pvt.lat - np.degrees(place.lat[epoch])) * 111e3 < 5
        assert abs(pvt.lon - np.degrees(place.lon[epoch])) * 111e3 < 5
        assert abs(pvt.height / 1e3 - place.height_m[epoch]) < 8
        assert np.hypot(pvt.velN, pvt.velE) / 1e3 == pytest.approx(9.8, abs=0.3)
        assert (pvt.fixType, pvt.gnssFixOk, pvt.validDate, pvt.validTime) == (3, 1, 1, 1)
        assert pvt.numSV == len(
            set(flight.session.rover.rows["satellite"][flight.session.rover.rows["epoch"] == epoch])
        )
        assert 0.8 < pvt.pDOP < 3
        # UTC is 18 s behind; the time is that of the measurement, not of the receiver's clock.
        seconds = pvt.hour * 3600 + pvt.min * 60 + pvt.second + pvt.nano * 1e-9
        truth = flight.session.rover.clock.true_gps_ns[epoch] % (86_400 * SECOND) / 1e9 - 18
        assert seconds == pytest.approx(truth, abs=1e-8)


def test_base_announces_its_position(flight: Flight, rtcm: Frames) -> None:
    station = rtcm["1006"][0]
    assert np.allclose([station.DF025, station.DF026, station.DF027], BASE_M, atol=1e-4)
    survey = ubx(flight.base_ubx.data)["NAV-SVIN"][0]
    mean = [getattr(survey, f"mean{a}") / 1e2 + getattr(survey, f"mean{a}HP") / 1e4 for a in "XYZ"]
    assert np.allclose(mean, BASE_M, atol=1e-4)
    assert survey.valid == 1
    date = rtcm["1013"][0]
    # 2025-06-15 is day 60 841 of the modified Julian count.
    assert (date.DF051, date.DF052) == (60_841, 13 * 3600 + 15 * 60 + 20 - 18)


SECOND_BAND = {"1077": 1227.60e6, "1097": 1207.14e6}


@pytest.mark.parametrize("kind", ["1077", "1097"])
def test_msm_says_what_was_measured(kind: str, rtcm: Frames, flight: Flight) -> None:
    """Pseudorange, phase and range rate put together as the standard says (10403.3, section 3.5.12.3)."""
    for epoch in (0, DURATION_S):
        message = rtcm[kind][epoch]
        here = by_name(flight.session.base, epoch, "G" if kind == "1077" else "E")
        satellites = {getattr(message, f"PRN_{k:02d}"): k for k in range(1, message.NSat + 1)}
        assert message.NCell == len(here)
        for k in range(1, message.NCell + 1):
            number, code = getattr(message, f"CELLPRN_{k:02d}"), getattr(message, f"CELLSIG_{k:02d}")
            assert code in ("1C", "2L", "7Q")
            s, first = satellites[number], code == "1C"
            row = here[int(number), 0 if first else 1]
            part = {name: getattr(message, f"DF{name}_{k:02d}") for name in (404, 405, 406, 420)}
            rough = getattr(message, f"DF397_{s:02d}") + getattr(message, f"DF398_{s:02d}")
            wavelength = LIGHT_MS * 1e3 / (1575.42e6 if first else SECOND_BAND[kind])
            phase = row["phase_cycles"] * wavelength
            assert (rough + part[405]) * LIGHT_MS == pytest.approx(row["code_m"], abs=4e-4)
            assert (rough + part[406]) * LIGHT_MS == pytest.approx(phase, abs=1e-4)
            rate = getattr(message, f"DF399_{s:02d}") + part[404]
            assert rate == pytest.approx(-row["doppler_hz"] * wavelength, abs=1e-4)
            assert part[420] == (not row["half_valid"])


def by_name(observations: SatelliteObservations, epoch: int, system: str) -> dict[tuple[int, int], Any]:
    """Rows of an epoch by satellite number and signal."""
    found = {}
    for row in observations.rows[observations.rows["epoch"] == epoch]:
        truth = observations.satellites[row["satellite"]].truth
        if truth.system == system:
            found[truth.number, int(row["signal"])] = row
    return found


# RTCM 10403.3, table 3.5-76: least lock time (ms) of some indicators.
LOCK_TIMES = {
    0: 0,
    63: 63,
    64: 64,
    65: 64,
    126: 95,
    128: 96,
    255: 127,
    256: 128,
    511: 159,
    524_288: 480,
    67_108_864: 704,
    10**9: 704,
}


@pytest.mark.parametrize(("milliseconds", "indicator"), LOCK_TIMES.items())
def test_lock_time_indicator(milliseconds: int, indicator: int) -> None:
    assert lock_indicator(milliseconds) == indicator


def test_words_of_a_real_receiver_are_made_again(shared: Path) -> None:
    """182 subframes that an F9P handed over: parity and the bits in front of each word."""
    data = (shared / "data/gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx").read_bytes()
    framer = StreamFramer((Wire.UBX,))
    count = 0
    for batch in (framer.feed(data), framer.close()):
        for at in batch.where(Wire.UBX, RXM_SFRBX).tolist():
            payload = batch.data[batch.start[at] + 6 : batch.start[at] + batch.length[at] - 2]
            if payload[0] != 0 or payload[2] != 0:
                continue
            words = np.frombuffer(payload[8:48], "<u4").tolist()
            bits = [format(word >> 6 & 0xFF_FFFF, "024b") for word in words]
            bits[1], bits[9] = bits[1][:22], bits[9][:22]
            assert navigation_messages.with_parity(bits) == words
            count += 1
    assert count == 182


def crc24q(bits: str) -> int:
    """Long division by the generator, bit by bit."""
    register = int(bits + "0" * 24, 2)
    for shift in range(len(bits) - 1, -1, -1):
        if register >> shift + 24 & 1:
            register ^= 0x1864CFB << shift
    return register


def test_galileo_pages(flight: Flight) -> None:
    truths = [s.truth for s in flight.session.satellites if s.system == "E"]
    kinds: Counter[tuple[str, int]] = Counter()
    for band, shift in (("E1B", 1), ("E5b", 0)):
        for k in range(15):
            words = navigation_messages.page(
                truths[0], START // SECOND + shift + 2 * k + 10, band, 18, truths
            )
            bits = "".join(format(word, "032b") for word in words[:8])
            even, odd = bits[:128], bits[128:]
            assert (even[:2], odd[:2]) == ("00", "10")
            assert even[114:] == "0" * 14
            assert crc24q(even[:114] + odd[:82]) == int(odd[82:106], 2)
            kinds[band, int(even[2:8], 2)] += 1
    assert all(kinds[band, kind] == 1 for band in ("E1B", "E5b") for kind in range(1, 7))


def test_rtklib_reads_the_ionosphere_and_leap_seconds(flight: Flight, tmp_path: Path) -> None:
    header = to_rinex(flight, tmp_path, "-oi", "-ol").navigation.read_text().split("END OF HEADER")[0]
    lines = {line[:4]: line for line in header.splitlines() if line[60:].startswith("IONOSPHERIC")}
    scales = [2.0**p for p in (-30, -27, -24, -24, 11, 14, 16, 16)]
    wanted = [value * scale for value, scale in zip(SkySettings().klobuchar, scales, strict=True)]
    for name, part in (("GPSA", wanted[:4]), ("GPSB", wanted[4:])):
        numbers = [float(lines[name][5 + 12 * k : 17 + 12 * k].replace("D", "e")) for k in range(4)]
        assert numbers == pytest.approx(part, rel=1e-3)
    assert [line[:6].strip() for line in header.splitlines() if line[60:].startswith("LEAP")] == ["18"]


def test_rtklib_reads_every_epoch_and_signal(rinex: Rinex, flight: Flight) -> None:
    for file, observations in (
        (rinex.rover, flight.session.rover),
        (rinex.base_of_rtcm, flight.session.base),
    ):
        lines = file.read_text().split("END OF HEADER")[1].splitlines()[1:]
        assert sum(line.startswith(">") for line in lines) == len(observations.clock)
        phases = sum(bool(line[at : at + 14].strip()) for line in lines if line[0] in "GE" for at in (19, 83))
        assert phases == int(observations.rows["has_phase"].sum())


def stamps(frames: list[Any], edge: str) -> Times:
    found = []
    for m in frames:
        week, milliseconds, rest = (getattr(m, name + edge) for name in ("wn", "towMs", "towSubMs"))
        found.append(week * 604_800 * SECOND + milliseconds * 1_000_000 + rest)
    return np.array(found, np.int64)


def test_time_marks_are_the_pulses(rover: Frames, flight: Flight) -> None:
    marks = rover["TIM-TM2"]
    rising = [m for m in marks if m.newRisingEdge]
    falling = [m for m in marks if m.newFallingEdge]
    assert np.abs(stamps(rising, "R") - flight.events.rising_gps_ns).max() < 120
    assert np.abs(stamps(falling, "F") - flight.events.falling_gps_ns).max() < 120
    assert np.std(stamps(rising, "R") - flight.events.rising_gps_ns) > 5
    assert [m.count for m in rising] == list(range(1, len(rising) + 1))
    assert {(m.timeBase, m.time, m.accEst) for m in marks} == {(1, 1, 20)}

"""Files as people have them: compressed, RINEX 4, epochs of 1980, raw files under other names."""

from __future__ import annotations

import gzip
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from drivers.frames import Wire
from drivers.rtcm3 import encode
from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError
from photocal.base.time_scales import GPS_EPOCH_NS
from photocal.navigation import rinex_files
from photocal.navigation.precise_results import count_ephemerides, read_observation_file
from photocal.navigation.rinex_files import (
    form_of,
    frames_of,
    navigation_ready,
    observations_ready,
    rtcm3_time,
    unpacked,
)
from photocal.navigation.time import GpsTime
from tests.conftest import needs_engine


def day(text: str) -> GpsTime:
    """Midnight of a day."""
    ns = int((np.datetime64(text) - np.datetime64("1970-01-01")) / np.timedelta64(1, "ns"))
    return GpsTime(np.array([ns - GPS_EPOCH_NS], np.int64))


TODAY = day("2026-11-24T00:00:00")


@pytest.mark.shared
def test_plain_rinex_stays_where_it_is(shared: Path, tmp_path: Path) -> None:
    data = shared / "data/gnss-rinex-static-known"
    assert observations_ready(data / "base.obs", tmp_path / "a", TODAY).path == data / "base.obs"
    assert navigation_ready(data / "base.nav", tmp_path / "n") == (data / "base.nav",)


@pytest.mark.shared
def test_packed_rinex_is_unpacked(shared: Path, tmp_path: Path) -> None:
    plain = (shared / "data/gnss-rinex-static-known/base.obs").read_bytes()
    (tmp_path / "base.obs.gz").write_bytes(gzip.compress(plain))
    with zipfile.ZipFile(tmp_path / "base.zip", "w") as archive:
        archive.writestr("base.24o", plain)
    for name in ("base.obs.gz", "base.zip"):
        ready = observations_ready(tmp_path / name, tmp_path / "made", TODAY)
        assert ready.path.read_bytes() == plain
    (tmp_path / "cut.gz").write_bytes(gzip.compress(plain)[:-20])
    with pytest.raises(InputMalformedError, match="cannot be unpacked"):
        observations_ready(tmp_path / "cut.gz", tmp_path / "made", TODAY)


@pytest.mark.shared
def test_an_archive_of_a_station_has_observations_and_ephemerides(shared: Path, tmp_path: Path) -> None:
    """As archives of reference stations hand out a day: one file of observations, ephemerides by system."""
    data = shared / "data/gnss-rinex-static-known"
    observed, orbits = (data / "base.obs").read_bytes(), (data / "base.nav").read_bytes()
    path = tmp_path / "ppte1761.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("ppte1761.24g", orbits)
        archive.writestr("ppte1761.24n", orbits)
        archive.writestr("ppte1761.24o", observed)
        archive.writestr("leia-me.txt", "RBMC")
    ready = observations_ready(path, tmp_path / "made", TODAY)
    assert ready.path.read_bytes() == observed
    assert [one.read_bytes() for one in ready.navigation] == [orbits, orbits]
    assert len({ready.path, *ready.navigation}) == 3
    assert [one.read_bytes() for one in navigation_ready(path, tmp_path / "n")] == [orbits, orbits]
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("ppte1761a.24o", observed)
    with pytest.raises(InputMalformedError, match="has 5 files"):
        observations_ready(path, tmp_path / "made", TODAY)
    alone = tmp_path / "alone.zip"
    with zipfile.ZipFile(alone, "w") as archive:
        archive.writestr("a.24o", observed)
        archive.writestr("b.txt", "RBMC")
    assert observations_ready(alone, tmp_path / "made", TODAY).navigation == ()
    with pytest.raises(IllPosedError, match="no ephemerides"):
        navigation_ready(alone, tmp_path / "n")


@pytest.mark.parametrize("kind", ["gz", "zip"])
def test_damaged_packing_is_refused_wherever_it_is_damaged(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    plain = rng.integers(48, 58, 3000, np.uint8).tobytes()
    whole = tmp_path / "whole"
    if kind == "gz":
        whole.write_bytes(gzip.compress(plain))
    else:
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("site.obs", plain)
    path = tmp_path / f"site.obs.{kind}"
    for place in range(4, whole.stat().st_size, 7):
        spoilt = bytearray(whole.read_bytes())
        spoilt[place : place + 3] = rng.bytes(3)
        path.write_bytes(spoilt)
        # Some bytes matter to nobody; then it is no RINEX file.
        with pytest.raises(InputMalformedError):
            observations_ready(path, tmp_path / "out", TODAY)


@pytest.mark.parametrize("kind", ["gz", "zip"])
def test_what_grows_without_end_is_refused(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rinex_files, "_MOST_BYTES", 1 << 20)
    path, plain = tmp_path / f"site.obs.{kind}", bytes(1 << 21)
    if kind == "gz":
        path.write_bytes(gzip.compress(plain))
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("site.obs", plain)
    with pytest.raises(InputMalformedError, match="longer than"):
        observations_ready(path, tmp_path / "out", TODAY)


@pytest.mark.shared
def test_hatanakas_compression_by_the_program_of_its_author(shared: Path, tmp_path: Path) -> None:
    """What rnx2crx, Hatanaka's own program, has packed is the same file again."""
    hatanaka = pytest.importorskip("hatanaka", reason='the extra "rinex" is not installed')
    plain = (shared / "data/gnss-rinex-static-known/rover.obs").read_bytes()
    packed = hatanaka.rnx2crx(plain)
    assert b"CRINEX" in packed[:100]
    short = plain.replace(b" 0.", b"  .").replace(b"-0.", b" -.")
    for name, content in {"r.crx": packed, "r.crx.gz": gzip.compress(packed)}.items():
        (tmp_path / name).write_bytes(content)
        ready = observations_ready(tmp_path / name, tmp_path / "made", TODAY)
        # The program leaves out a zero before the point.
        assert (
            ready.path.read_bytes().replace(b" 0.", b"  .").replace(b"-0.", b" -.").split() == short.split()
        )


def test_without_the_package_the_remedy_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "hatanaka", None)
    with pytest.raises(ConfigurationError, match="hatanaka"):
        unpacked(
            b"3.0                 COMPACT RINEX FORMAT                    CRINEX VERS   / TYPE\n", tmp_path
        )


@pytest.mark.shared
def test_first_epochs_of_1980_are_left_out_and_counted(shared: Path, tmp_path: Path) -> None:
    plain = (shared / "data/gnss-rinex-static-known/rover.obs").read_text()
    head, body = plain.split("END OF HEADER       \n")
    early = body.replace("> 2024 06 24", "> 1980 01 06")
    first = "> " + early.split("> ")[1]
    path = tmp_path / "rover.obs"
    path.write_text(f"{head}END OF HEADER       \n{first}{first}{body}")
    ready = observations_ready(path, tmp_path / "made", TODAY)
    assert "2 first epochs of 1980" in ready.remarks[0]
    assert ready.path.read_text() == plain
    assert path.read_text() != plain


def as_rinex_4(lines: list[str]) -> str:
    """RINEX 3 ephemerides as version 4 writes them (Gini 2021, section 8.3): a line before each record."""
    end = next(k for k, line in enumerate(lines) if "END OF HEADER" in line)
    kinds = {"G": "LNAV", "J": "LNAV", "R": "FDMA", "E": "INAV", "C": "D1", "S": "SBAS", "I": "LNAV"}
    head = [line for line in lines[:end] if line[:4] in ("GPSA", "GPSB")]
    a, b = ([float(line[5 + 12 * k : 17 + 12 * k]) for k in range(4)] for line in head)
    made = [f"{'     4.00           N: GNSS NAV DATA    M: MIXED':60}RINEX VERSION / TYPE", lines[end]]
    made += ["> ION G01 LNAV", "    2024 06 24 10 00 00" + in_columns(a[:3])]
    made += ["    " + in_columns([a[3], *b[:3]]), "    " + in_columns([b[3], 0.0])]
    starts = [k for k in range(end + 1, len(lines)) if lines[k][0] in kinds]
    for first, last in zip(starts, [*starts[1:], len(lines)], strict=True):
        # A record of a kind that RINEX 3 has not stands between.
        made += ["> STO G01 LNAV", "    2024 06 24 10 00 00 GPUT", "     0.0"]
        made += [f"> EPH {lines[first][:3]} {kinds[lines[first][0]]}", *lines[first:last]]
        if lines[first][0] == "R":
            # The fourth line of GLONASS, new in version 3.05.
            made.append("    " + in_columns([179.0, 0.0, 0.0, 0.0]))
    return "\n".join(made) + "\n"


def in_columns(values: list[float]) -> str:
    """Numbers of 19 columns."""
    return "".join(f"{value:19.12E}" for value in values)


@pytest.mark.shared
def test_rinex_4_ephemerides_are_those_of_rinex_3(shared: Path, tmp_path: Path) -> None:
    source = shared / "data/gnss-rinex-static-known/base.nav"
    lines = source.read_text().splitlines()
    path = tmp_path / "base_4.nav"
    path.write_text(as_rinex_4(lines))
    (ready,) = navigation_ready(path, tmp_path / "made")
    assert count_ephemerides(ready) == count_ephemerides(source) > 10
    end = next(k for k, line in enumerate(lines) if "END OF HEADER" in line)
    made = ready.read_text().splitlines()
    assert made[next(k for k, line in enumerate(made) if "END OF HEADER" in line) + 1 :] == lines[end + 1 :]
    # The ionosphere of GPS stays in the head, where the engine looks for it.
    for name in ("GPSA", "GPSB"):
        old, new = (next(line for line in text if line.startswith(name)) for text in (lines, made))
        assert [float(new[5 + 12 * k : 17 + 12 * k]) for k in range(4)] == pytest.approx(
            [float(old[5 + 12 * k : 17 + 12 * k]) for k in range(4)], rel=1e-4
        )


@pytest.mark.shared
@pytest.mark.parametrize("name", ["PPKRAW.bin", "DJI_001_PPKRAW.rtk", "RTK001_201210140000_X.DAT"])
def test_rtcm_in_djis_files_becomes_observations(shared: Path, tmp_path: Path, name: str) -> None:
    """A real recording of 2012-10-14 under the names of DJI, with a preamble that is no frame."""
    needs_engine()
    raw = (shared / "data/gnss-rtklib-testdata/rcvraw/GMSD7_20121014.rtcm3").read_bytes()
    path = tmp_path / name
    path.write_bytes(b"\x00DJI\xd3\x00" + raw)
    ready = observations_ready(path, tmp_path / "made", TODAY)
    assert "RTCM 3" in ready.remarks[0]
    assert "untried" not in ready.remarks[0]
    found = read_observation_file(ready.path)
    # It begins two seconds before midnight.
    assert found.time[[0]].iso() == ["2012-10-13 23:59:58.000"]
    assert found.time[[-1]].iso()[0].startswith("2012-10-14 00:0")
    assert len(found.time) > 200
    assert count_ephemerides(ready.navigation[0]) > 10


@pytest.mark.shared
def test_the_week_of_rtcm_is_told_by_its_date(shared: Path, tmp_path: Path) -> None:
    raw = (shared / "data/gnss-f9p-lossy-ubx-rtcm/20210809-111055-rtcm3-base-corrections.rtcm3").read_bytes()
    frames = list(frames_of(raw, Wire.RTCM3))
    assert rtcm3_time(frames, tmp_path / "x", TODAY, None).iso()[0].startswith("2021-08-09")
    # Without the date: the other receiver, the name, and then nobody.
    silent = [frame for frame in frames if frame.kind != 1013]
    assert (
        rtcm3_time(silent, tmp_path / "x", TODAY, day("2021-08-09T10:00:00"))
        .iso()[0]
        .startswith("2021-08-09")
    )
    named = tmp_path / "DJI_202108091012_001" / "PPKRAW.bin"
    assert rtcm3_time(silent, named, TODAY, None).iso()[0].startswith("2021-08-09")
    with pytest.raises(IllPosedError, match="its week is unknown"):
        rtcm3_time(silent, tmp_path / "PPKRAW.bin", TODAY, None)


def galileo_week(week: int) -> bytes:
    """Head of message 1045 with the week of Galileo."""
    return encode(((1045 << 18 | 1 << 12 | week) << 10).to_bytes(5, "big") + bytes(20))


def test_the_week_of_galileo_is_whole() -> None:
    """2026-05-18 lies in GPS week 2419, which is 1395 of Galileo."""
    frames = list(frames_of(galileo_week(2419 - 1024), Wire.RTCM3))
    found = rtcm3_time(frames, Path("x"), TODAY, None)
    assert abs(found.ns[0] - day("2026-05-18T00:00:00").ns[0]) < 7 * 86_400e9


@pytest.mark.parametrize("kind", [1019, 1045, 1046])
@pytest.mark.parametrize("length", [2, 3])
def test_an_ephemeris_that_ends_before_its_week_tells_none(kind: int, length: int) -> None:
    frames = list(frames_of(encode((kind << 12).to_bytes(3, "big")[:length]), Wire.RTCM3))
    assert [frame.kind for frame in frames] == [kind]
    with pytest.raises(IllPosedError, match="its week is unknown"):
        rtcm3_time(frames, Path("x"), TODAY, None)


def chain(sync: bytes, body: bytes, n: int = 4) -> bytes:
    """Frames that follow each other."""
    return (sync + body) * n


@pytest.mark.parametrize(
    ("data", "name", "form"),
    [
        (chain(b"$@", bytes(4) + (12).to_bytes(2, "little") + bytes(4)), "x.bin", "sbf"),
        (
            chain(b"\xaa\x44\x12", bytes([28]) + bytes(4) + (16).to_bytes(2, "little") + bytes(38)),
            "x.DAT",
            "nov",
        ),
        (chain(b"$BIN", bytes(2) + (8).to_bytes(2, "little") + bytes(12)), "x.bin", "hemis"),
        (b"\x02 anything", "x.rt17", "rt17"),
    ],
)
def test_the_form_is_told_by_what_is_in_the_file(data: bytes, name: str, form: str) -> None:
    found = form_of(data, Path(name))
    assert (found.converter, found.tried) == (form, False)


def test_what_is_nothing_known_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "EVENTLOG.bin"
    path.write_bytes(bytes(1000))
    with pytest.raises(InputMalformedError, match="neither RINEX nor a known raw format"):
        observations_ready(path, tmp_path / "made", TODAY)
    shutil.rmtree(tmp_path)

"""What PPK refuses, and that it says why in one line."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.frames import Frame, Wire
from drivers.ubx import encode
from tests.conftest import needs_engine
from tests.photocal.conftest import Answer
from tests.photocal.navigation.conftest import ImportLog, Run, frames_of

pytestmark = pytest.mark.shared
Photocal = Callable[..., Answer]
RAWX, SFRBX = 0x0215, 0x0213


@pytest.fixture(scope="session")
def rover_frames(m8p: Path) -> list[Frame]:
    needs_engine()
    data = gzip.decompress((m8p / "rover-20181004-1237.ubx.gz").read_bytes())
    return [f for f in frames_of(data) if f.wire == Wire.UBX and f.kind in (RAWX, SFRBX)]


@pytest.fixture(scope="session")
def base_file(m8p: Path) -> Path:
    return m8p / "base-20181004-1236.ubx.gz"


def refused(photocal: Photocal, log: Path, tmp_path: Path, *options: str) -> str:
    answer = photocal("ppk", log, "-o", tmp_path / "out", *options)
    assert answer.code in (4, 5, 6)
    assert answer.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    return answer.err


def changed(frames: list[Frame], change: Callable[[bytes], bytes]) -> bytes:
    """Frames with the payload of each RXM-RAWX changed."""
    return b"".join(encode(RAWX, change(f.data[6:-2])) if f.kind == RAWX else f.data for f in frames)


def test_no_overlap(photocal: Photocal, shared: Path, import_log: ImportLog, tmp_path: Path) -> None:
    needs_engine()
    data = shared / "data/gnss-f9p-lossy-ubx-rtcm"
    log = import_log(
        "f9p",
        {
            "rover": data / "20210809-121012-ubx-nmea-data.ubx",
            "base": data / "20210809-111055-rtcm3-base-corrections.rtcm3",
        },
    )
    said = refused(photocal, log, tmp_path)
    assert "do not overlap" in said
    assert "base 2021-08-09 15:11:34" in said
    assert "rover 2021-08-09 16:1" in said


def test_empty_epochs(
    photocal: Photocal, rover_frames: list[Frame], base_file: Path, import_log: ImportLog, tmp_path: Path
) -> None:
    empty = changed(rover_frames, lambda p: p[:11] + b"\0" + p[12:16])
    said = refused(photocal, import_log("empty", {"rover": empty, "base": base_file}), tmp_path)
    assert "1205 RXM-RAWX epochs of the rover are empty" in said


def test_week_zero(
    photocal: Photocal, rover_frames: list[Frame], base_file: Path, import_log: ImportLog, tmp_path: Path
) -> None:
    untimed = changed(rover_frames, lambda p: p[:8] + struct.pack("<H", 0) + p[10:])
    # The date of the log comes from another message, as when a receiver is restarted in the air.
    untimed = encode(0x0120, struct.pack("<IihbBI", 390_000_000, 0, 2021, 18, 7, 50)) + untimed
    said = refused(photocal, import_log("week0", {"rover": untimed, "base": base_file}), tmp_path)
    assert "week 0" in said


def test_no_ephemerides(
    photocal: Photocal, rover_frames: list[Frame], base_file: Path, import_log: ImportLog, tmp_path: Path
) -> None:
    log = import_log("noeph", {"rover": [f for f in rover_frames if f.kind == RAWX][:150], "base": base_file})
    assert "no ephemerides" in refused(photocal, log, tmp_path)
    # With those that the base recorded it can be computed, when that is asked for.
    answer = photocal("ppk", log, "-o", tmp_path / "with", "--nav", "base", "--json")
    assert answer.code == 0, answer.err


def test_too_few_epochs(
    photocal: Photocal, rover_frames: list[Frame], base_file: Path, import_log: ImportLog, tmp_path: Path
) -> None:
    epochs = [f for f in rover_frames if f.kind == RAWX][:5]
    few = [*epochs, *(f for f in rover_frames if f.kind == SFRBX)]
    said = refused(photocal, import_log("few", {"rover": few, "base": base_file}), tmp_path)
    assert "only 5 epochs" in said


def test_wrong_base_position(photocal: Photocal, static_run: Run, tmp_path: Path) -> None:
    base = static_run.figures["base"]
    wrong = f"{base['lat_deg'] + 0.0002},{base['lon_deg']},{base['height_m']}"
    said = refused(photocal, static_run.log, tmp_path, "--base-position", wrong)
    assert "m from its own code solution" in said


def test_orthometric_height_of_the_base(photocal: Photocal, static_run: Run, tmp_path: Path) -> None:
    # The geoid is 57 m above the ellipsoid in Galway.
    base = static_run.figures["base"]
    wrong = f"{base['lat_deg']},{base['lon_deg']},{base['height_m'] - 57}"
    said = refused(photocal, static_run.log, tmp_path, "--base-position", wrong)
    assert "height kind" in said


def test_unknown_link(photocal: Photocal, static_run: Run, tmp_path: Path) -> None:
    said = refused(photocal, static_run.log, tmp_path, "--rover-link", "drone")
    assert "base, rover" in said


def test_missing_engine(
    photocal: Photocal, static_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    answer = photocal("ppk", static_run.log, "-o", tmp_path / "out")
    assert answer.code == 9
    assert "install RTKLIB" in answer.err


def of_two_receivers(shared: Path, *names: str) -> list[object]:
    """Options that name rover and base of a static pair, their ephemerides and the base's position."""
    folder = shared / "data/gnss-rinex-static-known"
    rover, base = (folder / name for name in names)
    place = "35.134707705,136.977577939,104.853"
    return ["--rover", rover, "--base", base, "--nav", folder / "base.nav", "--base-position", place]


@pytest.mark.parametrize("height", ["1543", "154.3", "15.43", "nan"])
def test_an_antenna_height_in_another_unit(
    photocal: Photocal, shared: Path, tmp_path: Path, height: str
) -> None:
    """1.543 m in millimetres and centimetres, and with a decimal point that slipped."""
    needs_engine()
    given = of_two_receivers(shared, "rover.obs", "base.obs")
    answer = photocal("ppk", *given, "--base-antenna-height", height, "-o", tmp_path / "out")
    assert answer.code == 5
    assert f"the antenna of the base is {height} m above its mark" in answer.err


def test_one_file_for_both_receivers(photocal: Photocal, shared: Path, tmp_path: Path) -> None:
    needs_engine()
    answer = photocal("ppk", *of_two_receivers(shared, "base.obs", "base.obs"), "-o", tmp_path / "out")
    assert answer.code == 5
    assert "rover and base have the same observations" in answer.err


def test_base_and_rover_exchanged(
    photocal: Photocal, m8p: Path, base_file: Path, import_log: ImportLog, tmp_path: Path
) -> None:
    needs_engine()
    log = import_log("exchanged", {"base": m8p / "rover-20181004-1237.ubx.gz", "rover": base_file})
    said = refused(photocal, log, tmp_path)
    assert "the rover's link rover states one" in said
    assert "give --rover-link base --base-link rover" in said

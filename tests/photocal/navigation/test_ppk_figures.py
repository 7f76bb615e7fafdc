"""PPK on recorded receivers against their own real-time fixes, known positions and the engine by hand."""

from __future__ import annotations

import gzip
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.frames import Wire
from photocal.commands.cli import app
from tests.conftest import needs_engine
from tests.photocal.navigation.conftest import Run, against_receiver, frames_of, ppk

pytestmark = pytest.mark.shared
THURSDAY, TUESDAY = 4, 2


def test_static_rover(static_run: Run, m8p: Path) -> None:
    assert static_run.fixed.sum() >= 1120
    found = against_receiver(static_run, m8p / "rover-20181004-1237.ubx.gz", THURSDAY)
    east, north, up = np.abs(np.median(found.error_m[found.fixed], axis=0))
    assert east < 0.005
    assert north < 0.005
    assert up < 0.050
    assert static_run.figures["base"]["gaps"] > 100
    assert static_run.figures["base"]["longest_gaps"][0]["seconds"] == pytest.approx(24, abs=1)


def test_moving_rover(moving_run: Run, m8p: Path) -> None:
    assert moving_run.fixed.sum() >= 700
    found = against_receiver(moving_run, m8p / "rover-20181009-1221.ubx.gz", TUESDAY)
    horizontal = np.hypot(*found.error_m[found.fixed, :2].T)
    assert len(horizontal) > 250
    assert np.percentile(horizontal, 95) < 0.030
    assert not (horizontal > 0.10).any()


def test_float_epochs_are_as_good_as_they_claim(static_run: Run, moving_run: Run, m8p: Path) -> None:
    for run, name, day in (
        (static_run, "rover-20181004-1237", THURSDAY),
        (moving_run, "rover-20181009-1221", TUESDAY),
    ):
        found = against_receiver(run, m8p / f"{name}.ubx.gz", day)
        normalised = (found.error_m / found.sigma_m)[~found.fixed]
        assert len(normalised) > 25
        rms = np.sqrt(np.mean(normalised**2, axis=0))
        assert (rms < 2).all()
        # Nor are they hidden behind sigmas that say nothing.
        assert (rms > 0.2).all()


def test_every_valid_epoch_of_the_damaged_base_is_used(static_run: Run, moving_run: Run) -> None:
    assert static_run.figures["base"]["epochs"] == 321
    assert moving_run.figures["base"]["epochs"] == 529


def test_the_engine_by_hand_gives_the_same(moving_run: Run, m8p: Path, tmp_path: Path) -> None:
    convbin, solver = shutil.which("convbin"), shutil.which("rnx2rtkp")
    assert convbin is not None
    assert solver is not None
    files = []
    for name in ("rover-20181009-1221", "base-20181009-1220"):
        frames = frames_of(gzip.decompress((m8p / f"{name}.ubx.gz").read_bytes()))
        wanted = [f.data for f in frames if f.wire == Wire.UBX and f.kind in (0x0213, 0x0215)]
        raw = tmp_path / f"{name}.ubx"
        raw.write_bytes(b"".join(wanted))
        obs, nav = raw.with_suffix(".obs"), raw.with_suffix(".nav")
        command = [convbin, "-r", "ubx", "-v", "3.03", "-od", "-os", "-o", obs, "-n", nav, raw]
        subprocess.run(list(map(str, command)), check=True, capture_output=True)
        files.append((obs, nav))
    (rover, rover_nav), (base, base_nav) = files
    base_m = ["3774696.5547", "-596647.9083", "5089485.6511"]
    elevation = tmp_path / "elevation.conf"
    elevation.write_text("pos2-arelmask=20\n")
    options = ["-k", str(elevation), "-p", "2", "-f", "1", "-m", "15", "-sys", "G,R", "-c", "-t", "-d", "9"]
    options += ["-r", *base_m]
    done = subprocess.run(
        [solver, *options, *map(str, (rover, base, rover_nav, base_nav))],
        check=True,
        capture_output=True,
        text=True,
    )
    by_hand = [line.split() for line in done.stdout.splitlines() if line and line[0] != "%"]
    assert len(by_hand) == len(moving_run.rows)
    for name, column, metres in (("lat_deg", 2, 111_200), ("lon_deg", 3, 66_500), ("height_m", 4, 1)):
        difference = moving_run.column(name) - np.array([float(line[column]) for line in by_hand])
        assert np.abs(difference).max() * metres < 1e-3


@pytest.mark.parametrize(("rover_m", "base_m"), [(1.5, 0.4)])
@pytest.mark.slow
def test_known_static_baseline(
    shared: Path, tmp_path: Path, rover_m: float | None, base_m: float | None
) -> None:
    needs_engine()
    data = shared / "data/gnss-rinex-static-known"
    base = ",".join((data / "base_position.txt").read_text().split())
    arguments = ["--rover", "rover.obs", "--base", "base.obs", "--nav", "base.nav"]
    named = [str(data / a) if not a.startswith("-") else a for a in arguments]
    command = ["ppk", *named, "--base-position", base, "--static", "-o", str(tmp_path / "out"), "--json"]
    if rover_m is not None:
        command += ["--rover-antenna-height", str(rover_m), "--base-antenna-height", str(base_m)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["position"]
    lat, lon, height = map(float, (data / "rover_position.txt").read_text().split())
    # The mark lies below the antenna by its height; the base's antenna above the position given.
    height += (base_m or 0.0) - (rover_m or 0.0)
    north = (found["lat_deg"] - lat) * 110_930
    east = (found["lon_deg"] - lon) * 91_100
    assert np.linalg.norm([east, north, found["height_m"] - height]) < 0.002


def test_static_baseline_of_the_damaged_recording(static_run: Run, tmp_path: Path) -> None:
    run = ppk(static_run.log, tmp_path / "static", "--static")
    found = run.figures["position"]
    # README of the data: RTKLIB's static solution of the same recording.
    assert (found["lat_deg"] - 53.280471130) * 111_260 == pytest.approx(0, abs=0.005)
    assert (found["lon_deg"] + 9.057820957) * 66_660 == pytest.approx(0, abs=0.005)
    assert found["height_m"] == pytest.approx(67.7481, abs=0.005)
    # It wandered by a centimetre on the way: the sigma says so.
    assert 0.003 < run.column("su")[0] < 0.05


def test_the_table_is_as_agreed(static_run: Run) -> None:
    header = "time_gps_ns,lat_deg,lon_deg,height_m,status,se,sn,su,sen,seu,snu"
    assert ",".join(static_run.rows[0]) == header
    assert {row["status"] for row in static_run.rows} <= {"fixed", "float", "single"}
    assert (np.diff(static_run.column("time_gps_ns")) > 0).all()

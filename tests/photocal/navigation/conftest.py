"""Flight logs of the recorded receivers, imported once, and PPK runs on them."""

from __future__ import annotations

import csv
import gzip
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from acquire.commands.cli import app as acquire_app
from drivers import nmea
from drivers.frames import GNSS, Frame, StreamFramer, Wire
from photocal.commands.cli import app as photocal_app
from tests.conftest import Once, needs_engine

ImportLog = Callable[..., Path]
EARTH_M = 6_371_000.0 * np.pi / 180


def frames_of(data: bytes) -> list[Frame]:
    """Intact frames of a receiver's stream."""
    framer = StreamFramer(GNSS)
    return [*framer.feed(data), *framer.close()]


@pytest.fixture(scope="session")
def m8p(shared: Path) -> Path:
    return shared / "data/gnss-ubx-m8p-base-rover"


@pytest.fixture(scope="session")
def import_log(tmp_path_factory: pytest.TempPathFactory) -> ImportLog:
    """Import streams by link into a flight log."""

    def run(name: str, links: dict[str, Path | bytes | Iterable[Frame]]) -> Path:
        folder = tmp_path_factory.mktemp(name)
        arguments = []
        for link, source in links.items():
            if not isinstance(source, Path):
                data = source if isinstance(source, bytes) else b"".join(f.data for f in source)
                source = folder / f"{link}.ubx"
                source.write_bytes(data)
            arguments += ["--link", f"{link}={source}"]
        log = folder / f"{name}.mcap"
        done = CliRunner().invoke(acquire_app, ["import", *arguments, "-o", str(log)])
        assert done.exit_code == 0, (done.output, done.exception)
        return log

    return run


@dataclass(frozen=True)
class Run:
    """A finished PPK run: its figures, its table and its log."""

    log: Path
    figures: dict[str, Any]
    rows: list[dict[str, str]]

    def column(self, name: str) -> NDArray[np.float64]:
        return np.array([float(row[name]) for row in self.rows])

    @property
    def fixed(self) -> NDArray[np.bool_]:
        return np.array([row["status"] == "fixed" for row in self.rows])


def ppk(log: Path, folder: Path, *options: str) -> Run:
    done = CliRunner().invoke(photocal_app, ["ppk", str(log), "-o", str(folder), "--json", *options])
    assert done.exit_code == 0, (done.output, done.exception)
    return finished(log, folder, json.loads(done.stdout))


def finished(log: Path, folder: Path, figures: dict[str, Any]) -> Run:
    with (folder / "trajectory.csv").open() as stream:
        return Run(log, figures, list(csv.DictReader(stream)))


def recorded(once: Once, import_log: ImportLog, name: str, **links: Path) -> Run:
    """PPK of a recorded rover and base, once for all workers."""
    needs_engine()

    def fill(folder: Path) -> None:
        run = ppk(import_log(name, dict(links)), folder / "ppk")
        (folder / "run.json").write_text(json.dumps([str(run.log), run.figures]))

    folder = once(f"ppk-{name}", fill)
    log, figures = json.loads((folder / "run.json").read_text())
    return finished(Path(log), folder / "ppk", figures)


@pytest.fixture(scope="session")
def static_run(m8p: Path, once: Once, import_log: ImportLog) -> Run:
    rover, base = m8p / "rover-20181004-1237.ubx.gz", m8p / "base-20181004-1236.ubx.gz"
    return recorded(once, import_log, "static", rover=rover, base=base)


@pytest.fixture(scope="session")
def moving_run(m8p: Path, once: Once, import_log: ImportLog) -> Run:
    rover, base = m8p / "rover-20181009-1221.ubx.gz", m8p / "base-20181009-1220.ubx.gz"
    return recorded(once, import_log, "moving", rover=rover, base=base)


@dataclass(frozen=True)
class Comparison:
    """A run less the receiver's own real-time fix, metres east, north, up; claimed sigmas; our status."""

    error_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    fixed: NDArray[np.bool_]


def against_receiver(run: Run, stream: Path, day_of_week: int) -> Comparison:
    """Compare with the GGA sentences of quality 4 (UTC of the day, 18 leap seconds)."""
    framer = StreamFramer((Wire.NMEA, Wire.UBX, Wire.RTCM3))
    batch = framer.feed(gzip.decompress(stream.read_bytes()))
    gga, (_, of_day_ns) = nmea.decode_gga(batch), nmea.decode_gga_times(batch)
    tow = np.rint(of_day_ns / 1e9 + day_of_week * 86_400 + 18).astype(int)
    own = {int(t): i for i, t in enumerate(tow.tolist()) if gga.fix[i] == "rtk_fixed"}
    pairs = [
        (i, own[second])
        for i, ns in enumerate(int(row["time_gps_ns"]) for row in run.rows)
        if (second := round(ns % (604_800 * 10**9) / 1e9)) in own
    ]
    ours, theirs = np.array(pairs).T
    lat, lon, height = (run.column(name)[ours] for name in ("lat_deg", "lon_deg", "height_m"))
    east = (lon - gga.longitude_deg[theirs]) * EARTH_M * np.cos(np.radians(lat))
    north = (lat - gga.latitude_deg[theirs]) * EARTH_M
    sigma = np.stack([run.column(name)[ours] for name in ("se", "sn", "su")], axis=1)
    error = np.stack([east, north, height - gga.height_m[theirs]], axis=1)
    return Comparison(error, sigma, run.fixed[ours])

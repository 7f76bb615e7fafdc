"""Other ways into a survey: logs instead of RINEX, precise products; and the way out into a block."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquire.simulate.gnss.constellation import Antenna
from acquire.simulate.gnss.observations import Session, simulate
from acquire.simulate.gnss.settings import BASE
from acquire.simulate.gnss.streams import base_ubx
from photocal.block.folder import read_points
from photocal.navigation.engine import to_rinex
from photocal.navigation.time import GpsTime
from tests.acquire.simulate.gnss.flights import AXES, BASE_M, SECOND, ecef, gps_ns
from tests.conftest import needs_engine
from tests.photocal.conftest import Answer
from tests.photocal.navigation.conftest import Run
from tests.photocal.navigation.tides import displacement

Photocal = Callable[..., Answer]
LIGHT_M_S = 299_792_458.0
START = gps_ns(2025, 6, 15, 13, 0, 0)


@pytest.mark.shared
@pytest.mark.slow
def test_logs_instead_of_rinex(photocal: Photocal, static_run: Run, tmp_path: Path) -> None:
    path = tmp_path / "survey.toml"
    path.write_text(f"""
required_minutes = 20
crs = "EPSG:32629"
known = [{{ name = "B", lat_deg = 53.28, lon_deg = -9.06, height_m = 66, sigma_m = [0.01, 0.01, 0.02] }}]
[[baseline]]
name = "a/1"
start = "B"
end = "P"
base = "{static_run.log}"
rover = "{static_run.log}"
base_antenna_m = 0.0
rover_antenna_m = 0.0
""")
    refused = photocal("survey", path, "-o", tmp_path / "out")
    # The mark's coordinates are rounded: the base stood elsewhere.
    assert refused.code == 6
    assert "code solution" in refused.err
    lat, lon, height = (static_run.figures["base"][k] for k in ("lat_deg", "lon_deg", "height_m"))
    text = path.read_text().replace(
        "lat_deg = 53.28, lon_deg = -9.06, height_m = 66",
        f"lat_deg = {lat}, lon_deg = {lon}, height_m = {height}",
    )
    path.write_text(text)
    answer = photocal("survey", path, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    figures = json.loads(answer.out)
    mark = figures["marks"][1]
    # README of the data: RTKLIB's static solution.
    assert (mark["lat_deg"] - 53.280471130) * 111_260 == pytest.approx(0, abs=0.005)
    assert (mark["lon_deg"] + 9.057820957) * 66_660 == pytest.approx(0, abs=0.005)
    assert mark["height_m"] == pytest.approx(67.7481, abs=0.005)
    assert mark["sigma_enu_m"][2] > 0.02
    assert mark["ellipse_95_m"][0] >= mark["ellipse_95_m"][1] > 2.4 * 0.01
    # A block takes the table as it is, with its full covariances.
    points = read_points(tmp_path / "out" / "points.csv")
    assert points.names == ("B", "P")
    with (tmp_path / "out" / "points.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert points.values[1] == pytest.approx([float(rows[1][axis]) for axis in "XYZ"])
    assert float(rows[1]["sZ"]) == pytest.approx(mark["sigma_enu_m"][2], rel=1e-3)


def sp3(session: Session, hours: int) -> str:
    """Orbits and clocks of the simulated sky as a product of an analysis centre, every five minutes."""
    epochs = np.arange(-18, 12 * hours + 19) * 300.0
    satellites = [s for s in session.satellites if s.system in "GE"]
    names = "".join(s.name for s in satellites).ljust(51 * 5, " ")
    lines = [
        f"#cP2025  6 15 11 30  0.00000000     {len(epochs):3d} ORBIT IGS14 HLM  IGS",
        "## 2371 41400.0 300.0 60841 0.5",
    ]
    for part in range(5):
        chunk = names[51 * part : 51 * part + 51]
        lines.append(
            f"+  {len(satellites) if part == 0 else '':>3}   {chunk.ljust(51).replace('   ', '  0')}"
        )
    lines += ["++         " + "  0" * 17] * 5
    lines += ["%c M  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc"] * 2
    lines += ["%f  0.0000000  0.000000000  0.00000000000  0.000000000000000"] * 2
    lines += ["%i    0    0    0    0      0      0      0      0         0"] * 2 + ["/* SIMULATED"] * 4
    for seconds in epochs.tolist():
        minutes = round(seconds / 60) + 13 * 60
        lines.append(f"*  2025  6 15 {minutes // 60:2d} {minutes % 60:2d}  0.00000000")
        for satellite in satellites:
            state = satellite.state(np.array([seconds]), START)
            x, y, z = state.position_m[0] / 1e3
            # Products leave the relativistic term to the user (IS-GPS-200, 20.3.3.3.3.1).
            clock = state.clock_s[0] + 2 * state.position_m[0] @ state.velocity_m_s[0] / LIGHT_M_S**2
            lines.append(f"P{satellite.name}{x:14.6f}{y:14.6f}{z:14.6f}{clock * 1e6:14.6f}")
    return "\n".join([*lines, "EOF"]) + "\n"


@pytest.mark.slow
def test_a_precise_point(photocal: Photocal, tmp_path: Path) -> None:
    needs_engine()
    on_earth = Antenna(lambda t: BASE_M + displacement(t, BASE_M), lambda t: np.zeros((len(t), 3)))
    session = simulate(
        Antenna.still(BASE_M), on_earth, (START, START + 7200 * SECOND),
        rng=np.random.default_rng(3), rover_model=replace(BASE, interval_s=300.0),
        base_model=replace(BASE, slips_per_hour=0.0, code_bias_m=0.0),
    )  # fmt: skip
    to_rinex(base_ubx(session).data, "ubx", tmp_path / "base", GpsTime(np.array([START])))
    (tmp_path / "orbits.sp3").write_text(sp3(session, 2))
    path = tmp_path / "survey.toml"
    path.write_text("""
required_minutes = 20
[[ppp]]
name = "B"
rover = "base.obs"
nav = ["base.nav"]
products = ["orbits.sp3"]
rover_antenna_m = 1.5
""")
    answer = photocal("survey", path, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    figures = json.loads(answer.out)
    mark = figures["marks"][0]
    off = AXES @ (ecef(mark["lat_deg"], mark["lon_deg"], mark["height_m"]) - BASE_M) + [0, 0, 1.5]
    assert np.hypot(*off[:2]) < 0.02
    assert abs(off[2]) < 0.04
    assert (np.abs(off) < 3 * np.array(mark["sigma_enu_m"])).all()
    assert figures["sessions"][0]["long_enough"]

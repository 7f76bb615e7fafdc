"""The control survey as a command: a known baseline, times, wrong set-ups."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.base.geodesy import enu_offsets, geocentric
from tests.conftest import needs_engine
from tests.photocal.conftest import Answer

Photocal = Callable[..., Answer]


def setup_text(data: Path, base_antenna_m: float = 0.0) -> str:
    lat, lon, height = (data / "base_position.txt").read_text().split()
    return f"""
required_minutes = 20
[[known]]
name = "BASE"
lat_deg = {lat}
lon_deg = {lon}
height_m = {height}
sigma_m = [0, 0, 0]
[[baseline]]
name = "s1"
start = "BASE"
end = "P1"
base = "{data}/base.obs"
rover = "{data}/rover.obs"
nav = ["{data}/base.nav"]
base_antenna_m = {base_antenna_m}
rover_antenna_m = 0
"""


@pytest.mark.shared
@pytest.mark.slow
def test_known_baseline(photocal: Photocal, shared: Path, tmp_path: Path) -> None:
    needs_engine()
    data = shared / "data/gnss-rinex-static-known"
    path = tmp_path / "survey.toml"
    path.write_text(setup_text(data, 0.0))
    answer = photocal("survey", path, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    session = json.loads(answer.out)["sessions"][0]
    assert session["minutes"] == pytest.approx(5.0)
    assert not session["long_enough"]
    with (tmp_path / "out" / "points.csv").open() as stream:
        base, point = csv.DictReader(stream)
    assert float(base["sX"]) == 0
    places = [list(map(float, (data / f"{n}_position.txt").read_text().split())) for n in ("rover", "base")]
    (lat, lon, height), origin = places
    expected = enu_offsets(np.array([lat]), np.array([lon]), np.array([height]), np.array(origin))[0]
    found = np.array([float(point[axis]) for axis in "XYZ"])
    assert np.linalg.norm(found - expected) < 0.002
    assert 0.0005 < float(point["sZ"]) < 0.01


@pytest.mark.shared
@pytest.mark.slow
def test_a_station_from_a_file_and_times_by_length(photocal: Photocal, shared: Path, tmp_path: Path) -> None:
    """The same baseline from a site in SINEX, with one system and frequency, against a table of times."""
    needs_engine()
    data = shared / "data/gnss-rinex-static-known"
    lat, lon, height = map(float, (data / "base_position.txt").read_text().split())
    x, y, z = geocentric(lat, lon, height)
    rows = [
        f" {n} STA{axis}   {site}  A    1 26:261:43200 m    2 {value:.14e} 1.00000e-03"
        for site, shift in (("OTHR", 1e4), ("BRST", 0.0))
        for n, (axis, value) in enumerate(zip("XYZ", (x + shift, y, z), strict=True), 1)
    ]
    text = "\n".join(["%=SNX 2.02 AUS", "+SOLUTION/ESTIMATE", *rows, "-SOLUTION/ESTIMATE", "%ENDSNX", ""])
    (tmp_path / "week.snx").write_text(text)
    known = setup_text(data)
    table = known[known.index("[[known]]") : known.index("[[baseline]]")]
    station = '[[station]]\nname = "BASE"\nfile = "week.snx"\nsite = "BRST"\n'
    near = "{ up_to_km = 1000, minutes = 4, two_frequencies = true }"
    asked = f"required = [{near}, {{ up_to_km = 2000, minutes = 9 }}]"
    asked += '\nsystems = "G"\ntwo_frequencies = false'
    path = tmp_path / "survey.toml"
    path.write_text(known.replace(table, station).replace("required_minutes = 20", asked))
    answer = photocal("survey", path, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    session = json.loads(answer.out)["sessions"][0]
    assert session["required_minutes"] == 4
    assert session["long_enough"]
    assert not session["enough_frequencies"]
    with (tmp_path / "out" / "points.csv").open() as stream:
        base, point = csv.DictReader(stream)
    assert float(base["sX"]) == pytest.approx(0.001, rel=0.01)
    places = [list(map(float, (data / f"{n}_position.txt").read_text().split())) for n in ("rover", "base")]
    (lat, lon, height), origin = places
    expected = enu_offsets(np.array([lat]), np.array([lon]), np.array([height]), np.array(origin))[0]
    apart = [float(point[axis]) - float(base[axis]) for axis in "XYZ"]
    assert np.linalg.norm(apart - expected) < 0.005
    unframed = path.read_text()
    path.write_text('crs = "EPSG:6677"\n' + unframed)
    refused = photocal("survey", path, "-o", tmp_path / "unframed")
    assert refused.code == 5
    assert "does not say in which frame" in refused.err
    path.write_text(unframed.replace("km = 1000", "km = 0.0001").replace("km = 2000", "km = 0.0002"))
    beyond = photocal("survey", path, "-o", tmp_path / "again")
    assert beyond.code == 0, beyond.err
    assert "longer than the lengths in [[required]]" in beyond.out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("required_minutes", "minutes"), "unknown key minutes"),
        (("required_minutes = 20", ""), "required_minutes is missing"),
        (("required_minutes", 'systems = "X"\nrequired_minutes'), "systems"),
        (('start = "BASE"', 'start = "P7"'), "no chain of baselines"),
        (("sigma_m = [0, 0, 0]", "sigma_m = 3"), "sigma_m"),
    ],
)
@pytest.mark.shared
def test_wrong_set_ups(
    photocal: Photocal, shared: Path, tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    path = tmp_path / "survey.toml"
    path.write_text(setup_text(shared / "data/gnss-rinex-static-known").replace(*change))
    answer = photocal("survey", path, "-o", tmp_path / "out")
    assert answer.code == 5
    assert message in answer.err
    assert answer.err.count("\n") == 1


def test_marks_outside_the_area_of_the_system_are_refused(photocal: Photocal, tmp_path: Path) -> None:
    """A mark whose sign of longitude is lost, and one in the next zone; EPSG:31982 ends at 47.99 W."""
    text = """
required_minutes = 20
crs = "EPSG:31982"
[[known]]
name = "M1"
lat_deg = -25.45
lon_deg = {lon}
height_m = 925.8
sigma_m = [0, 0, 0]
[[baseline]]
name = "s1"
start = "M2"
end = "P1"
base = "base.obs"
rover = "rover.obs"
nav = ["base.nav"]
base_antenna_m = 0
rover_antenna_m = 0
"""
    path = tmp_path / "survey.toml"
    for lon, outside in (("49.23", "97.22"), ("-46.6", "1.39")):
        path.write_text(text.format(lon=lon))
        refused = photocal("survey", path, "-o", tmp_path / "out")
        assert f"mark M1 lies {outside} degrees outside the area of use of EPSG:31982" in refused.err
    for said in ("", "outside_area = true"):
        path.write_text(said + text.format(lon="-49.23" if not said else "-46.6"))
        assert (
            "no chain of baselines reaches its start M2" in photocal("survey", path, "-o", tmp_path / "o").err
        )

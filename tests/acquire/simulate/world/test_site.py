"""What a simulated site and its truth contain, at every level and with every fault."""

from __future__ import annotations

import csv
import json
import subprocess
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from acquire.simulate.world.configuration import SimulatedFault, read_configuration
from photocal.base.errors import ConfigurationError
from tests.acquire.simulate.world.conftest import Flight, flown
from tests.simulated import PLANS, world_of

Acquire = Callable[..., subprocess.CompletedProcess[str]]


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def numbers(path: Path, *columns: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([[float(row[name]) for name in columns] for row in table(path)])


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_site_names_nothing_of_the_truth(small: Flight) -> None:
    texts = [p for p in (small.folder / "site").rglob("*") if p.suffix in (".toml", ".csv")]
    assert len(texts) >= 3
    for path in texts:
        assert "truth" not in path.read_text()
    project = tomllib.loads((small.folder / "site/project.toml").read_text())
    assert (small.folder / "site" / project["images"]["folder"]).is_dir()
    assert (small.folder / "site" / project["control"]["points"]).is_file()
    assert project["camera"][0]["parameters"] == {"c": 8.8}
    assert set(project["control"]["targets"]["names"].values()) == set(small.world.targets.names)


def test_the_project_file_is_one(small: Flight) -> None:
    from photocal.block.project import read_project

    project = read_project(small.folder / "site/project.toml")
    assert project.crs == "EPSG:31982"
    assert project.camera.size_px == (1024, 768)


def test_the_survey_has_the_stated_sigmas() -> None:
    world = world_of(PLANS / "survey.toml", targets={"control": 300, "check": 0})
    error = world.targets.surveyed_m - world.targets.centre_m
    assert error.std(axis=0) == pytest.approx(world.configuration.targets.sigma_m, rel=0.15)


@pytest.mark.parametrize("check", [0, 2])
def test_a_site_without_control_has_check_points_alone(check: int) -> None:
    targets = world_of(PLANS / "small.toml", targets={"control": 0, "check": check}).targets
    assert targets.roles == ("check",) * check


def test_camera_terms_of_the_truth_project_as_opencv(small: Flight) -> None:
    """The certificate's terms, written out as docs/nomenclature.md has them, give the same pixels."""
    truth = json.loads((small.folder / "truth/truth.json").read_text())
    camera = truth["camera"]
    random = np.random.default_rng(1)
    points = np.column_stack([random.uniform(-0.6, 0.6, (200, 2)), np.ones(200)])
    expected = small.world.camera.project(points)
    for unit, pitch in (("px", 1.0), ("mm", camera["pitch_mm"])):
        p = camera[unit]
        # Camera axes: y up, z backwards.
        u, v, w = points[:, 0], -points[:, 1], -points[:, 2]
        x, y = -p["c"] * u / w, -p["c"] * v / w
        r2 = x**2 + y**2
        radial = p["K1"] * r2 + p["K2"] * r2**2 + p["K3"] * r2**3
        xd = x * (1 + radial) + p["P1"] * (r2 + 2 * x**2) + 2 * p["P2"] * x * y
        yd = y * (1 + radial) + p["P2"] * (r2 + 2 * y**2) + 2 * p["P1"] * x * y
        column = (p["x0"] + (1 + p["B1"]) * xd) / pitch + (camera["size_px"][0] - 1) / 2
        row = (camera["size_px"][1] - 1) / 2 - (p["y0"] + yd) / pitch
        assert np.abs(np.column_stack([column, row]) - expected).max() < 1e-8


def test_the_block_agrees_with_its_truth(tmp_path: Path) -> None:
    """Positions, attitudes and rays of a block without noise satisfy the equations of the documents."""
    quiet = read_configuration(PLANS / "small.toml")
    still = {"camera_to_antenna_m": [0.08, 0.03, -0.24], "attitude_sigma_deg": [1e-9] * 3}
    flight = flown(
        tmp_path,
        level="block",
        rig={**still, "position_sigma_m": [1e-9] * 3},
        observing={"ties": 60, "sigma_px": 1e-6, "target_sigma_px": 1e-6},
        targets={**quiet.targets.model_dump(), "sigma_m": [1e-9] * 3},
    )
    truth, block = flight.folder / "truth", flight.folder / "site/block"
    rig = json.loads((truth / "truth.json").read_text())["rig"]
    antenna = numbers(block / "positions.csv", "X", "Y", "Z")
    velocity = numbers(block / "positions.csv", "vX", "vY", "vZ")
    angles = np.radians(numbers(truth / "exposures.csv", "omega", "phi", "kappa"))
    centre = numbers(truth / "exposures.csv", "X", "Y", "Z")
    # M = R3(kappa) R2(phi) R1(omega) turns the axes: the transpose of active turns about X, Y, Z in a row.
    matrix = np.swapaxes(Rotation.from_euler("XYZ", angles).as_matrix(), 1, 2)
    nadir = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    mount = Rotation.from_rotvec(np.radians(rig["boresight_deg"])).as_matrix() @ nadir
    arm = np.swapaxes(matrix, 1, 2) @ mount @ rig["camera_to_antenna_m"]
    assert np.abs(centre + arm - velocity * rig["time_offset_s"] - antenna).max() < 5e-4
    attitude = np.radians(numbers(block / "attitudes.csv", "roll", "pitch", "yaw"))
    to_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    body = np.swapaxes(Rotation.from_euler("ZYX", attitude[:, ::-1]).as_matrix(), 1, 2) @ to_ned
    turn = Rotation.from_matrix(np.swapaxes(mount @ body, 1, 2) @ matrix).magnitude()
    # The exposure comes milliseconds after the event: meanwhile the vehicle turns by hundredths of a degree.
    assert np.degrees(turn).max() < 0.05


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """The small flight with observations, without faults."""
    return flown(tmp_path_factory.mktemp("plain"), level="observations")


def test_levels_without_pictures(plain: Flight, tmp_path: Path) -> None:
    streams = plain
    names = {p.name for p in (streams.folder / "site").iterdir()}
    assert names == {
        "vehicle.tlog", "rover.ubx", "base.ubx", "observations.csv", "times.csv", "control.csv",
        "project.toml", "particulars.toml",
    }  # fmt: skip
    seen = table(streams.folder / "site/observations.csv")
    timed = {row["image"] for row in table(streams.folder / "site/times.csv")}
    assert {row["image"] for row in seen} <= timed
    block = flown(tmp_path / "block", level="block")
    assert {p.name for p in (block.folder / "site").iterdir()} == {
        "block",
        "project.toml",
        "particulars.toml",
    }


def test_the_same_bytes_each_time_and_others_with_another_seed(plain: Flight, tmp_path: Path) -> None:
    first = contents(plain.folder)
    assert first == contents(flown(tmp_path / "again", level="observations").folder)
    other = contents(flown(tmp_path / "other", level="observations", seed=6).folder)
    assert all(first[name] != other[name] for name in ("site/rover.ubx", "site/vehicle.tlog"))


def test_grid_coordinates_of_the_truth(small: Flight) -> None:
    rows = small.folder / "truth/points.csv"
    surveyed = numbers(small.folder / "site/control.csv", "X", "Y", "Z")
    assert np.abs(numbers(rows, "E", "N", "h") - surveyed).max() < 0.06
    exposures = small.folder / "truth/exposures.csv"
    turned = numbers(exposures, "kappa_grid") - numbers(exposures, "kappa")
    local, grid = (
        Rotation.from_euler("XYZ", numbers(exposures, *names), degrees=True)
        for names in (("omega", "phi", "kappa"), ("omega_grid", "phi_grid", "kappa_grid"))
    )
    apart = local * grid.inv()
    # Convergence: the meridian here is 1.77 degrees east of the central one at 51 W.
    convergence = np.degrees(np.arctan(np.tan(np.radians(51 - 49.2311)) * np.sin(np.radians(-25.4483))))
    assert np.degrees(apart.magnitude()) == pytest.approx(np.full(len(turned), abs(convergence)), abs=1e-3)
    # East of the central meridian and south of the equator grid north lies east of true north.
    assert (turned < 0).all()


@pytest.mark.parametrize(
    ("fault", "files"),
    [
        ("wrong_antenna_height", {"project.toml"}),
        ("base_off", {"project.toml", "base.ubx"}),
        ("event_time_base", {"rover.ubx"}),
        ("late_shutter", {"observations.csv"}),
        ("lever_arm_axis", {"project.toml"}),
        ("control_digits", {"control.csv"}),
        ("missing_images", {"observations.csv", "times.csv"}),
        ("telemetry_gap", {"vehicle.tlog"}),
        ("cycle_slips", {"rover.ubx", "base.ubx"}),
    ],
)
def test_a_fault_changes_what_it_is_about_and_nothing_else(
    fault: SimulatedFault, files: set[str], plain: Flight, tmp_path: Path
) -> None:
    right, wrong = plain.folder, flown(tmp_path, level="observations", faults=[fault]).folder
    one, two = contents(right / "site"), contents(wrong / "site")
    assert {name for name in one if one[name] != two.get(name)} == files
    assert json.loads((wrong / "truth/truth.json").read_text())["faults"] == [fault]
    if fault == "control_digits":
        apart = numbers(right / "site/control.csv", "X", "Y", "Z") - numbers(
            wrong / "site/control.csv", "X", "Y", "Z"
        )
        assert (np.abs(apart) > 0.4).sum() == 1
        (row,) = np.flatnonzero(np.abs(apart).max(axis=1) > 0)
        name = json.loads((wrong / "truth/truth.json").read_text())["mistyped_control"]
        assert table(wrong / "site/control.csv")[row]["point"] == name
        assert table(wrong / "site/control.csv")[row]["role"] == "control"
    if fault == "missing_images":
        lost = {r["image"] for r in table(right / "site/times.csv")} - {
            r["image"] for r in table(wrong / "site/times.csv")
        }
        assert lost == set(json.loads((wrong / "truth/truth.json").read_text())["missing_images"])
        assert lost
    if fault == "lever_arm_axis":
        arms = [
            tomllib.loads((f / "site/project.toml").read_text())["rig"]["camera_to_antenna_m"]
            for f in (right, wrong)
        ]
        assert arms[1] == [arms[0][2], arms[0][1], arms[0][0]]


def test_a_zoom_changes_the_camera_of_later_passes() -> None:
    exposures = world_of(PLANS / "survey.toml", faults=["zoom"]).exposures
    first, last = exposures.cameras[0], exposures.cameras[-1]
    assert last.fx == pytest.approx(1.004 * first.fx)
    assert exposures.covers[0] == 0
    assert exposures.covers[-1] == 1


def test_faults_have_sizes() -> None:
    """Each figure is found again in what the surveyor noted, or in the truth."""
    from acquire.simulate.world.block_folder import noted_control, telemetry_gap

    sizes = {
        "antenna_height_m": 0.3, "base_m": [1.0, 2.0, 3.0], "late_s": 0.017, "zoom": 1.01,
        "control_m": [0.0, 10.0, 0.0], "gap_s": 10.0,
    }  # fmt: skip
    every = list(get_args(SimulatedFault))
    right, wrong = (
        world_of(PLANS / "survey.toml", faults=faults, fault_sizes=sizes) for faults in ([], every)
    )
    coordinates = right.targets.surveyed_m
    noted, mistaken = (noted_control(world, coordinates)[0] for world in (right, wrong))
    assert right.noted_antenna_height_m - wrong.noted_antenna_height_m == pytest.approx(0.3)
    assert wrong.noted_base_m - right.noted_base_m == pytest.approx(np.array([1.0, 2.0, 3.0]))
    assert wrong.rig.time_offset_s - right.rig.time_offset_s == pytest.approx(0.017)
    assert wrong.exposures.cameras[-1].fx == pytest.approx(1.01 * right.exposures.cameras[-1].fx)
    apart = np.array(mistaken, dtype=float) - np.array(noted, dtype=float)
    assert apart[np.any(apart != 0, axis=1)] == pytest.approx(np.array([[0.0, 10.0, 0.0]]))
    begin, end = telemetry_gap(wrong)
    assert end - begin == pytest.approx(10.0)


def test_faults_that_do_not_show_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cycle slips"):
        flown(tmp_path, level="block", faults=["cycle_slips"])


def test_the_surveyor_notes_the_weather_at_the_base(tmp_path: Path) -> None:
    """6.5 K less for each of the 0.913 km above the sea."""
    air = {"temperature_c": 35.0, "relative_humidity": 0.9}
    site = flown(tmp_path, level="observations", observing={"ties": 0}, air=air).folder / "site"
    noted = tomllib.loads((site / "project.toml").read_text())["flight"]["weather"]
    assert noted["temperature_c"] == pytest.approx(35.0 - 6.5 * 0.913, abs=0.1)
    assert noted["relative_humidity_percent"] == 90.0


def test_one_field_for_several_flights() -> None:
    one, two = (world_of(PLANS / "small.toml", seed=seed, field_seed=7) for seed in (1, 2))
    assert np.array_equal(one.terrain.coefficients, two.terrain.coefficients)
    assert np.array_equal(one.targets.surveyed_m, two.targets.surveyed_m)
    assert np.array_equal(one.rig.boresight, two.rig.boresight)
    assert not np.array_equal(one.exposures.event_s, two.exposures.event_s)


@pytest.mark.parametrize(
    ("section", "keys", "words"),
    [
        ("place", {"start_utc": "2025-06-15T14:00:00"}, "zone"),
        ("place", {"start_utc": "2031-06-15T14:00:00Z"}, "must lie between"),
        ("place", {"crs": "EPSG:4326"}, "not a map in metres"),
        ("place", {"crs": "EPSG:1"}, "not known"),
        ("plan", {"area_m": [[0, 0], [9, 9], [18, 18]]}, "square metre"),
        ("plan", {"pass": [{"height_m": 3, "course_deg": 0, "speed_m_s": 3}]}, "too low"),
        ("targets", {"dictionary": "apriltag_1h1"}, "no dictionary"),
        ("targets", {"dictionary": "apriltag_16h5", "check": 40}, "29 codes"),
        ("camera", {"fx": -3}, "camera.fx"),
        ("gnss", {"rate": 3}, "gnss.rate"),
    ],
)
def test_what_cannot_be_flown(section: str, keys: dict[str, Any], words: str, tmp_path: Path) -> None:
    with (PLANS / "small.toml").open("rb") as text:
        content = tomllib.load(text)[section] | keys
    with pytest.raises(ConfigurationError, match=words):
        flown(tmp_path, **{section: content})


def test_the_help_names_every_fault() -> None:
    from acquire.commands.simulate import FAULTS

    assert all(fault in FAULTS for fault in get_args(SimulatedFault))


def test_the_command(acquire: Acquire, tmp_path: Path) -> None:
    config = PLANS / "small.toml"
    done = acquire(
        "simulate", "flight", config, "-o", tmp_path / "f", "--observations-only",
        "--fault", "zoom", "--seed", 9, "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["seed"], told["faults"], told["level"]) == (9, ["zoom"], "block")
    assert acquire("simulate", "flight", config, "-o", tmp_path / "f").returncode == 8
    assert acquire("simulate", "flight", config, "-o", tmp_path / "g", "--fault", "rain").returncode == 5
    assert not (tmp_path / "g").exists()
    old = acquire("simulate", "-o", tmp_path / "flight.tlog", "--json")
    assert old.returncode == 0
    assert json.loads(old.stdout)["bytes"] == (tmp_path / "flight.tlog").stat().st_size

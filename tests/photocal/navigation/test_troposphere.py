"""The air between base and rover: refractivity against zenith delays, climate, weather, simulated flights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.simulate.gnss.atmosphere import Atmosphere
from acquire.simulate.gnss.constellation import Antenna, AntennaTrack
from acquire.simulate.gnss.observations import simulate
from acquire.simulate.gnss.settings import ROVER, SkySettings
from acquire.simulate.gnss.streams import base_ubx, rover_ubx
from photocal.base.codec import from_plain
from photocal.base.errors import ConfigurationError
from photocal.block.project import AirAtBase
from photocal.navigation.common_errors import (
    CommonErrors,
    climate,
    parse_weather,
    refractivity,
    remaining_lapse,
    saturation_hpa,
)
from photocal.navigation.engine import to_rinex
from photocal.navigation.ppk import options_for, process
from photocal.navigation.ppk_inputs import Inputs
from photocal.navigation.ppk_result import Ppk
from photocal.navigation.precise_results import ObservationFile, read_observation_file
from photocal.navigation.survey import KnownMark, MeasuredBaseline, Survey, SurveySetup, run_survey
from photocal.navigation.time import GpsTime
from tests.acquire.simulate.gnss.flights import AXES, BASE_DEG, BASE_M, SECOND, Loop, gps_ns
from tests.conftest import needs_engine

Floats = NDArray[np.float64]
START = gps_ns(2025, 6, 15, 13, 15, 20)


def measured_air(
    temperature_c: float, humidity_percent: float, pressure_hpa: float | None = None
) -> AirAtBase:
    return AirAtBase(
        temperature_c=temperature_c, relative_humidity_percent=humidity_percent, pressure_hpa=pressure_hpa
    )


def test_vapour_pressure_as_tabulated() -> None:
    # Pressure of saturated vapour over water, WMO tables (hPa).
    for celsius, hpa in ((0, 6.11), (10, 12.27), (20, 23.37), (30, 42.43)):
        assert saturation_hpa(celsius) == pytest.approx(hpa, rel=2e-3)


def test_refractivity_adds_up_to_the_zenith_delay() -> None:
    """2.2768 mm for each hectopascal (Saastamoinen 1972); and of the vapour as DO-229D integrates it."""
    lat, day, step = 45.0, 28.0 + 365.25 / 4, 20.0
    heights = np.arange(0.0, 60_000.0, step) + step / 2
    # The climate's own profile ends where the temperature reaches zero.
    inside = heights < 40_000
    air = [climate(lat, h, day) for h in heights[inside].tolist()]
    dry = 1e-6 * step * sum(refractivity(hpa, kelvin, 0.0)[0] for hpa, kelvin, _ in air)
    whole = 1e-6 * step * sum(sum(refractivity(*state)) for state in air)
    pressure, kelvin, vapour = climate(lat, 0.0, day)
    assert (pressure, kelvin, vapour) == pytest.approx((1015.75, 283.15, 11.66))
    assert dry == pytest.approx(0.0022768 * pressure, rel=3e-3)
    k, gas, gravity, lapse, exponent = 382_000.0, 287.054, 9.784, 5.58e-3, 2.57
    wet = 1e-6 * k * gas / (gravity * (exponent + 1) - lapse * gas) * vapour / kelvin
    # Its constant of vapour is 2 % larger than later measurements.
    assert whole - dry == pytest.approx(wet, rel=0.03)


def test_the_engine_knows_dry_standard_air() -> None:
    lapse = remaining_lapse(45.0, 0.0, 100.0, measured_air(15.0, 0.0, 1013.25))
    # Refractivity there is 273 ppm.
    assert abs(lapse.value) < 0.5e-6
    moist = remaining_lapse(45.0, 0.0, 100.0, measured_air(15.0, 100.0))
    assert moist.value == pytest.approx(75e-6, rel=0.05)
    # Measured air is better known than the climate's.
    assert (
        remaining_lapse(45.0, 0.0, 100.0, measured_air(10.0, 60.0)).sigma
        < remaining_lapse(45.0, 0.0, 100.0).sigma
    )


def test_seasons_are_half_a_year_apart_on_both_sides_of_the_equator() -> None:
    january, july = 28.0, 28.0 + 365.25 / 2
    assert climate(50.0, 0.0, july)[2] > 1.5 * climate(50.0, 0.0, january)[2]
    assert climate(-50.0, 0.0, january) == pytest.approx(climate(50.0, 0.0, july), rel=2e-3)


def test_weather_of_the_command_line() -> None:
    assert parse_weather("21,60", "--weather") == measured_air(21.0, 60.0)
    assert parse_weather("21,60,918", "--weather") == measured_air(21.0, 60.0, 918.0)
    for text in ("21", "21,160", "21,60,91800", "warm,60"):
        with pytest.raises(ConfigurationError, match="weather"):
            parse_weather(text, "--weather")


def observed(
    rover_at: Antenna, humidity: float, folder: Path
) -> tuple[ObservationFile, ObservationFile, list[Path]]:
    """Observe for a minute in this air, always with the same noise."""
    folder.mkdir()
    session = simulate(
        rover_at,
        Antenna.still(BASE_M),
        (START, START + 60 * SECOND),
        rng=np.random.default_rng(3),
        rover_model=replace(ROVER, interval_s=1.0),
        sky=SkySettings(relative_humidity=humidity, wet_sigma_m=0.0),
    )
    near = GpsTime(np.array([START]))
    streams = ("rover", rover_ubx(session, None, rng=np.random.default_rng(1))), ("base", base_ubx(session))
    made = [to_rinex(stream.data, "ubx", folder / name, near) for name, stream in streams]
    rover, base = (read_observation_file(observations) for observations, _ in made)
    return rover, base, [ephemerides for _, ephemerides in made]


def flown(humidity: float, weather: AirAtBase | None, folder: Path) -> tuple[Ppk, Floats]:
    """Fly a loop 120 m above the base in this air; errors of the positions, east, north, up."""
    way, raised = Loop(START), np.array([0.0, 0.0, 70.0]) @ AXES
    rover_at = Antenna(lambda t: way.position(t) + raised, way.velocity)
    rover, base, navigation = observed(rover_at, humidity, folder)
    inputs = Inputs(rover, base, navigation, BASE_M, "truth", weather=weather)
    result = process(inputs, options_for(rover, base), "kinematic", folder)
    t = result.trajectory
    assert (t.status == "fixed").mean() > 0.9
    truth = way.position(t.time.ns) + raised
    return result, (t.xyz_m - truth) @ AXES.T


def zenith_delay_m(humidity: float, height_m: float) -> float:
    """As the simulator has it."""
    one = np.ones(1)
    sky = SkySettings(relative_humidity=humidity)
    at = AntennaTrack(one, one, np.radians(BASE_DEG[0]) * one, one, height_m * one)
    return float(Atmosphere(sky, np.zeros((0, 4)), 0.0).troposphere_m(at, np.pi / 2 * one)[0])


def test_moist_air_lowers_a_flight_and_weather_puts_it_right(tmp_path: Path) -> None:
    """Two flights with the same noise in dry and moist air."""
    needs_engine()
    _, dry = flown(0.0, None, tmp_path / "dry")
    # The standard atmosphere at the base, 30 m up.
    measured = measured_air(288.15 - 273.15 - 0.0065 * 30, 70.0)
    result, moist = flown(0.7, measured, tmp_path / "moist")
    common = result.common
    assert common is not None
    assert common.shift_by_zenith_delay is not None
    lowered = float(np.median((moist - dry)[:, 2]))
    height = BASE_DEG[2] + 120.0
    less = (zenith_delay_m(0.7, height) - zenith_delay_m(0.0, height)) - (
        zenith_delay_m(0.7, BASE_DEG[2]) - zenith_delay_m(0.0, BASE_DEG[2])
    )
    assert lowered < -0.010
    assert less * common.shift_by_zenith_delay[2] == pytest.approx(lowered, rel=0.1)
    # What is corrected from the weather is what the moisture did, as well as is stated.
    t = result.trajectory
    better = common.corrected(t)
    put_right = float(np.median(better.height_m - t.height_m))
    assert put_right == pytest.approx(-lowered, abs=2 * common.zenith_scale_sigma * 120.0)
    assert abs(put_right + lowered) < 0.25 * abs(lowered)


def test_common_errors_survive_a_file() -> None:
    common = CommonErrors(
        np.array([0.01, 0.01, 0.02]),
        31.0,
        np.array([0.002, 0.002, 0.004]),
        913.9,
        remaining_lapse(-25.4, 913.9, 166.0),
        np.array([0.1, -0.1, 2.7]),
    )
    again = from_plain(CommonErrors, common.as_json())
    assert again.as_json() == common.as_json()
    assert again.shift_sigma_m == pytest.approx([0.0102, 0.0102, 0.0204], abs=1e-4)


def test_a_mark_on_a_hill_is_surveyed_through_the_air(tmp_path: Path) -> None:
    """A static baseline to a mark 100 m higher, in dry and in moist air with the same noise."""
    needs_engine()
    hill = Antenna.still(BASE_M + np.array([200.0, 50.0, 100.0]) @ AXES)
    heights = {}
    for humidity in (0.0, 0.7):
        folder = tmp_path / f"air-{humidity}"
        observed(hill, humidity, folder)
        lat, lon, height = BASE_DEG
        air = measured_air(15 - 0.0065 * height, 100 * humidity)
        known = KnownMark(name="B", lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=(0, 0, 0))
        baseline = MeasuredBaseline(
            name="s", start="B", end="H", base=Path("base.obs"), rover=Path("rover.obs"),
            nav=(Path("rover.nav"),), base_antenna_m=0.0, rover_antenna_m=0.0,
        )  # fmt: skip
        setup = SurveySetup(required_minutes=1.0, weather=air, known=(known,), baseline=(baseline,))
        scratch = folder / "scratch"
        scratch.mkdir()
        solution, (session,), _ = run_survey(Survey(setup, folder, scratch))
        up = float((solution.xyz_m[1] - BASE_M) @ AXES[2])
        heights[humidity] = up, session["air_correction_m"]
    (dry, nothing), (moist, correction) = heights[0.0], heights[0.7]
    assert abs(nothing) < 0.001
    assert correction > 0.008
    # Without the correction the mark would be lower by as much in moist air.
    assert moist == pytest.approx(dry, abs=0.003)
